"""The bound holds: for the step matrix of assembled bodies, for their motion near the limit, and whatever was cut."""

import numpy as np
import pytest

import gmapspring as gs
from gmapspring import stability
from gmapspring.integrators import INTEGRATORS
from tests import zoo
from tests.stability.cases.linear import laplacian, modes, total_energy

every_scheme = pytest.mark.parametrize("scheme", sorted(INTEGRATORS))
SYMPLECTIC = ("symplectic_euler", "velocity_verlet")
LIMITED = ("rk4", *SYMPLECTIC)
"""Schemes that are stable without damping, up to some step."""
MESHES = ("two", "ring", "star", "box", "torus", "ball")


def uneven_material(mesh, rng, damping=1.0):
    """Return a material that differs wildly from one tetrahedron to the next; some have no stiffness, some no damping."""
    n = mesh.n_tetrahedra
    some = rng.uniform(size=(3, n)) < 0.8
    some[0, 0] = True  # a body without any stiffness has no bound to test
    young_modulus = np.where(some[0], 5e3 * np.exp(rng.normal(0, 1.5, n)), 0.0)
    return gs.Material(
        young_modulus=young_modulus,
        density=1e3 * np.exp(rng.normal(0, 0.7, n)),
        damping=damping * np.where(some[1], 10 ** rng.uniform(-5, -1, n), 0.0),
        viscosity=damping * np.where(some[2], 10 ** rng.uniform(-2, 3, n), 0.0),
    )


def cut_at_random(sim, rng):
    """Split a random share of the faces and remove up to four tenths of the tetrahedra, but not all."""
    n = sim.body.mesh.n_tetrahedra
    face_of = sim.body.face_of
    faces, first = np.unique(face_of, return_index=True)
    sides = [(int(slot) // 4, t) for slot in faces for t in np.flatnonzero((face_of == slot).any(axis=1)) if t != slot // 4]
    assert len(first) == len(faces)
    share = rng.uniform()
    removed = rng.permutation(n)[: int(rng.uniform(0, 0.4) * n)]
    sim.cut([side for side in sides if rng.uniform() < share], removed)


def random_body(name, seed, scheme="rk4", damping=1.0):
    """Return a cut body of uneven material, some nodes pinned."""
    rng = np.random.default_rng(seed)
    mesh = zoo.build(name)
    pinned = rng.uniform(size=mesh.n_points) < 0.1
    sim = gs.Simulation(mesh, uneven_material(mesh, rng, damping), pinned=pinned, integrator=scheme)
    cut_at_random(sim, rng)
    return sim


def step_matrix(body, scheme, h):
    """Return the matrix (2n, 2n) of one step of M x'' + C x' + K x = 0, for one axis of each node."""
    nodes, n = body.nodes, body.n_nodes
    damping = np.zeros((n, n))
    if len(nodes.viscosity):
        damping += laplacian(body, body.springs.damping) + np.diag(nodes.viscosity)
    k = nodes.inverse_mass[:, None] * laplacian(body, body.springs.stiffness)
    c = nodes.inverse_mass[:, None] * damping
    one, zero = np.eye(n), np.zeros((n, n))
    drift, still = np.block([[one, h * one], [zero, one]]), np.eye(2 * n)
    slope = np.block([[zero, zero], [-k, -c]])
    if scheme == "symplectic_euler":
        return drift @ (still + h * slope)
    if scheme == "velocity_verlet":
        half = still + h / 2 * slope
        return (still + h / 2 * slope @ half) @ drift @ half
    if scheme == "explicit_euler":
        return drift + h * slope
    if scheme == "backward_euler":
        return np.linalg.inv(2 * still - drift - h * slope)
    a = h * np.block([[zero, one], [-k, -c]])
    both = np.eye(2 * n)
    return both + a @ (both + a @ (both + a @ (both + a / 4) / 3) / 2)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("name", MESHES)
def test_no_body_however_cut_has_a_frequency_above_the_bound(name, seed):
    sim = random_body(name, seed)
    bound = stability.element_frequency(sim.body)
    assert stability.assembled_frequency(sim.body) <= bound * (1 + 1e-12)


@every_scheme
@pytest.mark.parametrize("damping", [0.0, 0.03, 1.0])
@pytest.mark.parametrize("name", ["two", "ring", "star", "box"])
def test_one_step_of_the_assembled_body_makes_no_motion_grow(name, damping, scheme):
    for seed in range(3):
        body = random_body(name, seed, scheme, damping).body
        h = min(stability.stable_step(body, INTEGRATORS[scheme]), 1.0)
        radius = np.abs(np.linalg.eigvals(step_matrix(body, scheme, h))).max()
        # Drifting at constant velocity is a double eigenvalue 1, which round-off eps splits by sqrt(eps) = 1.5e-8.
        assert radius <= 1 + 1e-6


@every_scheme
def test_the_step_matrix_is_that_of_the_kernel(scheme):
    sim = random_body("box", 7, scheme)
    body, h = sim.body, 0.5 * gs.Simulation(sim.body.mesh, sim.body.material).stable_step
    rng = np.random.default_rng(8)
    # Springs with rest length 0 are linear, with stiffness k times the identity.
    body.springs.rest_length[:] = 0.0
    body.springs.damping[:] = 0.0
    body.nodes.position[:] = rng.standard_normal((body.n_nodes, 3))
    body.nodes.velocity[~body.nodes.is_pinned] = rng.standard_normal((int(np.sum(~body.nodes.is_pinned)), 3))
    before = np.vstack([body.nodes.position, body.nodes.velocity])
    sim._take_substeps(h, 1)
    after = np.vstack([body.nodes.position, body.nodes.velocity])
    tolerance = 1e-6 if scheme == "backward_euler" else 1e-11  # its equation is solved to some residual
    np.testing.assert_allclose(after, step_matrix(body, scheme, h) @ before, rtol=0, atol=tolerance * np.abs(after).max())


def thrown_box(scheme, damping_ratio, cut_seed=None, speed=1.0):
    """Return a box whose stiffest tetrahedron has the given damping ratio, beta omega / 2, thrown at random."""
    mesh = gs.meshes.box((3, 2, 2), 0.1)
    plain = gs.Simulation(mesh, gs.Material(5e3, 1e3)).body
    beta = 2 * damping_ratio / stability.element_frequency(plain)
    pinned = mesh.points[:, 0] < 0.05
    # Explicit Euler has no stable step without drag.
    material = gs.Material(5e3, 1e3, damping=beta, viscosity=50.0 if scheme == "explicit_euler" else 0.0)
    sim = gs.Simulation(mesh, material, pinned=pinned, integrator=scheme)
    rng = np.random.default_rng(9)
    if cut_seed is not None:
        cut_at_random(sim, np.random.default_rng(cut_seed))
    velocity = speed * rng.standard_normal((sim.body.n_nodes, 3))
    sim.body.nodes.velocity[:] = np.where(sim.body.nodes.is_pinned[:, None], 0.0, velocity)
    return sim


def record_energy(sim, step, n_records=60, n_between=50):
    """Return the energy [J] at regular times while stepping."""
    record = []
    for _ in range(n_records):
        sim.advance(n_between * step, step=step)
        record.append(total_energy(sim))
    assert np.isfinite(sim.body.nodes.state).all()
    return record


@every_scheme
@pytest.mark.parametrize("cut_seed", [None, 1, 2])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0])
def test_at_the_bound_the_energy_of_moderate_motion_does_not_grow(scheme, damping_ratio, cut_seed):
    sim = thrown_box(scheme, damping_ratio, cut_seed, speed=0.2)
    start = total_energy(sim)
    record = record_energy(sim, 0.99 * sim.stable_step if np.isfinite(sim.stable_step) else sim.default_step)
    # Symplectic schemes conserve a neighbouring energy: the true one swings by (1 + a) / (1 - a) for symplectic Euler and by
    # 1 / (1 - a^2) for Verlet, with a = h omega / 2: 2/3 is what the bound leaves of the true limit.
    assert max(record) <= {"symplectic_euler": 5.0, "velocity_verlet": 1.8}.get(scheme, 1.0) * start
    assert max(record[-20:]) <= 1.2 * max(record[:20])


@every_scheme
@pytest.mark.parametrize("cut_seed", [None, 1])
@pytest.mark.parametrize("damping_ratio", [0.0, 0.3, 3.0])
def test_at_the_default_share_the_energy_of_violent_motion_does_not_grow(scheme, damping_ratio, cut_seed):
    # Strains beyond 0.5 either way: the waves in this material are no faster than sqrt(E / rho) = 2.2 m/s.
    sim = thrown_box(scheme, damping_ratio, cut_seed, speed=1.0)
    start = total_energy(sim)
    record = record_energy(sim, sim.default_step)
    assert max(record) <= (1.25 if scheme in SYMPLECTIC else 1.0) * start


@every_scheme
@pytest.mark.parametrize("damping_ratio", [0.02, 0.3, 3.0])
def test_at_the_default_share_a_damped_body_let_go_at_thrice_its_length_does_not_gain_energy(scheme, damping_ratio):
    # Undamped, it passes through itself again and again, and symplectic Euler doubles its energy in 3000 such steps.
    sim = thrown_box(scheme, damping_ratio, cut_seed=3, speed=0.0)
    sim.body.nodes.position[~sim.body.nodes.is_pinned] *= 3.0
    start = total_energy(sim)
    record = record_energy(sim, sim.default_step)
    assert max(record) <= (1.25 if scheme in SYMPLECTIC else 1.0) * start


def true_limit(sim):
    """Return the longest stable step [s] at rest without damping."""
    return (np.sqrt(8.0) if sim.integrator.name == "rk4" else 2.0) / modes(sim.body).max()


@pytest.mark.parametrize("scheme", LIMITED)
def test_the_true_limit_is_above_the_bound_but_not_far(scheme):
    sim = thrown_box(scheme, 0.0)
    assert sim.stable_step < true_limit(sim) < 2.5 * sim.stable_step


@pytest.mark.parametrize("scheme", LIMITED)
@pytest.mark.parametrize("share", [0.98, 1.02])
def test_a_body_blows_up_just_above_its_true_limit_and_not_just_below(scheme, share):
    # The motion is so small that the body stays linear until it has grown by many powers of ten.
    sim = thrown_box(scheme, 0.0, speed=1e-9)
    step, start = share * true_limit(sim), total_energy(sim)
    sim._take_substeps(step, 100)
    # NaN counts as blown up.
    assert (not total_energy(sim) <= 1e6 * start) == (share > 1.0)


@pytest.mark.parametrize("scheme", [*LIMITED, "explicit_euler"])
def test_a_step_above_the_bound_is_refused(scheme):
    sim = thrown_box(scheme, 0.3)
    with pytest.raises(gs.StabilityError, match=f"{sim.stable_step:.6g}"):
        sim.advance(1.0, step=1.001 * sim.stable_step)


def test_explicit_euler_without_drag_is_refused_at_any_step():
    sim = gs.Simulation(zoo.build("two"), gs.Material(5e3, 1e3, damping=0.1), integrator="explicit_euler")
    for step in (None, 1e-9):
        with pytest.raises(gs.StabilityError, match="viscosity"):
            sim.advance(1.0, step=step)


def test_backward_euler_takes_steps_beyond_the_reach_of_all_others():
    sim = thrown_box("backward_euler", 0.0, speed=0.5)
    start, step = total_energy(sim), 100 * thrown_box("rk4", 0.0).stable_step
    assert max(record_energy(sim, step, n_records=20, n_between=1)) < start
