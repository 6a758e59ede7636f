"""Cases of bodies that are let go from impossible shapes, at the default step."""

from functools import partial

import numpy as np

from tests.stability.cases.bodies import build, held_at_low_x, n_steps_for, peak_energy, small_box, swing_of_any_cut
from tests.stability.cases.linear import round_off, total_energy
from tests.stability.cases.verdict import Check, Verdict, all_finite, differing

DAMPING_RATIO = 0.05
"""Of the fastest tetrahedron: all tissue has some."""
SHAPES = {
    # Shrunk too, since springs cannot tell a body from its mirror image.
    "inverted": lambda points, eps: points * (-0.7, 0.7, 0.7),
    "flattened to a plane": lambda points, eps: points * (1.0, 1.0, 0.0),
    "crushed to almost a point": lambda points, eps: 0.1 * (1.0 + 4.0 * eps * points / points.max()),
    "stretched by 300 %": lambda points, eps: points * 4.0,
}
"""Where the free points of a box start, (points, round-off) -> points: some springs have length zero, or next to it."""


def deformed(scheme, dtype, shape, damping_ratio):
    """Return a box held at one end whose free points start elsewhere."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh), damping_ratio=damping_ratio)
    nodes = sim.body.nodes
    is_free = ~nodes.is_pinned
    nodes.position[is_free] = SHAPES[shape](mesh.points[nodes.point[is_free]], float(np.finfo(dtype).eps))
    return sim


def let_go(shape, scheme, dtype):
    """Let a slightly damped box go, and see that its energy stays within the swing."""
    sim = deformed(scheme, dtype, shape, DAMPING_RATIO)
    step, n_steps, start = sim.default_step, n_steps_for(sim), total_energy(sim)
    limit = swing_of_any_cut(sim, step) * round_off(sim, n_steps, start)
    check = Check("peak energy / start", peak_energy(sim, step, n_steps) / start, limit)
    expected = "stays finite; the energy is never above that at the start times the swing that the element bound gives"
    return Verdict(expected, (check, all_finite(sim)))


def let_go_undamped(scheme, dtype):
    """Let an undamped box go from each of the shapes, and record its energy."""
    checks = []
    for shape in SHAPES:
        sim = deformed(scheme, dtype, shape, 0.0)
        start = total_energy(sim)
        peak = peak_energy(sim, sim.default_step, n_steps_for(sim))
        checks += [Check(f"peak energy / start, {shape}", peak / start, np.inf), all_finite(sim)]
    expected = "stays finite; no limit for the energy: springs keep passing through length zero, where they turn within a step"
    return Verdict(expected, tuple(checks))


def crushed_to_a_point(scheme, dtype):
    """Crush a whole free body to one point."""
    sim = build(scheme, dtype, damping_ratio=DAMPING_RATIO)
    sim.body.nodes.position[:] = 0.1
    before = sim.body.nodes.state.copy()
    sim.advance(n_steps_for(sim) * sim.default_step)
    checks = (all_finite(sim), differing("entries of the state that changed", sim.body.nodes.state, before))
    return Verdict("stays finite and where it is: no spring has a direction to push in", checks)


CASES = {
    **{f"started {shape}": partial(let_go, shape) for shape in SHAPES},
    "started crushed to a point": crushed_to_a_point,
    "the same shapes, undamped": let_go_undamped,
}
