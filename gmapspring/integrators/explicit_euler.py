"""Explicit (forward) Euler: first order, one force evaluation per step; the scheme of the paper, here for comparison.

It feeds energy to every swinging motion, h^2 omega^2 a step: only damping can make up for that, and without drag there is no
stable step. Source: E. Hairer, S. Norsett, G. Wanner, "Solving Ordinary Differential Equations I", 1993, section I.7.
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
    """Take n_substeps: kick with the forces at the old state, and drift with the old velocity."""
    nodes, springs, n_nodes, n_springs = matter.nodes, matter.springs, matter.counts[N_NODES], matter.counts[N_SPRINGS]
    state, force = nodes.state, nodes.force
    start_forces(nodes, n_nodes, state, force)
    for _ in range(n_substeps):
        finish_forces(nodes, springs, n_nodes, n_springs, state, force)
        for i in range(n_nodes):
            velocity = load(state, i, 4)
            store(state, i, 0, load(state, i, 0) + step * velocity)
            store(state, i, 4, velocity + (step * nodes.inverse_mass[i]) * load(force, i, 0))
            start_force(nodes, i, state, force)


def stable_step(limits: Limits) -> float:
    """Return the longest stable step [s]: h omega^2 <= drag and h damping_rate <= 2 for every element.

    Zero where an element has stiffness and no drag; infinite if nothing acts. A mode x of M x'' + C x' + K x = 0 steps by
    (z - 1)^2 + h c (z - 1) + h^2 k = 0 with c = x*Cx / x*Mx and k = x*Kx / x*Mx. By Jury's criterion |z| <= 1 if and only if
    h k <= c and 2 h c <= 4 + h^2 k. The first asks for C - h K >= 0. Damping of springs cannot grant it: it acts along them,
    the stiffness of a stretched spring across it too. Drag does, where it does so element by element. For the second, h c <= 2
    suffices.
    """
    omega, damping_rate, drag = (np.asarray(limit, np.float64) for limit in limits)
    # Without stiffness there is nothing to swing, whatever the drag.
    with np.errstate(divide="ignore", invalid="ignore"):
        swinging = np.where(omega > 0.0, drag / omega**2, np.inf)
        creeping = 2.0 / damping_rate
    return float(min(np.min(swinging), np.min(creeping)))


def default_step(limits: Limits) -> float:
    """Return half of the stable step [s]: at the bound itself a swinging motion never comes to rest."""
    return 0.5 * stable_step(limits)


EXPLICIT_EULER = Integrator("explicit_euler", order=1, n_work=0, stable_step=stable_step, default_step=default_step,
                            advance=advance)  # fmt: skip
