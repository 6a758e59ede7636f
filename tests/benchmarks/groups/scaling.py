"""What a spring costs in bodies from two thousand to a million tetrahedra."""

from collections.abc import Iterator

import numpy as np

from tests.benchmarks.bodies import make_case, ours
from tests.benchmarks.rows import NAN, Plan, Row, at_most
from tests.benchmarks.timing import calibrated, interleave


def measure_scaling(plan: Plan) -> Iterator[Row]:
    """Yield the cost of a spring in one step of each body, and the ratio of the dearest to the cheapest."""
    sizes = ("2k", "20k") if plan.is_quick else ("2k", "20k", "200k", "1M")
    for dtype in (np.float64,) if plan.is_quick else (np.float64, np.float32):
        yield from measure_sizes(plan, sizes, dtype)


def measure_sizes(plan: Plan, sizes: tuple[str, ...], dtype: type) -> Iterator[Row]:
    """Yield the rows of one precision."""
    timers, n_springs, n_tetrahedra = {}, {}, {}
    kind = np.dtype(dtype).name
    for size in sizes:
        plan.say(f"building {size}")
        case = make_case(size)
        simulation = case.simulate(dtype)
        n_springs[size], n_tetrahedra[size] = simulation.body.n_springs, case.mesh.n_tetrahedra
        stepper = ours(case, simulation=simulation)
        stepper.advance(2)
        timers[size] = calibrated(stepper)
    samples = interleave(timers, max(5, plan.rounds // 4))
    costs = {size: 1e9 * samples[size].low / n_springs[size] for size in sizes}
    for size, sample in samples.items():
        yield Row(f"cost of a spring in an RK4 step, {size}, {kind}", costs[size], "ns", 1e9 * sample.median / n_springs[size],
                  1e9 * sample.high / n_springs[size])  # fmt: skip
        yield Row(f"RK4 step, {size}, {kind}", 1e6 * sample.low, "µs", 1e6 * sample.median, 1e6 * sample.high,
                  n_tetrahedra=n_tetrahedra[size], series=f"ours, {kind}")  # fmt: skip
    dearest, cheapest = max(costs, key=costs.__getitem__), min(costs, key=costs.__getitem__)
    note = f"dearest {dearest}, cheapest {cheapest}; positions are checked in the rows of kernel and paper"
    yield Row(f"cost of a spring, dearest / cheapest body from {sizes[0]} to {sizes[-1]}, {kind}",
              costs[dearest] / costs[cheapest], "", NAN, NAN, at_most(2.0), note=note)  # fmt: skip
