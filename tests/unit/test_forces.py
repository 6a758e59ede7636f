"""Forces: each term against its formula, the sum of all against NumPy and against the gradient of the energy."""

import re

import numba
import numpy as np
import pytest

import gmapspring as gs
from gmapspring import forces
from gmapspring.matter import Nodes, empty_springs
from tests import zoo

DTYPES = (np.float64, np.float32)
ROUND_OFF = {np.float64: 1e-13, np.float32: 1e-5}
"""Relative: a few hundred units in the last place."""
without_compiler = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="nothing is compiled")


def two_nodes(offset, velocity=(0.0, 0.0, 0.0), dtype=np.float64, damping=None):
    """Return nodes and one spring of stiffness 3 N/m and rest length 2 m from the origin to a moving node."""
    state = np.zeros((2, 8), dtype)
    state[1, :3], state[1, 4:7] = offset, velocity
    nodes = Nodes(state=state, force=np.full((2, 4), 7.0, dtype), external=np.zeros((0, 4), dtype), mass=np.ones(2),
                  inverse_mass=np.ones(2, dtype), viscosity=np.zeros(0, dtype), is_pinned=np.zeros(2, bool),
                  point=np.zeros(2, np.int32))  # fmt: skip
    springs = empty_springs(1, dtype, damping is not None)
    springs.endpoints[0], springs.rest_length[0], springs.stiffness[0] = (0, 1), 2.0, 3.0
    springs.damping[:1] = 0.0 if damping is None else damping
    return nodes, springs


@numba.njit
def sum_forces(nodes, springs, n_nodes, n_springs, state, force):
    """Call what only kernels can call."""
    forces.sum_forces(nodes, springs, n_nodes, n_springs, state, force)


def force_of(nodes, springs):
    """Return the forces (n, 3) [N] in the state of the nodes."""
    sum_forces(nodes, springs, len(nodes.mass), 1, nodes.state, nodes.force)
    return nodes.force[:, :3].copy()


def stirred(name="box", dtype=np.float64, damping=2e-3, viscosity=0.5, gravity=(0.3, -0.2, -9.81)):
    """Return a body of the zoo, stretched and moving at random."""
    material = gs.Material(young_modulus=5e3, density=1e3, damping=damping, viscosity=viscosity)
    body = gs.Simulation(zoo.build(name), material, gravity=gravity, dtype=dtype).body
    rng = np.random.default_rng(1)
    body.nodes.position[:] += 0.1 * rng.standard_normal(body.nodes.position.shape)
    body.nodes.velocity[:] = rng.standard_normal(body.nodes.velocity.shape)
    return body


def body_force(body):
    """Return the forces (n, 3) [N] on the live nodes of a body."""
    rows = body.node_rows
    sum_forces(rows, body.spring_rows, body.n_nodes, body.n_springs, rows.state, rows.force)
    return rows.force[: body.n_nodes, :3].copy()


def numpy_force(body):
    """Return the same by plain NumPy in float64."""
    nodes, springs = body.nodes, body.springs
    position, velocity = nodes.position.astype(float), nodes.velocity.astype(float)
    force = np.zeros_like(position)
    if len(nodes.external):
        force += nodes.external[:, :3]
    if len(nodes.viscosity):
        force -= nodes.viscosity[:, None] * velocity
    i, j = springs.endpoints.T
    length = np.linalg.norm(position[j] - position[i], axis=1)
    direction = (position[j] - position[i]) / length[:, None]
    tension = springs.stiffness * (length - springs.rest_length)
    if len(springs.damping):
        tension += springs.damping * np.sum((velocity[j] - velocity[i]) * direction, axis=1)
    np.add.at(force, i, tension[:, None] * direction)
    np.add.at(force, j, -tension[:, None] * direction)
    return force


def compiled_code(kernel, *arguments):
    """Return the machine-neutral code of a kernel and all that it calls, compiled for such arguments, past the cache."""
    fresh = numba.njit(kernel.py_func, error_model="numpy")
    fresh(*arguments)
    return fresh.inspect_llvm(fresh.signatures[0])


@pytest.mark.parametrize("dtype", DTYPES)
def test_a_stretched_spring_pulls_its_ends_together(dtype):
    # k (l - l0) = 3 N/m * (5 m - 2 m) = 9 N, towards the other end.
    np.testing.assert_array_equal(force_of(*two_nodes((0, 0, 5), dtype=dtype)), [(0, 0, 9), (0, 0, -9)])


def test_a_compressed_spring_pushes_its_ends_apart():
    # 3 N/m * (1 m - 2 m) = -3 N.
    np.testing.assert_array_equal(force_of(*two_nodes((-1, 0, 0))), [(3, 0, 0), (-3, 0, 0)])


def test_damping_resists_the_change_of_length_alone():
    # c times the speed along the spring: 0.5 N s/m * 4 m/s = 2 N; the 7 m/s across it do not count.
    moving = two_nodes((2, 0, 0), velocity=(4, 7, 0), damping=0.5)
    np.testing.assert_array_equal(force_of(*moving), [(2, 0, 0), (-2, 0, 0)])


def test_viscosity_resists_motion():
    nodes, springs = two_nodes((2, 0, 0), velocity=(4, 7, 0))
    nodes = nodes._replace(viscosity=np.array([1.0, 0.25]))
    # -0.25 N s/m * (4, 7, 0) m/s
    np.testing.assert_array_equal(force_of(nodes, springs), [(0, 0, 0), (-1, -1.75, 0)])


def test_external_forces_are_taken_as_they_are():
    nodes, springs = two_nodes((2, 0, 0))
    nodes = nodes._replace(external=np.array([(1.0, 2.0, 3.0, 0.0), (4.0, 5.0, 6.0, 0.0)]))
    np.testing.assert_array_equal(force_of(nodes, springs), [(1, 2, 3), (4, 5, 6)])


def test_without_any_term_named_a_body_at_rest_feels_nothing():
    np.testing.assert_array_equal(force_of(*two_nodes((0, 2, 0))), np.zeros((2, 3)))


@pytest.mark.parametrize("damping", [None, 0.5])
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("length", [0.0, 1e-30, 1e-200])
def test_a_spring_of_no_length_stays_finite(length, dtype, damping):
    force = force_of(*two_nodes((length, 0, 0), velocity=(1, 1, 1), dtype=dtype, damping=damping))
    assert np.isfinite(force).all()
    if length == 0.0:
        np.testing.assert_array_equal(force, np.zeros((2, 3)))


@pytest.mark.parametrize("terms", [{}, {"damping": 0.0}, {"viscosity": 0.0}, {"gravity": (0, 0, 0)}])
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("name", ["single", "box", "ball"])
def test_forces_equal_those_by_numpy(name, dtype, terms):
    body = stirred(name, dtype, **terms)
    expected = numpy_force(body)
    np.testing.assert_allclose(body_force(body), expected, rtol=0, atol=ROUND_OFF[dtype] * np.abs(expected).max())


def test_elastic_force_is_the_gradient_of_elastic_energy():
    body = stirred(damping=0.0, viscosity=0.0, gravity=(0, 0, 0))
    i, j = body.springs.endpoints.T

    def energy(position):
        """Return the sum of k (l - l0)^2 / 2, for complex positions too."""
        length = np.sqrt(np.sum((position[j] - position[i]) ** 2, axis=1))
        return 0.5 * np.sum(body.springs.stiffness * (length - body.springs.rest_length) ** 2)

    gradient = np.zeros((body.n_nodes, 3))
    for place in np.ndindex(gradient.shape):
        # The complex step, f'(x) = Im f(x + i h) / h + O(h^2), loses no digits to cancellation.
        position = body.nodes.position.astype(complex)
        position[place] += 1e-30j
        gradient[place] = energy(position).imag / 1e-30
    np.testing.assert_allclose(body_force(body), -gradient, rtol=0, atol=1e-13 * np.abs(gradient).max())


def test_spring_forces_have_neither_a_sum_nor_a_torque():
    body = stirred(viscosity=0.0, gravity=(0, 0, 0))
    force = body_force(body)
    scale = np.abs(force).sum()
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-14 * scale)
    reach = np.abs(body.nodes.position).max()
    np.testing.assert_allclose(np.cross(body.nodes.position, force).sum(axis=0), 0.0, atol=1e-14 * scale * reach)


def test_a_whole_body_at_rest_feels_only_round_off():
    body = gs.Simulation(zoo.build("ball"), gs.Material(young_modulus=5e3, density=1e3)).body
    # Each length is rounded once or twice in the last of 53 bits; the scale is k l of the springs at a node.
    scale = np.max(body.springs.stiffness * body.springs.rest_length)
    assert np.abs(body_force(body)).max() <= 20 * np.finfo(np.float64).eps * scale


@without_compiler
@pytest.mark.parametrize("damping", [0.0, 1e-3])
def test_the_loops_of_a_float32_body_hold_no_float64_arithmetic(damping):
    body = stirred("single", np.float32, damping=damping)
    rows = body.node_rows
    code = compiled_code(forces.sum_forces, rows, body.spring_rows, body.n_nodes, body.n_springs, rows.state, rows.force)
    assert "sqrt" in code and re.search(r"= f(add|sub|mul|div) <16 x float> ", code)
    assert not re.search(r"= f(add|sub|mul|div) (<\d+ x )?double|fpext", code)
