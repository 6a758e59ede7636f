"""Backward (implicit) Euler: first order, stable at every step; for bodies far stiffer than what moves in them.

    M (v' - v) = h F(x', v'),    x' = x + h v'

is solved for v' by Newton's method: the forces are whatever sum_forces says, the matrix is that of the springs, positive
definite, so that each correction goes downhill (D. Baraff, A. Witkin, "Large steps in cloth simulation", 1998; E. Hairer,
G. Wanner, "Solving Ordinary Differential Equations II", 1996, section IV.8). A step too long for fast motions damps them.
"""

import numpy as np

from gmapspring.forces import sum_forces
from gmapspring.integrators import symplectic_euler
from gmapspring.integrators.integrator import Integrator, Limits, begin, end, next_substeps
from gmapspring.jit import kernel, part
from gmapspring.matter import N_NODES, N_SPRINGS, read_matter
from gmapspring.quad import dot, load, store
from gmapspring.spring_matrix import N_WORK, X, Y, make_system, set_matrix, solve

N_CORRECTIONS = 50
"""Newton's method gives up after so many; the state it then has is finite, and less exact."""
N_HALVINGS = 10
"""How often a correction that goes too far is halved."""
SHARE = 0.3
"""Each correction is solved for until this much of the residual is left."""
ACCURACY = 1e-6
"""Newton's method stops where the residual, as a velocity, is so small beside the velocities."""
STEPS_OF_EXPLICIT = 10.0
"""The default step is so many times what an explicit scheme of first order could take."""


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
    """Take n_substeps, each a root of the equation above."""
    nodes, n_nodes = matter.nodes, matter.counts[N_NODES]
    stage = matter.work[:n_nodes]
    system = make_system(nodes, matter.springs, n_nodes, matter.counts[N_SPRINGS], step, matter.work[n_nodes:])
    number = stage.dtype.type
    accuracy = number(ACCURACY * ACCURACY)
    for _ in range(n_substeps):
        for i in range(n_nodes):
            store(stage, i, 4, load(nodes.state, i, 4))
        size = find_residual(system, stage)
        exact, floor = accuracy * liveliness(system, stage), number(0)
        for _ in range(N_CORRECTIONS):
            if not size > max(exact, floor):
                break
            set_matrix(system, stage)
            slope = solve(system, number(SHARE))
            size = correct(system, stage, slope)
            exact, floor = accuracy * liveliness(system, stage), round_off(system, stage)
        finish(nodes, n_nodes, step, stage, size <= exact)


@part
def find_residual(system, stage):
    """Move the stage to where its velocity leads and set r = h F - M (v' - v) [N s]; return r . M^-1 r [J]."""
    nodes, step, number = system.nodes, system.step, stage.dtype.type
    for i in range(system.n_nodes):
        store(stage, i, 0, load(nodes.state, i, 0) + step * load(stage, i, 4))
    sum_forces(nodes, system.springs, system.n_nodes, system.n_springs, stage, nodes.force)
    size = number(0)
    for i in range(system.n_nodes):
        gained = number(nodes.mass[i]) * (load(stage, i, 4) - load(nodes.state, i, 4))
        residual = step * load(nodes.force, i, 0) - gained
        store(system.residual, i, X, residual)
        # Not over the mass at the end: in float32 the square of a tiny body's momentum is 0.
        size += dot(nodes.inverse_mass[i] * residual, residual)
    return size


@part
def correct(system, stage, slope):
    """Correct the stage by d, or by a half, a quarter, ... of it where d leads uphill in the end; return the new r . M^-1 r.

    Along d the residual starts as r . d = slope > 0. Past the lowest point it is negative: half the slope there is too far.
    """
    number = stage.dtype.type
    share, size = number(1), number(0)
    for i in range(system.n_nodes):
        store(stage, i, 4, load(stage, i, 4) + load(system.answer, i, Y))
    for _ in range(N_HALVINGS):
        size = find_residual(system, stage)
        last_slope = number(0)
        for i in range(system.n_nodes):
            last_slope += dot(load(system.residual, i, X), load(system.answer, i, Y))
        if not last_slope < number(-0.5) * slope:
            break
        share *= number(0.5)
        for i in range(system.n_nodes):
            store(stage, i, 4, load(stage, i, 4) - share * load(system.answer, i, Y))
    return size


@part
def liveliness(system, stage):
    """Return the size of what residuals are small by: momenta at both ends of the step, impulses from outside; p . M^-1 p [J]."""
    nodes, number = system.nodes, stage.dtype.type
    size = number(0)
    for i in range(system.n_nodes):
        before, after = load(nodes.state, i, 4), load(stage, i, 4)
        size += number(nodes.mass[i]) * (dot(before, before) + dot(after, after))
    if nodes.external.shape[0] > 0:
        for i in range(system.n_nodes):
            impulse = system.step * load(nodes.external, i, 0)
            size += dot(nodes.inverse_mass[i] * impulse, impulse)
    return size


@part
def round_off(system, stage):
    """Return the size of residuals that round-off alone makes: of positions, eps |x|, times the matrix over the step [J]."""
    nodes, factors, number = system.nodes, system.factors, stage.dtype.type
    size, unit = number(0), number(np.finfo(stage.dtype).eps) / system.step
    for i in range(system.n_nodes):
        if not nodes.is_pinned[i]:
            residual = (unit / min(factors[i, 4], factors[i, 5], factors[i, 6])) * load(stage, i, 0)
            size += dot(nodes.inverse_mass[i] * residual, residual)
    return size


@part
def finish(nodes, n_nodes, step, stage, is_exact):
    """Take the state to the end of the step."""
    state, force = nodes.state, nodes.force
    for i in range(n_nodes):
        velocity = load(stage, i, 4)
        if is_exact:
            # By the forces, not by the stage: what two nodes do to each other is then equal and opposite to the last bit. A
            # residual that is larger would be seen in the velocity, unsmoothed.
            velocity = load(state, i, 4) + (step * nodes.inverse_mass[i]) * load(force, i, 0)
        store(state, i, 4, velocity)
        store(state, i, 0, load(state, i, 0) + step * velocity)


def stable_step(limits: Limits) -> float:
    """Return infinity: with k, c >= 0 the roots of (1 + h c + h^2 k) z^2 - (2 + h c) z + 1 = 0 have |z| <= 1 at any step h."""
    return np.inf


def default_step(limits: Limits) -> float:
    """Return so many times what an explicit scheme could take [s]; infinite if nothing acts."""
    return STEPS_OF_EXPLICIT * symplectic_euler.stable_step(limits)


BACKWARD_EULER = Integrator("backward_euler", order=1, n_work=1 + N_WORK, stable_step=stable_step, default_step=default_step,
                            advance=advance, n_sweeps=500)  # fmt: skip
