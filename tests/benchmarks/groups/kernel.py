"""The Runge-Kutta step of the paper-size liver: ours, the plain indexed model, and C."""

from collections.abc import Callable, Iterator

import numpy as np

from tests.benchmarks.bodies import Case, index, make_case, ours
from tests.benchmarks.compiled import NotAvailable, plain_c, vector_c
from tests.benchmarks.indexed import plain_indexed, with_step
from tests.benchmarks.rows import Limit, Plan, Row, at_most, failed
from tests.benchmarks.timing import Sample, Stepper, calibrated, difference, interleave, positions_after, ratio

N_CHECKED = 100
"""Steps after which positions are compared."""
TOLERATED = {"float64": 1e-11, "float32": 1e-4}
"""Largest error that counts as the same result."""
ERROR_MEANS = f"positions after {N_CHECKED} steps against the float64 indexed model, relative to the largest displacement"
DESIGN = {
    "float64": {"indexed, numba": 53.5, "indexed, plain C": 60.8, "AVX-512 C": 24.6, "ours": 25.9},
    "float32": {"indexed, numba": 48.0, "indexed, plain C": 55.2, "AVX-512 C": 18.6, "ours": 18.2},
}
"""Microseconds per step of prototypes on a Zen 5 core, damped."""
ASKED = {"float64": at_most(0.6), "float32": at_most(0.5)}
PROTOTYPE = {"float64": ("0.48", "1.05"), "float32": ("0.37", "0.98")}
"""Ratios of the prototype: over the indexed model, over C."""


def measure_kernel(plan: Plan) -> Iterator[Row]:
    """Yield times and ratios, damped and undamped, in both precisions; both precisions of a body share one interleaved run."""
    for is_damped in (True, False):
        case = make_case("liver", is_damped)
        contest = Contest(case, plan)
        for dtype in ("float64", "float32"):
            yield from contest.rows(dtype, is_damped)


class Contest:
    """All contestants on one body, timed in turns."""

    def __init__(self, case: Case, plan: Plan):
        """Build, check and time them all."""
        self.size = case.mesh.n_tetrahedra
        self.missing: dict[tuple[str, str], str] = {}
        self.errors: dict[tuple[str, str], float] = {}
        steppers = {}
        for name, dtype, make in contestants(case):
            try:
                steppers[name, dtype] = make()
            except NotAvailable as reason:
                self.missing[name, dtype] = str(reason)
                plan.say(f"{name}, {dtype} left out: {reason}")
        expected = positions_after(steppers["indexed, numba", "float64"], N_CHECKED)
        for key, stepper in steppers.items():
            self.errors[key] = difference(positions_after(stepper, N_CHECKED), expected, case.mesh.points)
        ready = {"|".join(key): calibrated(stepper) for key, stepper in steppers.items()}
        taken = interleave(ready, plan.rounds)
        self.samples = {key: taken["|".join(key)] for key in steppers}

    def rows(self, dtype: str, is_damped: bool) -> Iterator[Row]:
        """Yield the rows of one precision."""
        what = f"RK4 step, liver, {dtype}, {'damped' if is_damped else 'undamped'}"
        fastest = self.fastest_vector(dtype)
        for name in ("ours", "indexed, numba", "indexed, plain C", fastest):
            if (name, dtype) in self.missing:
                yield failed(f"{what}: {name}", self.missing[name, dtype], unit="µs")
                continue
            design = DESIGN[dtype].get(name.split(" (")[0]) if is_damped else None
            yield self.time_row(f"{what}: {name}", (name, dtype), f"prototype {design} µs" if design else "")
        over_indexed, over_c = PROTOTYPE[dtype] if is_damped else ("", "")
        paper = f"paper 4.0; prototype {over_indexed}" if is_damped else ""
        yield self.ratio_row(f"{what}: ours / plain indexed", dtype, "indexed, numba", ASKED[dtype], paper)
        prototype = f"prototype {over_c}" if over_c else ""
        yield self.ratio_row(f"{what}: ours / AVX-512 C", dtype, fastest, at_most(1.15), prototype)

    def fastest_vector(self, dtype: str) -> str:
        """Return the faster of the two C forms by its name."""
        forms = [name for name, kind in self.samples if kind == dtype and name.startswith("AVX-512")]
        return min(forms, key=lambda name: self.samples[name, dtype].low) if forms else "AVX-512 C (Newton)"

    def time_row(self, name: str, key: tuple[str, str], reference: str) -> Row:
        """Return the row of one contestant's time."""
        sample = self.samples[key]
        return step_row(name, sample, self.size, self.errors[key], TOLERATED[key[1]], ERROR_MEANS, reference)

    def ratio_row(self, name: str, dtype: str, base: str, asked: Limit, reference: str) -> Row:
        """Return the row of ours over another."""
        if (base, dtype) in self.missing:
            return failed(name, self.missing[base, dtype], asked=asked, reference=reference)
        value = ratio(self.samples["ours", dtype], self.samples[base, dtype])
        error = max(self.errors["ours", dtype], self.errors[base, dtype])
        return Row(name, value.value, "", value.low, value.high, asked, error, TOLERATED[dtype], ERROR_MEANS, reference)


def contestants(case: Case) -> Iterator[tuple[str, str, Callable[[], Stepper]]]:
    """Yield name, precision and maker of each contestant."""
    for dtype in (np.float64, np.float32):
        kind, model = np.dtype(dtype).name, index(case).typed(dtype)
        yield "indexed, numba", kind, lambda m=model: with_step(plain_indexed(m), case.step)
        yield "indexed, plain C", kind, lambda m=model: with_step(plain_c(m), case.step)
        yield "AVX-512 C (Newton)", kind, lambda m=model: with_step(vector_c(m, by_newton=True), case.step)
        yield "AVX-512 C (division)", kind, lambda m=model: with_step(vector_c(m, by_newton=False), case.step)
        yield "ours", kind, lambda d=dtype: ours(case, d)


def step_row(name: str, sample: Sample, n_tetrahedra: int, error: float, tolerated: float, error_means: str,
             reference: str = "", series: str = "") -> Row:
    """Return a row of microseconds per step."""
    low, median, high = (1e6 * value for value in (sample.low, sample.median, sample.high))
    return Row(name, low, "µs", median, high, None, error, tolerated, error_means, reference, n_tetrahedra=n_tetrahedra,
               series=series)  # fmt: skip
