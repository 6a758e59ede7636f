"""The same body and step by others, in turns with ours."""

import contextlib
import math
import os
import sys
from collections.abc import Iterator

import numpy as np

from tests.benchmarks.bodies import Case, IndexedModel, index, make_case, ours
from tests.benchmarks.groups.kernel import ERROR_MEANS, N_CHECKED
from tests.benchmarks.indexed import plain_indexed, with_step
from tests.benchmarks.peers import PEERS, prepare
from tests.benchmarks.rows import NAN, Plan, Row, at_least, failed, reason_of
from tests.benchmarks.timing import Stepper, calibrated, difference, interleave, positions_after, ratio

AHEAD = at_least(1.0)
PROTOTYPE = {"Taichi": "62", "Warp (CPU)": "119", "SciPy sparse": "424", "NumPy": "763 to 1343", "PyTorch": "1429"}
"""Microseconds per step on a Zen 5 core."""


def measure_peers(plan: Plan) -> Iterator[Row]:
    """Yield how many times as long as ours each peer's step takes; those that cannot run say why."""
    case = make_case("liver")
    model = index(case)
    expected = positions_after(with_step(plain_indexed(model), case.step), N_CHECKED)
    contest = {"ours": calibrated(warmed(ours(case)))}
    errors = {}
    for name in PEERS:
        try:
            with silence():
                contest[name], errors[name] = enter(name, case, model, expected)
        except (Exception, SystemExit) as error:
            plan.say(f"{name} left out: {reason_of(error)}")
            yield failed(f"{name} / ours, RK4 step, liver, float64", reason_of(error), asked=AHEAD)
    with silence():
        samples = interleave(contest, max(7, plan.rounds // 3))
    size = case.mesh.n_tetrahedra
    for name, error in errors.items():
        value, peer = ratio(samples[name], samples["ours"]), PEERS[name]
        took = f"{1e6 * samples[name].low:.0f} µs a step, ours {1e6 * samples['ours'].low:.0f} µs"
        yield Row(
            f"{name} / ours, RK4 step, liver, float64", value.value, "", value.low, value.high, AHEAD,
            NAN if math.isnan(peer.tolerated) else error, peer.tolerated, ERROR_MEANS,
            f"prototype {PROTOTYPE[name]} µs" if name in PROTOTYPE else "",
            f"{took}; {peer.differs}" if peer.differs else took,
        )  # fmt: skip
        yield Row(f"RK4 step, liver: {name}", 1e6 * samples[name].low, "µs", 1e6 * samples[name].median,
                  1e6 * samples[name].high, n_tetrahedra=size, series=name)  # fmt: skip


def enter(name: str, case: Case, model: IndexedModel, expected: np.ndarray):
    """Return what times a peer, and its error."""
    stepper = prepare(PEERS[name], case, model)
    positions = positions_after(stepper, N_CHECKED)
    if not np.isfinite(positions).all():
        raise FloatingPointError("its state stops being finite under the same step")
    return calibrated(stepper), difference(positions, expected, case.mesh.points)


def warmed(stepper: Stepper) -> Stepper:
    """Return a stepper that has run once."""
    stepper.advance(N_CHECKED)
    return stepper


@contextlib.contextmanager
def silence() -> Iterator[None]:
    """Keep what libraries print by themselves, below Python too, out of the report."""
    sys.stdout.flush()
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        sys.stdout.flush()
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)
