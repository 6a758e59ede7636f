"""Cases at the ends of the number range, far from the origin, of tiny and huge bodies, and of a million substeps."""

import time

import numpy as np

import gmapspring as gs
from gmapspring.integrators.backward_euler import ACCURACY
from tests import zoo
from tests.stability.cases.bodies import (
    build,
    cut_at_random,
    explicit_step,
    gentle_speed,
    held_at_low_x,
    n_steps_for,
    peak_energy,
    small_box,
    swing_of_any_cut,
    throw,
)
from tests.stability.cases.linear import is_implicit, round_off, total_energy
from tests.stability.cases.verdict import Check, Verdict, all_finite, differing

SCALES = (2.0**-20, 2.0**12)
"""Of a body of 0.2 m: 2e-7 m and 800 m. Even powers of two: scaling rounds nothing, and neither do roots of masses."""
OFFSET = 1024.0
"""[m]; a power of two, so that the place of every grid point is the same share of it."""
DENORMAL = {np.float64: 1e-310, np.float32: 1e-40}
"""Below the smallest normal numbers, 2.2e-308 and 1.2e-38."""
SLOWDOWN = 200.0
"""An operation on a denormal number is handed to microcode on many processors, which takes up to about so many cycles."""


def denormals(scheme, dtype):
    """Move a body at velocities below the smallest normal number, where coordinates of 0 are as small instead; take its time."""
    mesh, n_steps = small_box(), 200
    seconds = {}
    for speed in (DENORMAL[dtype], 1e-3):
        sim = build(scheme, dtype, mesh)
        throw(sim, speed)
        nodes = sim.body.nodes
        nodes.position[nodes.position == 0.0] = DENORMAL[dtype]
        step = explicit_step(sim)
        sim.advance(step)
        seconds[speed] = min(timed(lambda sim=sim, step=step: sim.advance(n_steps * step, step=step)) for _ in range(5))
        if speed == DENORMAL[dtype]:
            # A body at rest holds forces of the round-off of its rest lengths, eps l0 each: it moves by about as much.
            checks = [all_finite(sim), Check("distance moved [m]", displacement(sim), sim.body.n_springs * 0.2 * eps_of(dtype))]
    checks.append(Check("time / time with normal numbers", seconds[DENORMAL[dtype]] / seconds[1e-3], SLOWDOWN))
    return Verdict("stays finite and at rest; takes no longer than denormal numbers take processors", tuple(checks))


def eps_of(dtype) -> float:
    """Return the relative round-off."""
    return float(np.finfo(dtype).eps)


def displacement(sim) -> float:
    """Return how far the farthest node of an uncut body has moved [m]."""
    nodes = sim.body.nodes
    return float(np.abs(nodes.position.astype(float) - sim.body.mesh.points[nodes.point]).max())


def timed(call) -> float:
    """Return the seconds that a call takes."""
    begin = time.perf_counter()
    call()
    return time.perf_counter() - begin


def other_sizes(scheme, dtype):
    """Step a body of a millionth of the usual size, and one of 4,000 times: they do what the usual one does, scaled."""
    checks = []
    usual = moved(scheme, dtype, 1.0)
    for scale in SCALES:
        state = moved(scheme, dtype, scale)
        state[:, :3] /= dtype(scale)
        checks.append(differing("entries unlike those of the usual size", state, usual))
    return Verdict("bit for bit what a body of usual size does, times a power of two", tuple(checks))


def moved(scheme, dtype, scale):
    """Return the state of a cut box of some size after it has moved; its velocities are the same at any size."""
    mesh = gs.Mesh(scale * small_box().points, small_box().tetrahedra)
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh), damping_ratio=0.05)
    throw(sim, 0.3)
    step = scale * build(scheme, dtype, damping_ratio=0.05).default_step
    cut_at_random(sim, np.random.default_rng(6))
    sim.advance(n_steps_for(sim, 300) * step, step=step)
    return sim.body.nodes.state.copy()


def far_from_the_origin(scheme, dtype):
    """Step a body a kilometre away: its motion differs by what positions there are rounded by."""
    sims = []
    for offset in (0.0, OFFSET):
        mesh = gs.meshes.box((2, 2, 1), 1.0)
        sim = build(scheme, dtype, gs.Mesh(mesh.points + offset, mesh.tetrahedra), pinned=held_at_low_x(mesh), damping_ratio=0.05)
        throw(sim, gentle_speed(sim))
        sims.append(sim)
    near, far = sims
    step, n_steps = explicit_step(near), 200
    for sim in sims:
        sim.advance(n_steps * step, step=step)
    offsets = far.body.nodes.position.astype(float) - near.body.nodes.position.astype(float) - OFFSET
    # Each step rounds every coordinate by half an eps of its size, and no such push grows.
    limit = 0.5 * n_steps * eps_of(dtype) * (OFFSET + 2.0) * np.sqrt(offsets.size)
    if is_implicit(scheme):
        limit += n_steps * ACCURACY * gentle_speed(near) * step * np.sqrt(offsets.size)
    check = Check("distance from the same motion at the origin [m]", float(np.linalg.norm(offsets)), float(limit))
    expected = "stays finite; what it does differs by eps / 2 of the distance at most for each coordinate and step"
    return Verdict(expected, (check, all_finite(far)))


def a_million_substeps(scheme, dtype):
    """Let a ring of six tetrahedra swing for a million substeps of the default length."""
    mesh = zoo.build("ring")
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh))
    throw(sim, gentle_speed(sim, 0.01))
    # An implicit step is dear, and what it damps is at rest long before.
    n_steps = 1_000_000 // (50 if is_implicit(scheme) else 1)
    step, start = sim.default_step, total_energy(sim)
    limit = swing_of_any_cut(sim, step) * round_off(sim, n_steps, start)
    check = Check("peak energy / start", peak_energy(sim, step, n_steps) / start, limit)
    return Verdict("stays finite; the energy is within the swing of the element bound to the last step (implicit: 20,000 steps)",
                   (check, all_finite(sim)))  # fmt: skip


CASES = {
    "denormal numbers": denormals,
    "a millionth and 4,000 times the size": other_sizes,
    "a kilometre from the origin": far_from_the_origin,
    "a million substeps": a_million_substeps,
}
