"""The classical Runge-Kutta scheme: fourth order, four force evaluations per step.

Source: E. Hairer, S. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 1993, table II.1.2; its stability
region: E. Hairer, G. Wanner, "Solving Ordinary Differential Equations II", 1996, section IV.2, eq. 2.12.
"""

import numpy as np

from gmapspring.forces import finish_forces, start_force, start_forces
from gmapspring.integrators.integrator import Integrator, Limits, begin, end, next_substeps
from gmapspring.jit import kernel, part
from gmapspring.matter import N_NODES, N_SPRINGS, read_matter
from gmapspring.quad import load, store

IMAGINARY_REACH = 2.8284
"""The region of |1 + z + z^2/2 + z^3/6 + z^4/24| <= 1 holds i*y for |y| up to this (the square root of 8)."""
SECTOR_REACH = 2.6155
"""It holds every z with Re z <= 0 and |z| up to this; the tightest place is at 122.7 degrees (2.61559)."""
REAL_REACH = 2.7852
"""It holds the negative real axis up to this (2.78529)."""
STRIP_REACH = 0.86
"""It holds every z with |z| up to IMAGINARY_REACH and -STRIP_REACH <= Re z <= 0 (0.8629)."""


@kernel
def advance(table, rows, real, steps, n_substeps, tolerances, taken):
    """Advance rows; see Integrator.advance."""
    for k in range(len(rows)):
        matter = read_matter(table, rows[k], real)
        begin(matter)
        n_taken = np.int64(0)
        while n_taken < n_substeps[k]:
            more = next_substeps(matter, n_taken, n_substeps[k], steps[k], tolerances[k])
            if more == 0:
                break
            take_substeps(matter, matter.nodes.state.dtype.type(steps[k]), more)
            n_taken += more
        taken[k] = end(matter, n_taken)


@part
def take_substeps(matter, step, n_substeps):
    """Take n_substeps of four stages each; whatever moves the nodes starts the forces of the stage to come.

    With the stages' velocities v, v2, v3, v4 and accelerations a, a2, a3, a4, the classical step leads to

        x + step / 6 (v + 2 v2 + 2 v3 + v4)    and    v + ((v2 - v) + 2 (v3 - v) + (v4 - v)) / 3 + step / 6 a4

    since v2 - v = step / 2 a, v3 - v = step / 2 a2 and v4 - v = step a3. Of stages gone by only v2 is kept: fewer bytes move.
    """
    nodes, springs, n_nodes, n_springs = matter.nodes, matter.springs, matter.counts[N_NODES], matter.counts[N_SPRINGS]
    state, force = nodes.state, nodes.force
    stage, second = matter.work[:n_nodes], matter.work[n_nodes: 2 * n_nodes].reshape(2 * n_nodes, 4)
    scalar = state.dtype.type
    half, sixth = scalar(step / scalar(2)), scalar(step / scalar(6))
    start_forces(nodes, n_nodes, state, force)
    for _ in range(n_substeps):
        finish_forces(nodes, springs, n_nodes, n_springs, state, force)
        first_stage(nodes, n_nodes, stage, second, half)
        finish_forces(nodes, springs, n_nodes, n_springs, stage, force)
        second_stage(nodes, n_nodes, stage, half)
        finish_forces(nodes, springs, n_nodes, n_springs, stage, force)
        third_stage(nodes, n_nodes, stage, second, step, sixth)
        finish_forces(nodes, springs, n_nodes, n_springs, stage, force)
        fourth_stage(nodes, n_nodes, sixth)


@part
def first_stage(nodes, n_nodes, stage, second, reach):
    """Set the second stage reach [s] along the slope, and keep its velocity."""
    state, force, inverse_mass = nodes.state, nodes.force, nodes.inverse_mass
    for i in range(n_nodes):
        position, velocity = load(state, i, 0), load(state, i, 4)
        next_velocity = velocity + reach * (inverse_mass[i] * load(force, i, 0))
        store(second, i, 0, next_velocity)
        store(stage, i, 0, position + reach * velocity)
        store(stage, i, 4, next_velocity)
        start_force(nodes, i, stage, force)


@part
def second_stage(nodes, n_nodes, stage, reach):
    """Set the third stage reach [s] along the slope of the second."""
    state, force, inverse_mass = nodes.state, nodes.force, nodes.inverse_mass
    for i in range(n_nodes):
        velocity, acceleration = load(stage, i, 4), inverse_mass[i] * load(force, i, 0)
        store(stage, i, 0, load(state, i, 0) + reach * velocity)
        store(stage, i, 4, load(state, i, 4) + reach * acceleration)
        start_force(nodes, i, stage, force)


@part
def third_stage(nodes, n_nodes, stage, second, reach, weight):
    """Set the last stage reach [s] along the slope of the third, and the state to all of the step but the last acceleration."""
    state, force, inverse_mass = nodes.state, nodes.force, nodes.inverse_mass
    scalar = state.dtype.type
    two, third = scalar(2), scalar(1) / scalar(3)
    for i in range(n_nodes):
        position, velocity = load(state, i, 0), load(state, i, 4)
        second_velocity, third_velocity = load(second, i, 0), load(stage, i, 4)
        last_velocity = velocity + reach * (inverse_mass[i] * load(force, i, 0))
        store(stage, i, 0, position + reach * third_velocity)
        store(stage, i, 4, last_velocity)
        store(state, i, 0, position + weight * ((velocity + last_velocity) + two * (second_velocity + third_velocity)))
        gain = ((second_velocity - velocity) + two * (third_velocity - velocity)) + (last_velocity - velocity)
        store(state, i, 4, velocity + third * gain)
        start_force(nodes, i, stage, force)


@part
def fourth_stage(nodes, n_nodes, weight):
    """Add the last acceleration to the state."""
    state, force, inverse_mass = nodes.state, nodes.force, nodes.inverse_mass
    for i in range(n_nodes):
        store(state, i, 4, load(state, i, 4) + weight * (inverse_mass[i] * load(force, i, 0)))
        start_force(nodes, i, state, force)


def stable_step(limits: Limits) -> float:
    """Return the longest stable step [s]; infinite if nothing acts.

    An eigenvalue z / h of M x'' + C x' + K x = 0 solves z^2 + h c z + h^2 k = 0 with c <= max(damping_rate) and
    k <= max(omega)^2, since both are Rayleigh quotients. So z is complex with |z| <= h omega and Re z >= -h c / 2, or real and at
    least -h c: it is kept inside RK4's stability region by the reaches above. The limits of a body are those of
    its elements taken apart, not element by element: an undamped stiff one may meet a damped soft one in one mode.
    """
    fastest, most_damped = float(np.max(limits.frequency)), float(np.max(limits.damping_rate))
    if most_damped == 0.0:
        return IMAGINARY_REACH / fastest if fastest > 0.0 else np.inf
    if fastest == 0.0:
        return REAL_REACH / most_damped
    swing = min(IMAGINARY_REACH / fastest, max(SECTOR_REACH / fastest, 2.0 * STRIP_REACH / most_damped))
    return min(swing, REAL_REACH / most_damped)


def default_step(limits: Limits) -> float:
    """Return the part of the stable step [s] that suits violent motion too; see Integrator.default_step."""
    return 0.8 * stable_step(limits)


RK4 = Integrator("rk4", order=4, n_work=2, stable_step=stable_step, default_step=default_step, advance=advance, n_sweeps=4)
