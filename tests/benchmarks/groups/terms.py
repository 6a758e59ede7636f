"""What each term of the physics adds to a step where a scene names it; the body without any is the baseline."""

from collections.abc import Callable, Iterator

import numpy as np

from gmapspring import Material, Simulation, measure
from tests.benchmarks.bodies import DAMPING, DENSITY, GRAVITY, VISCOSITY, YOUNG_MODULUS, Case, make_case, ours
from tests.benchmarks.rows import Plan, Row
from tests.benchmarks.timing import calibrated, interleave, positions_after, ratio, timed

NOTHING = (0.0, 0.0, 0.0)
SETTLE = 0.12
"""Time between two measurements of strain [s], as in the scenes."""


def measure_terms(plan: Plan) -> Iterator[Row]:
    """Yield what each term adds, in percent of the step without any."""
    for dtype in (np.float64, np.float32):
        case = make_case("liver", gravity=NOTHING)
        bodies = {name: make(case, dtype) for name, make in TERMS.items()}
        steppers = {name: ours(case, simulation=body) for name, body in bodies.items()}
        for stepper in steppers.values():
            positions_after(stepper, 10)
        timers = {name: calibrated(stepper) for name, stepper in steppers.items()}
        timers["strain watching"] = watched(case, TERMS["no term"](case, dtype))
        samples = interleave(timers, plan.rounds)
        base, kind = samples["no term"], np.dtype(dtype).name
        yield Row(
            f"step without any term, liver, {kind}", 1e6 * base.low, "µs", 1e6 * base.median, 1e6 * base.high,
            error=float(idle_bytes(bodies["no term"])), tolerated=0.0,
            error_means="bytes held for terms that are not named",
        )  # fmt: skip
        for name in list(timers)[1:]:
            added = ratio(samples[name], base)
            low, high = 100 * (added.low - 1), 100 * (added.high - 1)
            yield Row(f"{name} adds, liver, {kind}", 100 * (added.value - 1), "%", low, high)


def build(case: Case, dtype: type, damping: float = 0.0, viscosity: float = 0.0, gravity=NOTHING, has_loads=False) -> Simulation:
    """Return the liver with some terms, in motion."""
    material = Material(YOUNG_MODULUS, DENSITY, damping, viscosity)
    loads = None
    if has_loads:
        loads = np.zeros((case.mesh.n_points, 3))
        loads[~case.pinned, 2] = -1e-3
    simulation = case._replace(material=material).simulate(dtype, gravity=gravity, loads=loads)
    # Without this, a body without gravity and loads would not move at all.
    velocity = simulation.body.nodes.velocity
    velocity[...] = 0.1 * np.random.default_rng(0).standard_normal(velocity.shape)
    return simulation


TERMS: dict[str, Callable[[Case, type], Simulation]] = {
    "no term": build,
    "gravity": lambda case, dtype: build(case, dtype, gravity=GRAVITY),
    "loads": lambda case, dtype: build(case, dtype, has_loads=True),
    "viscosity": lambda case, dtype: build(case, dtype, viscosity=VISCOSITY),
    "spring damping": lambda case, dtype: build(case, dtype, damping=DAMPING),
    "all four together": lambda case, dtype: build(case, dtype, DAMPING, VISCOSITY, GRAVITY, has_loads=True),
}
"""Bodies by the term that they name; the first is the baseline."""


def watched(case: Case, simulation: Simulation) -> Callable[[], float]:
    """Return a function that times one settle with the strains measured at its end, as in a scene; seconds per step."""
    n_steps, stepper = round(SETTLE / case.step), ours(case, simulation=simulation)

    def settle() -> None:
        stepper.advance(n_steps)
        measure.edge_strains(simulation.body)

    def time_settle() -> float:
        stepper.restart()
        return timed(settle) / n_steps

    time_settle()
    return time_settle


def idle_bytes(simulation: Simulation) -> int:
    """Return how much memory the rows of terms take that the body does not name."""
    nodes, springs, tetrahedra = simulation.body.node_rows, simulation.body.spring_rows, simulation.body.tetrahedra
    return nodes.external.nbytes + nodes.viscosity.nbytes + springs.damping.nbytes + tetrahedra.load.nbytes
