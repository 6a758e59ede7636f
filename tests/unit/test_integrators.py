"""Every registered scheme: its order by slope, what it does exactly, and what it must never touch."""

import re
import sys

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import gmapspring as gs
from gmapspring.integrators import INTEGRATORS
from tests import zoo
from tests.unit.test_forces import compiled_code, without_compiler

DTYPES = (np.float64, np.float32)
every_scheme = pytest.mark.parametrize("scheme", sorted(INTEGRATORS))


def hanging_box(scheme, dtype=np.float64, pinned=True, gravity=(0.0, 0.0, -9.81), **material):
    """Return a small soft box, held at one end, thrown into a smooth and large motion."""
    mesh = zoo.build("slab")
    mask = (mesh.points[:, 0] < 0.5) & pinned
    properties = {"young_modulus": 5e3, "density": 1e3, "damping": 0.02, "viscosity": 0.3, **material}
    sim = gs.Simulation(mesh, gs.Material(**properties), pinned=mask, gravity=gravity, integrator=scheme, dtype=dtype)
    x, y, z = sim.body.nodes.position.T.astype(float)
    velocity = 2.0 * np.stack([np.sin(y + z), x * np.cos(z), np.sin(x) - y], axis=1)
    sim.body.nodes.velocity[:] = np.where(sim.body.nodes.is_pinned[:, None], 0.0, velocity)
    return sim


def usual_step(sim):
    """Return a step [s] that all schemes can take, a fifth of what symplectic Euler could, or less."""
    limits = gs.stability.element_limits(sim.body.mesh, sim.body.tetrahedra)
    return 0.2 * min(INTEGRATORS[name].stable_step(limits) for name in {"symplectic_euler", sim.integrator.name})


def advance(sim, step, n_substeps):
    """Take substeps of exactly one length, past the shell that would choose them."""
    sim.body.matter.work[:] = np.nan  # what scratch holds must not matter
    sim._take_substeps(step, n_substeps)
    return sim.body.nodes.state.copy()


def exact_state(sim, seconds):
    """Return the state (n, 8) after some time by SciPy's eighth-order scheme, with forces by NumPy."""
    nodes, springs = sim.body.nodes, sim.body.springs
    i, j = springs.endpoints.T

    def slope(_, flat):
        """Return the derivative of the flattened rows [x y z 0 u v w 0]."""
        state = flat.reshape(-1, 8)
        position, velocity = state[:, :3], state[:, 4:7]
        difference = position[j] - position[i]
        length = np.linalg.norm(difference, axis=1)
        rate = np.sum((velocity[j] - velocity[i]) * difference, axis=1) / length
        tension = springs.stiffness * (length - springs.rest_length) + springs.damping * rate
        pull = (tension / length)[:, None] * difference
        force = nodes.external[:, :3] - nodes.viscosity[:, None] * velocity
        np.add.at(force, i, pull)
        np.add.at(force, j, -pull)
        zero = np.zeros((len(state), 1))
        return np.hstack([velocity, zero, nodes.inverse_mass[:, None] * force, zero]).ravel()

    solution = solve_ivp(slope, (0.0, seconds), nodes.state.ravel(), "DOP853", rtol=1e-12, atol=1e-13)
    return solution.y[:, -1].reshape(-1, 8)


def free_node(scheme, viscosity=0.0, gravity=(0.0, 0.0, 0.0)):
    """Return one tetrahedron without stiffness that moves at 1 m/s along x."""
    material = gs.Material(young_modulus=0.0, density=1.0, viscosity=viscosity)
    sim = gs.Simulation(gs.meshes.single(), material, gravity=gravity, integrator=scheme)
    sim.body.nodes.velocity[:, 0] = 1.0
    return sim


@pytest.mark.parametrize("name", sorted(INTEGRATORS))
def test_a_scheme_is_registered_under_its_own_name(name):
    assert INTEGRATORS[name].name == name
    assert INTEGRATORS[name].order >= 1


@every_scheme
def test_the_error_shrinks_with_the_declared_order(scheme):
    seconds = 0.3
    order = INTEGRATORS[scheme].order
    exact = exact_state(hanging_box(scheme), seconds)
    n_steps = np.array([40, 80, 160, 320] if order > 1 else [640, 1280, 2560, 5120])
    assert hanging_box(scheme).stable_step > seconds / n_steps[0]
    errors = [np.abs(advance(hanging_box(scheme), seconds / n, n) - exact).max() for n in n_steps]
    # error = C h^order, so log(error) falls by `order` for each unit of log(n).
    slope = -np.polyfit(np.log(n_steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.15)


@every_scheme
def test_free_fall_follows_its_formula(scheme):
    sim = free_node(scheme, gravity=(0.0, 0.0, -10.0))
    start, h, n = sim.body.nodes.position.copy(), 0.01, 50
    state = advance(sim, h, n)
    # Schemes of second order are exact for a parabola: -g t^2 / 2. Those of first order add h v after or before every kick.
    drop = {"explicit_euler": 10.0 * h * h * n * (n - 1) / 2}
    drop |= dict.fromkeys(("rk4", "velocity_verlet"), 10.0 * (n * h) ** 2 / 2)
    drop |= dict.fromkeys(("symplectic_euler", "backward_euler"), 10.0 * h * h * n * (n + 1) / 2)
    np.testing.assert_allclose(state[:, 0] - start[:, 0], n * h, rtol=1e-13)
    np.testing.assert_allclose(state[:, 6], -10.0 * n * h, rtol=1e-13)
    if scheme in drop:
        np.testing.assert_allclose(start[:, 2] - state[:, 2], drop[scheme], rtol=1e-13)


@every_scheme
def test_drag_slows_a_free_body_by_the_schemes_own_factor(scheme):
    h, gamma = 0.1, 3.0
    z = -h * gamma
    # v' = -gamma v: one step multiplies v by the scheme's stability function, which is exp(z) up to the order.
    factor = {"rk4": 1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24, "symplectic_euler": 1 + z, "explicit_euler": 1 + z,
              "velocity_verlet": (1 + z / 2) * (1 + z / 2 + z**2 / 4), "backward_euler": 1 / (1 - z)}  # fmt: skip
    speed = advance(free_node(scheme, viscosity=gamma), h, 1)[:, 4]
    np.testing.assert_allclose(speed, factor.get(scheme, np.exp(z)), rtol=1e-14 if scheme in factor else z**2)


@every_scheme
@pytest.mark.parametrize("dtype", DTYPES)
def test_pinned_nodes_do_not_move_by_a_bit_even_if_given_a_velocity(scheme, dtype):
    sim = hanging_box(scheme, dtype)
    is_pinned = sim.body.nodes.is_pinned
    assert is_pinned.any()
    sim.body.nodes.velocity[:] = 3.0
    before = sim.body.nodes.position[is_pinned].copy()
    advance(sim, usual_step(sim), 50)
    assert sim.body.nodes.position[is_pinned].tobytes() == before.tobytes()
    np.testing.assert_array_equal(sim.body.nodes.velocity[is_pinned], 0.0)
    assert np.all(sim.body.nodes.position[~is_pinned] != sim.body.mesh.points[sim.body.nodes.point[~is_pinned]])


@every_scheme
@pytest.mark.parametrize("dtype", DTYPES)
def test_one_call_equals_many_bit_for_bit(scheme, dtype):
    one, many = hanging_box(scheme, dtype), hanging_box(scheme, dtype)
    step = usual_step(one)
    advance(one, step, 30)
    for _ in range(30):
        advance(many, step, 1)
    assert one.body.nodes.state.tobytes() == many.body.nodes.state.tobytes()


@every_scheme
def test_spare_rows_and_padding_stay_as_they_are(scheme):
    sim = hanging_box(scheme)
    rows = sim.body.node_rows
    rows.state[sim.body.n_nodes :] = 5.0
    state = advance(sim, usual_step(sim), 10)
    np.testing.assert_array_equal(state[:, [3, 7]], 0.0)
    np.testing.assert_array_equal(rows.state[sim.body.n_nodes :], 5.0)


@every_scheme
def test_float32_stays_close_to_float64(scheme):
    fine, coarse = hanging_box(scheme), hanging_box(scheme, np.float32)
    step = usual_step(fine)
    n = 200
    difference = advance(coarse, step, n) - advance(fine, step, n)
    # A step rounds x and v, both up to 5 in size, in the last of 24 bits; an error dx turns into a velocity omega dx.
    size = 5 * (1 + gs.stability.element_frequency(fine.body))
    assert np.abs(difference).max() <= n * size * np.finfo(np.float32).eps


@every_scheme
def test_a_free_body_keeps_its_momentum(scheme):
    sim = hanging_box(scheme, pinned=False, gravity=(0.0, 0.0, 0.0), viscosity=0.0)
    before = gs.measure.momentum(sim.body)
    advance(sim, usual_step(sim), 300)
    scale = sim.body.nodes.mass @ np.linalg.norm(sim.body.nodes.velocity, axis=1)
    np.testing.assert_allclose(gs.measure.momentum(sim.body), before, rtol=0, atol=1e-13 * scale)


def energies(sim, step, n_records, n_between):
    """Return kinetic plus elastic energy [J] at regular times."""
    record = []
    for _ in range(n_records):
        advance(sim, step, n_between)
        record.append(gs.measure.kinetic_energy(sim.body) + gs.measure.elastic_energy(sim.body))
    return np.array(record)


def energy_errors(size, nudge, n_records):
    """Return the relative energy error along a motion of some size, its start changed a little, (n_records,)."""
    sim = hanging_box("symplectic_euler", gravity=(0.0, 0.0, 0.0), damping=0.0, viscosity=0.0)
    nodes = sim.body.nodes
    nodes.velocity[:] += nudge * np.where(nodes.is_pinned[:, None], 0.0, np.sin(3.0 * nodes.position))
    nodes.velocity[:] *= size
    start = gs.measure.kinetic_energy(sim.body)
    return np.abs(energies(sim, 0.1 * sim.stable_step, n_records, 100) / start - 1.0)


@pytest.mark.parametrize("nudge", [0.0, 0.1, 0.2])
def test_symplectic_euler_keeps_the_energy_of_a_calm_undamped_body_for_long(nudge):
    error = energy_errors(0.01, nudge, 200)
    # First order: an error of O(h omega / 2) <= 0.1, which swings and does not grow: late ones are as small as early ones.
    assert error.max() <= 0.1
    assert error[-50:].max() <= 1.5 * error[:50].max()


def test_symplectic_euler_keeps_the_energy_of_a_violent_undamped_body_for_long():
    errors = np.array([energy_errors(1.0, nudge, 400) for nudge in (0.0, 0.1, 0.2, 0.3)])
    # The motion is chaotic: how far the error of one run swings at a time is chance, so several are looked at together.
    assert errors.max() <= 0.1
    assert errors[:, 200:].max(axis=1).mean() <= 1.5 * errors[:, :200].max(axis=1).mean()


def test_rk4_loses_energy_of_an_undamped_body_as_slowly_as_its_order_says():
    losses = []
    for share in (0.2, 0.1):
        sim = hanging_box("rk4", gravity=(0.0, 0.0, 0.0), damping=0.0, viscosity=0.0)
        start = gs.measure.kinetic_energy(sim.body)
        record = energies(sim, share * sim.stable_step, 1, round(40 / share))
        losses.append(1.0 - record[-1] / start)
    # |R(i y)|^2 = 1 - y^6 / 72 + y^8 / 576 per step, hence h^5 for a fixed time: 32 times less with half the step.
    assert 0.0 < losses[1] < losses[0] / 10.0 < 1e-3


@without_compiler
@every_scheme
def test_the_loops_of_a_float32_body_hold_no_float64_arithmetic(scheme):
    body = hanging_box(scheme, np.float32).body
    scheme = INTEGRATORS[scheme]
    take_substeps = sys.modules[scheme.advance.py_func.__module__].take_substeps
    code = compiled_code(take_substeps, body.matter, np.float32(1e-3), 1)
    assert "sqrt" in code and re.search(r"= f(add|sub|mul|div) <16 x float> ", code)
    assert not re.search(r"= f(add|sub|mul|div) (<\d+ x )?double|fpext", code)
