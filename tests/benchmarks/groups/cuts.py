"""Cuts with re-sharing: one call each, and inside one batch, on a small and on a large body."""

import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from gmapspring import Simulation
from tests.benchmarks.bodies import make_case
from tests.benchmarks.rows import NAN, Plan, Row, at_most, failed, reason_of
from tests.benchmarks.timing import LOW, Sample, sampled, timed

N_SINGLE = 3000
"""Single cuts timed on each body, at most."""
N_PARTS = 30
"""The cuts between the timed ones are done in so many batches, so that single cuts meet the body at every stage."""
LARGE = 100_000
"""From this many tetrahedra on, the slow check of validity is made after single cuts only."""
N_BATCHES = {True: 9, False: 3}
"""Batches timed on a small body and on a large one."""
SAME = at_most(2.0)
ERROR_MEANS = "mass after all cuts against what should be left, relative; and the map is checked to be valid"


class Kind(NamedTuple):
    """A sort of cut."""

    name: str
    choose: Callable[[Simulation, np.random.Generator], np.ndarray]
    """Return a random half of all there are, in random order, with what `once` and `batch` take in each row."""
    once: Callable[[Simulation, np.ndarray], object]
    batch: Callable[[Simulation, np.ndarray], object]
    limits: tuple[float, float]
    """Microseconds of one call, and of one in a batch."""
    references: str


def interior_faces(simulation: Simulation) -> np.ndarray:
    """Return the pairs of tetrahedra that share a face, (k, 2)."""
    faces = simulation.body.face_of
    order = np.argsort(faces, axis=None, kind="stable")
    number, tetrahedron = faces.ravel()[order], order // 4
    is_shared = np.flatnonzero((number[1:] == number[:-1]) & (number[1:] >= 0))
    return np.stack([tetrahedron[is_shared], tetrahedron[is_shared + 1]], axis=1)


def half_of(everything: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a random half, in random order."""
    return everything[rng.permutation(len(everything))[: len(everything) // 2]]


KINDS = (
    Kind(
        "face split",
        lambda simulation, rng: half_of(interior_faces(simulation), rng),
        lambda simulation, pair: simulation.split_face(pair[0], pair[1]),
        lambda simulation, pairs: simulation.cut(faces=pairs),
        (10.0, 1.0),
        "CGAL with attributes 21 and 42 µs",
    ),
    Kind(
        "removal",
        lambda simulation, rng: half_of(np.arange(simulation.body.mesh.n_tetrahedra), rng),
        lambda simulation, tetrahedron: simulation.remove_tetrahedron(tetrahedron),
        lambda simulation, tetrahedra: simulation.cut(tetrahedra=tetrahedra),
        (12.0, 2.0),
        "CGAL 50 and 87 µs",
    ),
)
"""Sorts of cut."""


def measure_cuts(plan: Plan) -> Iterator[Row]:
    """Yield the time of a cut for each sort and size, and the ratio between the sizes."""
    sizes = ("2k", "20k") if plan.is_quick else ("2k", "200k")
    bodies = {size: make_case(size, is_damped=False).simulate() for size in sizes}
    for kind in KINDS:
        singles, batches = {}, {}
        for size, simulation in bodies.items():
            start = simulation.save_state()
            try:
                singles[size], error = time_single_cuts(kind, simulation)
                yield cut_row(f"{kind.name}, one call, {size}", singles[size], error, kind.limits[0], kind.references)
            except Exception as problem:
                yield failed(f"{kind.name}, one call, {size}", reason_of(problem), unit="µs")
            simulation.load_state(start)
            try:
                batches[size], error = time_batch(kind, simulation)
                yield cut_row(f"{kind.name}, in a batch, {size}", batches[size], error, kind.limits[1], kind.references)
            except Exception as problem:
                yield failed(f"{kind.name}, in a batch, {size}", reason_of(problem), unit="µs")
            simulation.load_state(start)
            name = f"{kind.name}, in {N_PARTS} batches one after the other, {size}"
            try:
                yield cut_row(name, *time_batches(kind, simulation))
            except Exception as problem:
                yield failed(name, reason_of(problem), unit="µs")
            simulation.load_state(start)
        for how, samples in (("one call", singles), ("in a batch", batches)):
            name = f"{kind.name}, {how}, {sizes[1]} / {sizes[0]}"
            is_known = len(samples) == 2
            value = samples[sizes[1]].median / samples[sizes[0]].median if is_known else NAN
            yield Row(name, value, asked=SAME, note="" if is_known else "one of the two is missing")


def time_single_cuts(kind: Kind, simulation: Simulation) -> tuple[Sample, float]:
    """Cut a random half, timing single cuts spread over all of it; return their times and the error in mass."""
    chosen = kind.choose(simulation, np.random.default_rng(0))
    first = simulation.body.nodes.mass.sum()
    warm_up(kind, simulation, chosen)
    times = []
    for part in np.array_split(chosen, N_PARTS):
        n_timed = min(len(part), N_SINGLE // N_PARTS)
        # Plain numbers are what a user has at hand; taking them out of the array is not part of the cut.
        for each in part[:n_timed].tolist():
            begin = time.perf_counter_ns()
            kind.once(simulation, each)
            times.append(1e-9 * (time.perf_counter_ns() - begin))
        if n_timed < len(part):
            kind.batch(simulation, part[n_timed:])
    return sampled(times), mass_error(simulation, first)


def time_batch(kind: Kind, simulation: Simulation) -> tuple[Sample, float]:
    """Cut a random half in one call, from the same start each time; return the time per cut and the error in mass."""
    is_small = simulation.body.mesh.n_tetrahedra < LARGE
    chosen = kind.choose(simulation, np.random.default_rng(1))
    first, start = simulation.body.nodes.mass.sum(), simulation.save_state()
    times = []
    for _ in range(N_BATCHES[is_small]):
        simulation.load_state(start)
        times.append(timed(kind.batch, simulation, chosen) / len(chosen))
    return sampled(times), mass_error(simulation, first, is_checked=is_small)


def time_batches(kind: Kind, simulation: Simulation) -> tuple[Sample, float]:
    """Cut a random half in portions, one call each; return the times per cut, portion by portion, and the error in mass."""
    chosen, first = kind.choose(simulation, np.random.default_rng(2)), simulation.body.nodes.mass.sum()
    times = [timed(kind.batch, simulation, part) / len(part) for part in np.array_split(chosen, N_PARTS)]
    return sampled(times), mass_error(simulation, first)


def warm_up(kind: Kind, simulation: Simulation, chosen: np.ndarray) -> None:
    """Cut once each way and go back, so that nothing is compiled on the clock."""
    start = simulation.save_state()
    kind.once(simulation, chosen[0].tolist())
    kind.batch(simulation, chosen[1:3])
    simulation.load_state(start)


def mass_error(simulation: Simulation, first: float, is_checked: bool = True) -> float:
    """Check that the body is valid, and return how far its mass is from that of its tetrahedra, relative to the first mass."""
    if is_checked:
        simulation.check_validity()
    body = simulation.body
    return float(abs(body.nodes.mass.sum() - body.tetrahedra.mass[body.is_alive].sum()) / first)


def cut_row(name: str, sample: Sample, error: float, limit: float | None = None, reference: str = "") -> Row:
    """Return a row of microseconds per cut: the median, as is asked."""
    low, high = 1e6 * float(np.percentile(sample.times, LOW)), 1e6 * sample.high
    return Row(name, 1e6 * sample.median, "µs", low, high, at_most(limit) if limit else None, error, 1e-9, ERROR_MEANS, reference)
