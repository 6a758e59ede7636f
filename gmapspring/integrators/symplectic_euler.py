"""Symplectic (semi-implicit) Euler: first order, one force evaluation per step, bounded energy error.

Source: E. Hairer, C. Lubich, G. Wanner, "Geometric Numerical Integration", 2006, section I.1, eq. 1.9.
"""

import numpy as np

from gmapspring.forces import finish_forces, start_force, start_forces
from gmapspring.integrators.integrator import Integrator, Limits, begin, end, next_substeps
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
    """Take n_substeps: kick with the forces at the old state, damping included, then drift with the new velocity."""
    nodes, springs, n_nodes, n_springs = matter.nodes, matter.springs, matter.counts[N_NODES], matter.counts[N_SPRINGS]
    state, force = nodes.state, nodes.force
    start_forces(nodes, n_nodes, state, force)
    for _ in range(n_substeps):
        finish_forces(nodes, springs, n_nodes, n_springs, state, force)
        for i in range(n_nodes):
            velocity = load(state, i, 4) + (step * nodes.inverse_mass[i]) * load(force, i, 0)
            store(state, i, 4, velocity)
            store(state, i, 0, load(state, i, 0) + step * velocity)
            start_force(nodes, i, state, force)


def stable_step(limits: Limits) -> float:
    """Return the longest stable step [s]: (h omega)^2 + 2 h damping_rate <= 4 for every element; infinite if nothing acts.

    A mode x of M x'' + C x' + K x = 0 steps by (z - 1)^2 + h c (z - 1) + h^2 k z = 0 with c = x*Cx / x*Mx and k = x*Kx / x*Mx,
    whether or not C and K share their modes. By Jury's criterion |z| <= 1 if and only if h^2 k + 2 h c <= 4. The left side
    is a Rayleigh quotient of h^2 K + 2 h C, so it is at most the largest of the elements' own.
    """
    omega, damping_rate = np.asarray(limits.frequency, np.float64), np.asarray(limits.damping_rate, np.float64)
    # The positive root, in the form without cancellation; with neither stiffness nor damping there is no limit.
    with np.errstate(divide="ignore"):
        steps = 4.0 / (damping_rate + np.sqrt(damping_rate**2 + 4.0 * omega**2))
    return float(np.min(steps))


def default_step(limits: Limits) -> float:
    """Return the part of the stable step [s] that suits violent motion too; see Integrator.default_step."""
    return 0.5 * stable_step(limits)


SYMPLECTIC_EULER = Integrator("symplectic_euler", order=1, n_work=0, stable_step=stable_step, default_step=default_step,
                              advance=advance)  # fmt: skip
