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
from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import part
from gmapspring.quad import dot, fourth, load, store

N_ITERATIONS = 1000
"""Conjugate gradients gives up after so many; what it then has is a descent all the same."""
X, Y = 0, 4
"""Where the two vectors of a row of eight start."""
N_WORK = 4
"""States of scratch that a system needs: three, and one for the blocks of springs, of which there is room for 3/2 a node."""


class System(NamedTuple):
    """A linear system A d = r and the room to solve it in. All arrays have rows of eight, one for each node save blocks."""

    nodes: Any
    springs: Any
    n_nodes: int
    n_springs: int
    step: float
    """h [s]."""
    residual: np.ndarray
    """Lanes X: r [N s], destroyed by solving. Lanes Y: the direction of search."""
    answer: np.ndarray
    """Lanes Y: d [m/s]. Lanes X: scratch."""
    factors: np.ndarray
    """The preconditioner, blocks of nodes as L D L^T: [l10 l20 l21 0 1/d0 1/d1 1/d2 0]; 1/d = 0 where pinned."""
    blocks: np.ndarray
    """Blocks of springs, [qx qy qz t]: spring s has lanes 4 (s % 2) on of row s // 2."""


@part
def make_system(nodes, springs, n_nodes, n_springs, step, work):
    """Return a system with its arrays in work (_, 8)."""
    return System(nodes, springs, n_nodes, n_springs, step, work[:n_nodes], work[n_nodes: 2 * n_nodes],
                  work[2 * n_nodes: 3 * n_nodes], work[3 * n_nodes:])  # fmt: skip


@part
def set_matrix(system, state):
    """Set A for springs as they are in a state (_, 8), and its preconditioner."""
    set_blocks(system, state)
    add_up_diagonal(system)
    factor_diagonal(system)


@part
def set_blocks(system, state):
    """Set the blocks of springs."""
    springs, step, blocks, number = system.springs, system.step, system.blocks, state.dtype.type
    is_damped = springs.damping.shape[0] > 0
    for s in range(system.n_springs):
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
def add_up_diagonal(system):
    """Set factors to the springs' share of each node's block of A, [xy xz yz 0 xx yy zz 0]."""
    factors, blocks, endpoints = system.factors, system.blocks, system.springs.endpoints
    for i in range(system.n_nodes):
        for lane in range(8):
            factors[i, lane] = factors.dtype.type(0)
    for s in range(system.n_springs):
        row, lane = s >> 1, (s & 1) << 2
        x, y, z, across = blocks[row, lane], blocks[row, lane + 1], blocks[row, lane + 2], blocks[row, lane + 3]
        for end in range(2):
            i = endpoints[s, end]
            factors[i, 0] += x * y
            factors[i, 1] += x * z
            factors[i, 2] += y * z
            factors[i, 4] += x * x + across
            factors[i, 5] += y * y + across
            factors[i, 6] += z * z + across


@part
def factor_diagonal(system):
    """Put the factors of each node's block in place of the block."""
    factors, is_pinned = system.factors, system.nodes.is_pinned
    for i in range(system.n_nodes):
        least = inertia(system, i)
        a10, a20, a21 = factors[i, 0], factors[i, 1], factors[i, 2]
        d0 = factors[i, 4] + least
        l10, l20 = a10 / d0, a20 / d0
        # No pivot is below the node's own inertia, save by round-off.
        d1 = max(factors[i, 5] + least - l10 * a10, least)
        l21 = (a21 - l20 * a10) / d1
        d2 = max(factors[i, 6] + least - l20 * a20 - l21 * (l21 * d1), least)
        is_free = factors.dtype.type(not is_pinned[i])
        factors[i, 0], factors[i, 1], factors[i, 2] = l10, l20, l21
        factors[i, 4], factors[i, 5], factors[i, 6] = is_free / d0, is_free / d1, is_free / d2


@part
def inertia(system, i):
    """Return what a node alone resists a change of its velocity with: mass and drag over the step [kg]."""
    nodes = system.nodes
    mass = nodes.state.dtype.type(nodes.mass[i])
    return mass + system.step * nodes.viscosity[i] if nodes.viscosity.shape[0] > 0 else mass


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
def multiply(system):
    """Set lanes X of the answer to A times the direction."""
    direction, product, blocks, endpoints = system.residual, system.answer, system.blocks, system.springs.endpoints
    for i in range(system.n_nodes):
        store(product, i, X, inertia(system, i) * load(direction, i, Y))
    for s in range(system.n_springs):
        i, j = endpoints[s, 0], endpoints[s, 1]
        difference = load(direction, j, Y) - load(direction, i, Y)
        block = load(blocks, s >> 1, (s & 1) << 2)
        # The last lane of a direction is zero, that of the product is not used.
        pull = fourth(block) * difference + dot(block, difference) * block
        store(product, i, X, load(product, i, X) - pull)
        store(product, j, X, load(product, j, X) + pull)


@part
def solve(system, share):
    """Solve A d = r by conjugate gradients until a share of the residual is left; return r . d.

    Source: Y. Saad, "Iterative Methods for Sparse Linear Systems", 2003, algorithm 9.1.
    """
    residual, answer = system.residual, system.answer
    zero = residual.dtype.type(0)
    size = zero
    for i in range(system.n_nodes):
        for lane in range(8):
            answer[i, lane] = zero
        z0, z1, z2 = precondition(system.factors, i, residual)
        residual[i, 4], residual[i, 5], residual[i, 6], residual[i, 7] = z0, z1, z2, zero
        size += dot(load(residual, i, X), load(residual, i, Y))
    goal, gained = share * share * size, zero
    for _ in range(N_ITERATIONS):
        if not size > goal:
            break
        multiply(system)
        curvature = zero
        for i in range(system.n_nodes):
            curvature += dot(load(residual, i, Y), load(answer, i, X))
        length = size / curvature
        gained += length * size
        size = descend(system, length, size)
    return gained


@part
def descend(system, length, size):
    """Go along the direction, then turn it; return the new size of the residual, r . z."""
    residual, answer = system.residual, system.answer
    before, size = size, residual.dtype.type(0)
    for i in range(system.n_nodes):
        store(answer, i, Y, load(answer, i, Y) + length * load(residual, i, Y))
        store(residual, i, X, load(residual, i, X) - length * load(answer, i, X))
        z0, z1, z2 = precondition(system.factors, i, residual)
        answer[i, 0], answer[i, 1], answer[i, 2], answer[i, 3] = z0, z1, z2, residual.dtype.type(0)
        size += dot(load(residual, i, X), load(answer, i, X))
    turn = size / before
    for i in range(system.n_nodes):
        store(residual, i, Y, load(answer, i, X) + turn * load(residual, i, Y))
    return size
