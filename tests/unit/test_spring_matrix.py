"""The matrix of an implicit step against a dense one and against differences of forces, and its solver against LAPACK."""

from typing import NamedTuple

import numpy as np
import pytest
from numba import njit

import gmapspring as gs
from gmapspring import spring_matrix
from gmapspring.matter import N_NODES, N_SPRINGS, read_matter
from gmapspring.quad import dot, fourth, load
from tests import naive_mechanics
from tests.twins import Twins
from tests.unit.test_integrators import hanging_box
from tests.zoo import build

STEP = 0.05


class Answers(NamedTuple):
    """What the kernels make of a vector v, arrays (n, 3)."""

    product: np.ndarray
    """A v."""
    preconditioned: np.ndarray
    """The preconditioner's answer to v."""
    solution: np.ndarray
    """d with A d = v, up to a share of v."""
    slope: float
    """v . d."""


@njit
def ask(table, real, step, share, vector, product, preconditioned, solution):
    """Set the arrays of Answers and return the slope; all in one kernel, which compiles but once."""
    matter = read_matter(table, 0, real)
    n_nodes = matter.counts[N_NODES]
    system = spring_matrix.make_system(matter.nodes, matter.springs, n_nodes, matter.counts[N_SPRINGS], step, matter.work)
    spring_matrix.set_matrix(system, matter.nodes.state)
    for i in range(n_nodes):
        for axis in range(3):
            system.residual[i, axis] = system.residual[i, 4 + axis] = vector[i, axis]
        system.residual[i, 7] = 0
    spring_matrix.multiply(system)
    for i in range(n_nodes):
        for axis in range(3):
            product[i, axis] = system.answer[i, axis]
        preconditioned[i] = spring_matrix.precondition(system.factors, i, system.residual)
    slope = spring_matrix.solve(system, share)
    for i in range(n_nodes):
        for axis in range(3):
            solution[i, axis] = system.answer[i, 4 + axis]
    return slope


def answers(body, vector, share=0.1):
    """Return what the kernels make of a vector (n, 3)."""
    dtype = type(body.real)
    vector = vector.astype(dtype)
    arrays = [np.empty_like(vector) for _ in range(3)]
    slope = ask(body.table, body.real, dtype(STEP), dtype(share), vector, *arrays)
    return Answers(*arrays, float(slope))


def cut_box(dtype=np.float64, stretch=1.0):
    """Return a cut box in a deformed state, with all terms."""
    sim = hanging_box("backward_euler", dtype)
    sim.split_face(0, 1)
    sim.remove_tetrahedron(9)
    nodes = sim.body.nodes
    nodes.position[:] = stretch * nodes.position + 0.1 * np.random.default_rng(1).standard_normal(nodes.position.shape)
    sim.body.matter.work[:] = np.nan  # what scratch holds must not matter
    return sim.body


def dense(body, step=STEP):
    """Return A (3 n, 3 n), spring by spring."""
    nodes, springs, n = body.nodes, body.springs, body.n_nodes
    matrix = np.zeros((n, 3, n, 3))
    for node in range(n):
        matrix[node, :, node, :] += (nodes.mass[node] + step * nodes.viscosity[node]) * np.eye(3)
    for (i, j), stiffness, damping, rest in zip(*(np.asarray(a, float) for a in (springs.endpoints, springs.stiffness)),
                                                np.asarray(springs.damping, float), np.asarray(springs.rest_length, float),
                                                strict=True):  # fmt: skip
        i, j = int(i), int(j)
        offset = nodes.position[j].astype(float) - nodes.position[i]
        length = np.linalg.norm(offset)
        along = np.outer(offset, offset) / length**2
        block = (step**2 * stiffness + step * damping) * along
        block += step**2 * stiffness * max(0.0, 1 - rest / length) * (np.eye(3) - along)
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            matrix[a, :, b, :] += sign * block
    return matrix.reshape(3 * n, 3 * n)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_product_is_that_of_the_dense_matrix(dtype):
    body = cut_box(dtype)
    vector = np.random.default_rng(2).standard_normal((body.n_nodes, 3)).astype(dtype)
    found = answers(body, vector).product
    expected = dense(body) @ vector.ravel().astype(float)
    np.testing.assert_allclose(found.ravel(), expected, rtol=0, atol=20 * np.finfo(dtype).eps * np.abs(expected).max())


def test_the_matrix_is_positive_definite_however_the_body_is_squeezed():
    for stretch in (1.0, 0.3, -0.5, 0.0):
        assert np.linalg.eigvalsh(dense(cut_box(stretch=stretch))).min() > 0


def test_of_a_stretched_body_at_rest_the_matrix_is_the_derivative_of_the_residual():
    # Where all springs are stretched nothing is left out, and without motion damping has no other derivative.
    twins = Twins(build("slab"), seed=3, pinned_share=0.0, integrator="backward_euler")
    twins.sim.body.nodes.position[:] *= 1.5
    twins.sim.body.nodes.velocity[:] = 0.0
    twins.copy_state()
    system, body = naive_mechanics.assembled(twins.naive), twins.sim.body
    rest, still = system["position"], np.zeros_like(system["position"])
    direction = np.random.default_rng(4).standard_normal(rest.shape)

    def residual(share):
        """Return M dv - h F(x + h dv, dv) for a share of the direction, naively."""
        velocity = share * direction
        force = system["mass"][:, None] * naive_mechanics.acceleration(system, rest + STEP * velocity, still + velocity)
        return system["mass"][:, None] * velocity - STEP * force

    derivative = (residual(1e-6) - residual(-1e-6)) / 2e-6
    order = np.argsort(np.searchsorted(system["names"], lowest_corners(body)))
    in_order = np.empty_like(direction)
    in_order[order] = direction
    assert (gs.measure.edge_strains(body) > 0).all()
    found = answers(body, in_order).product[order]
    np.testing.assert_allclose(found, derivative, rtol=0, atol=1e-7 * np.abs(derivative).max())


def lowest_corners(body):
    """Return the lowest corner of each node, 4 * tetrahedron + column: how the naive body names it."""
    corners = np.full(body.n_nodes, body.vertex_of.size)
    np.minimum.at(corners, body.vertex_of.ravel(), np.arange(body.vertex_of.size))
    return corners


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_the_solver_agrees_with_lapack_and_leaves_pinned_nodes_alone(dtype):
    body = cut_box(dtype)
    is_pinned = body.nodes.is_pinned
    residual = np.random.default_rng(5).standard_normal((body.n_nodes, 3)).astype(dtype)
    precision = float(1e3 * np.finfo(dtype).eps)
    found, slope = answers(body, residual, precision)[2:]
    free = np.repeat(~is_pinned, 3)
    expected = np.linalg.solve(dense(body)[np.ix_(free, free)], residual.ravel()[free].astype(float))
    np.testing.assert_allclose(found.ravel()[free], expected, rtol=0, atol=100 * precision * np.abs(expected).max())
    assert is_pinned.any() and not found[is_pinned].any()
    assert slope == pytest.approx(float(residual.ravel()[free] @ expected), rel=100 * precision)


def test_a_coarse_answer_is_a_descent_and_leaves_the_share_of_the_residual():
    body = cut_box()
    body.springs.stiffness[:] *= 1e4
    free = np.repeat(~body.nodes.is_pinned, 3)
    residual = np.random.default_rng(6).standard_normal((body.n_nodes, 3))
    found, slope = answers(body, residual, 0.3)[2:]
    left = residual.ravel() - dense(body) @ found.ravel()
    assert slope > 0 and slope == pytest.approx(residual.ravel() @ found.ravel())

    def size(vector):
        """Return the norm that the solver measures residuals in."""
        vector = np.where(free, vector, 0.0).reshape(-1, 3)
        return np.sqrt(np.sum(vector * answers(body, vector).preconditioned))

    assert 0 < size(left) <= 0.3 * size(residual.ravel())


def test_the_preconditioner_is_the_inverse_of_each_nodes_block():
    body = cut_box()
    residual = np.random.default_rng(7).standard_normal((body.n_nodes, 3))
    found, matrix = answers(body, residual).preconditioned, dense(body)
    for node in range(body.n_nodes):
        block = matrix[3 * node: 3 * node + 3, 3 * node: 3 * node + 3]
        expected = np.zeros(3) if body.nodes.is_pinned[node] else np.linalg.solve(block, residual[node])
        np.testing.assert_allclose(found[node], expected, rtol=1e-10, atol=1e-12)


@njit
def quad_products(first, second):
    """Return the scalar product of two rows and the last number of the first."""
    return dot(load(first, 0, 0), load(second, 0, 0)), fourth(load(first, 0, 0))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_products_of_quads_are_their_readable_twins(dtype):
    rng = np.random.default_rng(8)
    for _ in range(50):
        first, second = (rng.standard_normal((1, 4)).astype(dtype) for _ in range(2))
        assert quad_products(first, second) == (dot(first[0], second[0]), fourth(first[0]))
