"""The paper's own table: what it costs to find cells by darts in every step."""

from collections.abc import Iterator

from tests.benchmarks.bodies import index, make_case, ours
from tests.benchmarks.groups.kernel import step_row
from tests.benchmarks.indexed import plain_indexed, with_step
from tests.benchmarks.rows import Plan, Row
from tests.benchmarks.timing import calibrated, difference, interleave, positions_after, ratio
from tests.benchmarks.walking import WAYS, spell_out, walking

N_CHECKED = {"liver": 100, "20k": 10, "200k": 2}
"""Steps after which positions are compared, by body."""
TOLERATED = 1e-9
"""Round-off of positions, over displacements that are small after few steps."""
PROTOTYPE = {"marks": "1549", "representative darts, flagged": "162", "ours": "26", "plain indexed": "54"}
"""Microseconds per step of the liver, on a Zen 5 core."""


def measure_paper(plan: Plan) -> Iterator[Row]:
    """Yield the times of all ways at all sizes, float64, damped."""
    for size in ("liver", "20k") if plan.is_quick else ("liver", "20k", "200k"):
        yield from measure_size(plan, size)


def measure_size(plan: Plan, size: str) -> Iterator[Row]:
    """Yield the rows of one body."""
    case = make_case(size)
    model = index(case)
    darts, n_tetrahedra = spell_out(case, model), case.mesh.n_tetrahedra
    steppers = {name: with_step(walking(darts, model, way), case.step) for name, way in WAYS.items()}
    steppers |= {"plain indexed": with_step(plain_indexed(model), case.step), "ours": ours(case)}
    expected = positions_after(steppers["plain indexed"], N_CHECKED[size])
    errors = {name: difference(positions_after(stepper, N_CHECKED[size]), expected, case.mesh.points)
              for name, stepper in steppers.items()}  # fmt: skip
    rounds = plan.rounds if size == "liver" else max(5, plan.rounds // 4)
    samples = interleave({name: calibrated(stepper) for name, stepper in steppers.items()}, rounds)
    means = f"positions after {N_CHECKED[size]} steps against the indexed model, relative to the largest displacement"
    for name, sample in samples.items():
        prototype = f"prototype {PROTOTYPE[name]} µs" if size == "liver" and name in PROTOTYPE else ""
        yield step_row(f"RK4 step, {size}: {name}", sample, n_tetrahedra, errors[name], TOLERATED, means, prototype, series=name)
    flagged = ratio(samples["representative darts, flagged"], samples["plain indexed"])
    reference = "paper 4.0 (its optimised way, 1856 tetrahedra)" if size == "liver" else ""
    yield Row(f"{size}: representative darts, flagged / plain indexed", *_fields(flagged), reference=reference)
    yield Row(f"{size}: ours / plain indexed", *_fields(ratio(samples["ours"], samples["plain indexed"])))


def _fields(value) -> tuple[float, str, float, float]:
    """Return a ratio as the first fields of a row."""
    return value.value, "", value.low, value.high
