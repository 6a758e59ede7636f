"""Cases at the edge of the stable step."""

import numpy as np

import gmapspring as gs
from tests.stability.cases.bodies import (
    build,
    cut_at_random,
    drag_of,
    gentle_motion,
    gentle_speed,
    held_at_low_x,
    near_bound,
    small_box,
    throw,
)
from tests.stability.cases.linear import growth, is_implicit, modes, needs_drag
from tests.stability.cases.verdict import Check, Verdict, all_finite, differing, refused

RATIOS = (0.0, 0.01, 0.1, 0.3, 0.7, 1.0, 3.0, 10.0, 100.0)
LINEAR = "stays finite; the energy of small motions is never above the swing that linear theory gives"


def at_the_bound(scheme, dtype):
    """Step at 0.99 of the bound, whole and after random cuts."""
    checks = []
    for seed in range(3):
        sim = build(scheme, dtype, pinned=held_at_low_x(small_box()))
        if seed:
            cut_at_random(sim, np.random.default_rng(seed))
        checks += [gentle_motion(sim), all_finite(sim)]
    return Verdict(LINEAR, tuple(checks))


def damping_from_none_to_a_hundred_times_critical(scheme, dtype):
    """Step at 0.99 of the bound with damping along the springs, by drag, and by both."""
    checks = []
    for along, by_drag in ((1, 0), (0, 1), (1, 1)):
        for ratio in RATIOS:
            sim = damped(scheme, dtype, ratio * along, ratio * by_drag)
            if sim.stable_step == 0.0:
                checks.append(refused([lambda sim=sim: sim.advance(1.0, step=1e-9)], gs.StabilityError, "viscosity"))
            else:
                checks += [gentle_motion(sim, n_steps=1000), all_finite(sim)]
    return Verdict(LINEAR + "; where a scheme has no stable step, it says so", tuple(checks))


def damped(scheme, dtype, ratio_along, ratio_by_drag):
    """Return a box whose fastest tetrahedron has these damping ratios, c / (2 omega)."""
    mesh = small_box()
    omega = gs.stability.element_frequency(gs.Simulation(mesh, gs.Material(5e3, 1e3)).body)
    material = gs.Material(5e3, 1e3, damping=2 * ratio_along / omega, viscosity=2 * ratio_by_drag * omega)
    return gs.Simulation(mesh, material, pinned=held_at_low_x(mesh), integrator=scheme, dtype=dtype)


def beyond_the_true_limit(scheme, dtype):
    """Step at twice the true limit, which the bound forbids.

    Just beyond it small motions grow too, but only until springs are no longer linear: explicit Euler then stays finite.
    """
    sim = build(scheme, dtype, pinned=held_at_low_x(small_box()))
    frequency = modes(sim.body)
    if is_implicit(scheme):
        return Verdict("has no such limit: " + LINEAR, (gentle_motion(sim), all_finite(sim)))
    limit = true_limit(scheme, frequency, drag_of(sim))
    step = 2.0 * limit
    n_steps = int(800.0 / np.log(growth(scheme, step, frequency, drag_of(sim))))  # e^800 is beyond float64
    throw(sim, gentle_speed(sim))
    before = sim.body.nodes.state.copy()
    checks = [
        refused([lambda: sim.advance(1.0, step=step)], gs.StabilityError, f"{sim.stable_step:.6g}"),
        differing("entries that a refused step changed", sim.body.nodes.state, before),
        Check("bound / true limit", sim.stable_step / limit, 1.0),
        refused([lambda: sim._take_substeps(step, n_steps)], gs.DivergenceError, "last finite state"),
        all_finite(sim),
        differing("entries unlike the last finite state", sim.body.nodes.state, replayed(sim, step, before)),
        refused([lambda: sim._take_substeps(step, 1)], gs.DivergenceError, "substep 1 of 1"),
    ]
    return Verdict("is refused; forced, it ends in a DivergenceError, and the body holds its last finite state", tuple(checks))


def true_limit(scheme, frequency, drag):
    """Return the longest step [s] at which no mode grows, by bisection."""
    low, high = 0.0, 100.0 / frequency.max()
    for _ in range(50):
        middle = 0.5 * (low + high)
        # A mode at frequency 0 drifts at constant speed: a double eigenvalue 1, which round-off splits.
        is_stable = growth(scheme, middle, frequency[frequency > 1e-3 * frequency.max()], drag) <= 1.0 + 1e-12
        low, high = (middle, high) if is_stable else (low, middle)
    return low


def replayed(sim, step, start):
    """Return the state that as many substeps as a simulation has taken lead to from a start."""
    again = build(sim.integrator.name, type(sim.body.real), pinned=held_at_low_x(small_box()))
    again.body.nodes.state[:] = start
    if sim.n_substeps:
        again._take_substeps(step, sim.n_substeps)
    return again.body.nodes.state


def no_drag_for_explicit_euler(scheme, dtype):
    """Ask for a step where an undamped body has none."""
    mesh = small_box()
    sim = gs.Simulation(mesh, gs.Material(5e3, 1e3), integrator=scheme, dtype=dtype)
    if needs_drag(scheme):
        calls = [lambda step=step: sim.advance(1.0, step=step) for step in (None, 1e-9)]
        return Verdict("is refused, naming viscosity", (refused(calls, gs.StabilityError, "viscosity"),))
    throw(sim, gentle_speed(sim))
    sim.advance(near_bound(sim))
    return Verdict("stays finite", (all_finite(sim),))


CASES = {
    "at 0.99 of the bound": at_the_bound,
    "damping ratio from 0 to 100": damping_from_none_to_a_hundred_times_critical,
    "at twice the true limit": beyond_the_true_limit,
    "no drag at all": no_drag_for_explicit_euler,
}
