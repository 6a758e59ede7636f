"""Velocity Verlet (leapfrog): second order, bounded energy error; one force evaluation per step, three where there is damping.

    v += h/2 a(x, v);    x += h v;    v += h/2 a(x, v')    with v' = v + h/2 a(x, v), so that the last kick is nearly implicit

The first kick is explicit in the velocity and the last one adjoint to it, up to third order: so damping is of second order too.
Source: E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2006, sections I.1.4 and II.3.
"""

import numpy as np

from gmapspring.forces import sum_forces
from gmapspring.integrators.integrator import Integrator, Limits, begin, end, next_substeps
from gmapspring.integrators.symplectic_euler import stable_step as stable_step_of_one_kick
from gmapspring.jit import kernel, part
from gmapspring.matter import N_NODES, N_SPRINGS, read_matter
from gmapspring.quad import load, store


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
    """Take n_substeps of kick, drift, kick."""
    nodes, springs, n_nodes, n_springs = matter.nodes, matter.springs, matter.counts[N_NODES], matter.counts[N_SPRINGS]
    state, force, stage = nodes.state, nodes.force, matter.work
    half = state.dtype.type(step / state.dtype.type(2))
    is_damped = springs.damping.shape[0] > 0 or nodes.viscosity.shape[0] > 0
    sum_forces(nodes, springs, n_nodes, n_springs, state, force)
    for substep in range(n_substeps):
        if is_damped and substep > 0:
            sum_forces(nodes, springs, n_nodes, n_springs, state, force)
        for i in range(n_nodes):
            velocity = load(state, i, 4) + (half * nodes.inverse_mass[i]) * load(force, i, 0)
            store(state, i, 4, velocity)
            store(state, i, 0, load(state, i, 0) + step * velocity)
        # Without damping these are the forces of the next first kick too.
        sum_forces(nodes, springs, n_nodes, n_springs, state, force)
        if is_damped:
            kick(nodes, n_nodes, half, stage)
            sum_forces(nodes, springs, n_nodes, n_springs, stage, force)
        kick(nodes, n_nodes, half, state)


@part
def kick(nodes, n_nodes, seconds, target):
    """Set the velocity in target to that of the state, pushed by the forces for some seconds, and the position to the state's."""
    state, force = nodes.state, nodes.force
    for i in range(n_nodes):
        store(target, i, 0, load(state, i, 0))
        store(target, i, 4, load(state, i, 4) + (seconds * nodes.inverse_mass[i]) * load(force, i, 0))


def stable_step(limits: Limits) -> float:
    """Return the longest stable step [s]: that of symplectic Euler, (h omega)^2 + 2 h damping_rate <= 4 for every element.

    A step's eigenvalues do not change if its kicks are put together: then it is one kick by -S (h C v + h^2 K x), S = I - b/2 +
    b^2/8 with b = h M^-1 C, and one drift, as in symplectic Euler with the mass M S^-1. For b <= 4, S is positive and at
    most the identity: this mass is at least M, and heavier bodies allow longer steps.
    """
    return stable_step_of_one_kick(limits)


def default_step(limits: Limits) -> float:
    """Return half of the stable step [s]; see Integrator.default_step."""
    return 0.5 * stable_step(limits)


VELOCITY_VERLET = Integrator("velocity_verlet", order=2, n_work=1, stable_step=stable_step, default_step=default_step,
                             advance=advance, n_sweeps=3)  # fmt: skip
