"""The matrix of an implicit step, and linear systems with it: conjugate gradients over the springs as they stand.

    A = M + h D + sum over springs of B,    B = t I + q q^T between its two ends,
    h^2 times the spring's stiffness matrix k n n^T + k (1 - l0 / l) (I - n n^T), and h c n n^T for its damping c

with n the spring's direction. Across a compressed spring the stiffness is negative; there it is left out, which keeps A
positive definite (Teran, Sifakis, Irving, Fedkiw, "Robust quasistatic finite elements and flesh simulation", 2005).

The pattern of A is the list of springs: block (i, j) of spring (i, j), node i in row i of the state. Cuts keep both true in the
time of the star they touch, so there is no pattern to build or to mend. Each product is one pass over the springs, in
their fixed order. The preconditioner is the 3 x 3 block of each node, factored: it takes up jumps of stiffness and mass.
"""

import math

from gmapspring.jit import part
from gmapspring.quad import dot, fourth, load, store

N_ITERATIONS = 1000
"""Conjugate gradients gives up after so many; what it then has is a descent all the same."""
X, Y = 0, 4
"""Where the two vectors of a row of eight start."""


@part
def set_blocks(springs, n_springs, state, step, blocks):
    """Set the blocks [qx qy qz t] of springs in a state; spring s has lanes 4 (s % 2) on of row s // 2, blocks (_, 8)."""
    number = state.dtype.type
    is_damped = springs.damping.shape[0] > 0
    for s in range(n_springs):
        row, lane = s >> 1, (s & 1) << 2
        i, j = springs.endpoints[s, 0], springs.endpoints[s, 1]
        x, y, z = state[j, 0] - state[i, 0], state[j, 1] - state[i, 1], state[j, 2] - state[i, 2]
        length = math.sqrt((x * x + y * y) + z * z)
        along = step * step * springs.stiffness[s]
        # A spring of length zero has no direction: it is taken as across all of them, at no more than its stiffness.
        across = along
        share = number(0)
        if length > number(0):
            across = along * max(number(1) - springs.rest_length[s] / length, number(0))
            if is_damped:
                along += step * springs.damping[s]
            share = math.sqrt(along - across) / length
        blocks[row, lane], blocks[row, lane + 1], blocks[row, lane + 2] = share * x, share * y, share * z
        blocks[row, lane + 3] = across


@part
def factor_diagonal(nodes, springs, n_nodes, n_springs, step, blocks, factors):
    """Set the preconditioner (_, 8), blocks of nodes as L D L^T: [l10 l20 l21 0 1/d0 1/d1 1/d2 0]; 1/d = 0 where pinned."""
    number = factors.dtype.type
    for i in range(n_nodes):
        for lane in range(8):
            factors[i, lane] = number(0)
    for s in range(n_springs):
        row, lane = s >> 1, (s & 1) << 2
        x, y, z, across = blocks[row, lane], blocks[row, lane + 1], blocks[row, lane + 2], blocks[row, lane + 3]
        for end in range(2):
            i = springs.endpoints[s, end]
            factors[i, 0] += x * y
            factors[i, 1] += x * z
            factors[i, 2] += y * z
            factors[i, 4] += x * x + across
            factors[i, 5] += y * y + across
            factors[i, 6] += z * z + across
    for i in range(n_nodes):
        least = inertia(nodes, i, step)
        a10, a20, a21 = factors[i, 0], factors[i, 1], factors[i, 2]
        d0 = factors[i, 4] + least
        l10, l20 = a10 / d0, a20 / d0
        # No pivot is below the node's own inertia, save by round-off.
        d1 = max(factors[i, 5] + least - l10 * a10, least)
        l21 = (a21 - l20 * a10) / d1
        d2 = max(factors[i, 6] + least - l20 * a20 - l21 * (l21 * d1), least)
        is_free = number(not nodes.is_pinned[i])
        factors[i, 0], factors[i, 1], factors[i, 2] = l10, l20, l21
        factors[i, 4], factors[i, 5], factors[i, 6] = is_free / d0, is_free / d1, is_free / d2


@part
def inertia(nodes, i, step):
    """Return what a node alone resists a change of its velocity with: mass and drag over the step [kg]."""
    number = nodes.state.dtype.type
    mass = number(nodes.mass[i])
    return mass + step * nodes.viscosity[i] if nodes.viscosity.shape[0] > 0 else mass


@part
def precondition(factors, i, residual):
    """Return the preconditioner's answer to a node's residual, as three numbers; zero where pinned."""
    l10, l20, l21 = factors[i, 0], factors[i, 1], factors[i, 2]
    y0 = residual[i, 0]
    y1 = residual[i, 1] - l10 * y0
    y2 = residual[i, 2] - l20 * y0 - l21 * y1
    z2 = y2 * factors[i, 6]
    z1 = y1 * factors[i, 5] - l21 * z2
    z0 = y0 * factors[i, 4] - l10 * z1 - l20 * z2
    return z0, z1, z2


@part
def multiply(nodes, springs, n_nodes, n_springs, step, blocks, vectors, products):
    """Set lanes 0 to 3 of products to A times lanes 4 to 7 of vectors, both (_, 8)."""
    for i in range(n_nodes):
        store(products, i, X, inertia(nodes, i, step) * load(vectors, i, Y))
    for s in range(n_springs):
        i, j = springs.endpoints[s, 0], springs.endpoints[s, 1]
        difference = load(vectors, j, Y) - load(vectors, i, Y)
        block = load(blocks, s >> 1, (s & 1) << 2)
        # The last lane of vectors is zero, that of products is not used.
        pull = fourth(block) * difference + dot(block, difference) * block
        store(products, i, X, load(products, i, X) - pull)
        store(products, j, X, load(products, j, X) + pull)


@part
def solve(nodes, springs, n_nodes, n_springs, step, blocks, factors, system, steps, share):
    """Solve A d = r by conjugate gradients until the residual is a share of r; return r . d.

    system (_, 8): r in lanes 0 to 3, which is destroyed, scratch in the others. steps (_, 8): scratch, and d in lanes 4 to 7.
    Source: Y. Saad, "Iterative Methods for Sparse Linear Systems", 2003, algorithm 9.1.
    """
    number = system.dtype.type
    size = number(0)
    zero = number(0)
    for i in range(n_nodes):
        for lane in range(8):
            steps[i, lane] = zero
        z0, z1, z2 = precondition(factors, i, system)
        system[i, 4], system[i, 5], system[i, 6], system[i, 7] = z0, z1, z2, zero
        size += dot(load(system, i, X), load(system, i, Y))
    goal, gained = share * share * size, zero
    for _ in range(N_ITERATIONS):
        if not size > goal:
            break
        multiply(nodes, springs, n_nodes, n_springs, step, blocks, system, steps)
        curvature = zero
        for i in range(n_nodes):
            curvature += dot(load(system, i, Y), load(steps, i, X))
        length = size / curvature
        gained += length * size
        size = descend(n_nodes, factors, system, steps, length, size)
    return gained


@part
def descend(n_nodes, factors, system, steps, length, size):
    """Go along the direction, then turn it; return the new size of the residual, r . z."""
    before, size = size, system.dtype.type(0)
    for i in range(n_nodes):
        store(steps, i, Y, load(steps, i, Y) + length * load(system, i, Y))
        store(system, i, X, load(system, i, X) - length * load(steps, i, X))
        z0, z1, z2 = precondition(factors, i, system)
        steps[i, 0], steps[i, 1], steps[i, 2], steps[i, 3] = z0, z1, z2, system.dtype.type(0)
        size += dot(load(system, i, X), load(steps, i, X))
    turn = size / before
    for i in range(n_nodes):
        store(system, i, Y, load(steps, i, X) + turn * load(system, i, Y))
    return size
