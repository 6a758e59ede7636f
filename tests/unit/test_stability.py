"""The stable step: closed forms, each scheme's own limit against its step matrix, and the shapes of input."""

import numpy as np
import pytest

import gmapspring as gs
from gmapspring import stability
from gmapspring.integrators import INTEGRATORS, Limits, rk4
from tests import zoo

every_scheme = pytest.mark.parametrize("scheme", sorted(INTEGRATORS))
ONE_STEP = {
    # x' = v, v' = -k x - c v, one step of 1 s: columns are the images of (x, v) = (1, 0) and (0, 1).
    "symplectic_euler": lambda k, c: np.array([[1 - k, 1 - c], [-k, 1 - c]]),
    "rk4": lambda k, c: taylor(np.array([[0.0, 1.0], [-k, -c]])),
    "velocity_verlet": lambda k, c: adjoint_kick(k, c) @ np.array([[1, 1], [0, 1]]) @ np.array([[1, 0], [-k / 2, 1 - c / 2]]),
    "explicit_euler": lambda k, c: np.array([[1, 1], [-k, 1 - c]]),
    "backward_euler": lambda k, c: np.linalg.inv(np.array([[1, -1], [k, 1 + c]])),
}


def adjoint_kick(k, c):
    """Return the last kick of velocity Verlet: v - (k x + c (v - (k x + c v) / 2)) / 2."""
    return np.array([[1, 0], [-k / 2 * (1 - c / 2), 1 - c / 2 + c**2 / 4]])


def taylor(a):
    """Return 1 + a + a^2 / 2 + a^3 / 6 + a^4 / 24 for a matrix."""
    one = np.eye(len(a))
    return one + a @ (one + a @ (one + a @ (one + a / 4) / 3) / 2)


def growth(scheme, step, stiffness, damping):
    """Return by which factor one step multiplies the fastest growing motion of an oscillator."""
    matrix = ONE_STEP[scheme](step**2 * stiffness, step * damping)
    return np.abs(np.linalg.eigvals(matrix)).max()


def body_of(mesh, scheme="rk4", **material):
    """Return the body of a mesh."""
    material = {"young_modulus": 5e3, "density": 1e3, **material}
    return gs.Simulation(mesh, gs.Material(**material), integrator=scheme).body


def test_the_frequency_of_a_regular_tetrahedron_has_a_closed_form():
    body = body_of(gs.meshes.single(0.1), young_modulus=5e3, density=1e3)
    # k = E V / l^2 on each of six edges: the Laplacian's largest eigenvalue is 4 k. With masses rho V / 4:
    # omega^2 = 4 E V / l^2 / (rho V / 4), omega = 4 sqrt(E / rho) / l.
    assert stability.element_frequency(body) == pytest.approx(4 * np.sqrt(5e3 / 1e3) / 0.1, rel=1e-14)
    assert stability.assembled_frequency(body) == pytest.approx(4 * np.sqrt(5e3 / 1e3) / 0.1, rel=1e-14)


def test_damping_rates_are_beta_omega_squared_plus_gamma():
    rng = np.random.default_rng(3)
    mesh = zoo.build("ball")
    beta, gamma = rng.uniform(0, 1e-3, mesh.n_tetrahedra), rng.uniform(0, 2.0, mesh.n_tetrahedra)
    body = body_of(mesh, damping=beta, viscosity=gamma)
    expected = beta * stability.element_frequencies(body.mesh, body.tetrahedra) ** 2 + gamma
    np.testing.assert_allclose(stability.element_limits(body.mesh, body.tetrahedra).damping_rate, expected, rtol=1e-13)
    np.testing.assert_allclose(stability.element_limits(body.mesh, body.tetrahedra).drag, gamma, rtol=1e-13)


def test_the_largest_eigenvalue_is_that_of_lapack():
    rng = np.random.default_rng(2)
    for spread in np.linspace(0.0, 8.0, 200):
        a = rng.standard_normal((4, 4)) * 10 ** rng.uniform(0, spread, (4, 1))
        a += a.T
        expected = np.linalg.eigvalsh(a)
        found = stability.largest_eigenvalue(a.copy())
        assert found == pytest.approx(expected[-1], rel=0, abs=1e-14 * np.abs(expected).max())
    for plain in (np.zeros((4, 4)), np.diag([1.0, 3.0, -7.0, 2.0])):
        assert stability.largest_eigenvalue(plain.copy()) == plain.max()


def test_frequencies_equal_those_of_one_tetrahedron_at_a_time():
    mesh = zoo.build("box")
    body = body_of(mesh)
    for tetrahedron, found in enumerate(stability.element_frequencies(body.mesh, body.tetrahedra)):
        alone = body_of(gs.Mesh(mesh.points[mesh.tetrahedra[tetrahedron]], np.array([[0, 1, 2, 3]])))
        assert found == pytest.approx(stability.assembled_frequency(alone), rel=1e-12)


def test_the_dense_and_the_sparse_solver_agree(monkeypatch):
    sim = gs.Simulation(zoo.build("ball"), gs.Material(young_modulus=5e3, density=1e3))
    dense = stability.assembled_frequency(sim.body)
    monkeypatch.setattr(stability, "DENSE_LIMIT", 0)
    assert stability.assembled_frequency(sim.body) == pytest.approx(dense, rel=1e-10)


def test_pinned_nodes_take_no_part():
    mesh = gs.meshes.two_tetrahedra(0.1)
    material = gs.Material(young_modulus=5e3, density=1e3)
    one_free = gs.Simulation(mesh, material, pinned=np.arange(5) != 3).body
    # One node of mass rho V / 4 on three springs of stiffness E V / l^2 whose other ends are fixed.
    assert stability.assembled_frequency(one_free) == pytest.approx(np.sqrt(3 * 5e3 / (1e3 / 4)) / 0.1, rel=1e-14)
    none_free = gs.Simulation(mesh, material, pinned=np.ones(5, bool)).body
    assert stability.assembled_frequency(none_free) == 0.0


@every_scheme
def test_without_stiffness_and_damping_any_step_is_stable(scheme):
    body = body_of(gs.meshes.single(), young_modulus=0.0)
    assert stability.stable_step(body, INTEGRATORS[scheme]) == np.inf


@every_scheme
def test_damping_limits_the_step_without_stiffness_too(scheme):
    body = body_of(gs.meshes.single(), young_modulus=0.0, damping=1.0, viscosity=4.0)
    # v' = -4 v: |1 - 4 h| <= 1 for Euler, 4 h <= 2.785 for RK4.
    limit = {"rk4": 2.785 / 4, "backward_euler": np.inf}.get(scheme, 2 / 4)
    assert stability.stable_step(body, INTEGRATORS[scheme]) == pytest.approx(limit, rel=1e-3)


def test_the_step_of_symplectic_euler_solves_its_quadratic():
    step = INTEGRATORS["symplectic_euler"].stable_step
    assert step(Limits(2.0)) == 1.0  # h omega = 2
    assert step(Limits(2.0, 3.0)) == 0.5  # 4 h^2 + 6 h = 4
    # With damping ratio xi = c / (2 omega): h = (2 / omega) (sqrt(1 + xi^2) - xi).
    xi = 0.7
    assert step(Limits(5.0, 2 * 5.0 * xi)) == pytest.approx(2 / 5 * (np.sqrt(1 + xi**2) - xi), rel=1e-14)


def test_symplectic_euler_is_stable_up_to_its_step_and_no_further():
    rng = np.random.default_rng(4)
    for omega, xi in zip(10 ** rng.uniform(-2, 3, 200), 10 ** rng.uniform(-3, 1.5, 200), strict=True):
        step = INTEGRATORS["symplectic_euler"].stable_step(Limits(omega, 2 * xi * omega))
        assert growth("symplectic_euler", 0.9999 * step, omega**2, 2 * xi * omega) <= 1.0
        assert growth("symplectic_euler", 1.0001 * step, omega**2, 2 * xi * omega) > 1.0


def test_symplectic_euler_takes_the_step_of_its_most_demanding_element():
    step = INTEGRATORS["symplectic_euler"].stable_step
    # The stiff element alone allows h = 2 / 4, the damped one alone h = 2 / 3 (omega = 0).
    assert step(Limits(np.array([4.0, 0.0]), np.array([0.0, 3.0]))) == 0.5


def test_velocity_verlet_is_stable_up_to_its_step_and_without_damping_no_further():
    rng = np.random.default_rng(6)
    for omega, xi in zip(10 ** rng.uniform(-2, 3, 200), 10 ** rng.uniform(-3, 1.5, 200), strict=True):
        step = INTEGRATORS["velocity_verlet"].stable_step(Limits(omega, 2 * xi * omega))
        assert growth("velocity_verlet", 0.9999 * step, omega**2, 2 * xi * omega) <= 1.0
        assert growth("velocity_verlet", 1.0001 * 2 / omega, omega**2, 0.0) > 1.0


def test_explicit_euler_is_stable_where_drag_makes_up_for_what_it_adds():
    step = INTEGRATORS["explicit_euler"].stable_step
    assert step(Limits(2.0)) == 0.0
    assert step(Limits(2.0, 3.0, 0.0)) == 0.0  # damping along springs is none across them
    assert step(Limits(2.0, 0.5, 0.5)) == 0.5 / 4
    assert step(Limits(2.0, 100.0, 0.5)) == 2 / 100
    rng = np.random.default_rng(6)
    for omega, xi in zip(10 ** rng.uniform(-2, 3, 200), 10 ** rng.uniform(-3, 0.2, 200), strict=True):
        rate = 2 * xi * omega
        h = step(Limits(omega, rate, rate))
        assert growth("explicit_euler", 0.9999 * h, omega**2, rate) <= 1.0
        if xi < 0.7:
            assert growth("explicit_euler", 1.0001 * h, omega**2, rate) > 1.0


def test_backward_euler_is_stable_at_any_step():
    assert INTEGRATORS["backward_euler"].stable_step(Limits(1e9, 1e9, 0.0)) == np.inf
    assert INTEGRATORS["backward_euler"].default_step(Limits(2.0)) == 10.0
    for k, c in 10 ** np.random.default_rng(7).uniform(-6, 12, (200, 2)):
        assert growth("backward_euler", 1.0, k, c) <= 1.0


@pytest.mark.parametrize("scheme", ["symplectic_euler", "rk4", "velocity_verlet"])
def test_all_motions_up_to_the_limits_are_stable_and_some_motion_is_close_to_its_limit(scheme):
    rng = np.random.default_rng(5)
    for xi in (0.0, 1e-3, 0.1, 0.29, 0.31, 0.5, 0.54, 0.7, 1.0, 3.0, 10.0):
        omega = 10 ** rng.uniform(-1, 3)
        step = INTEGRATORS[scheme].stable_step(Limits(omega, 2 * xi * omega))
        # The two kicks of velocity Verlet damp less than one does: with damping its true limit is up to 1.65 times the bound.
        beyond = 1.7 if scheme == "velocity_verlet" else 1.1
        shares = np.concatenate([rng.uniform(0, 1, (300, 2)), [(1, 1), (1, 0), (0, 1)], np.linspace((1, 0), (1, 1), 100)])
        k, c = (shares * (omega**2, 2 * xi * omega)).T
        assert max(growth(scheme, step, *pair) for pair in zip(k, c, strict=True)) <= 1.0 + 1e-7
        assert max(growth(scheme, beyond * step, *pair) for pair in zip(k, c, strict=True)) > 1.0


def test_the_reaches_of_rk4_are_inside_its_stability_region_and_tight():
    def grows(z):
        """Tell where one step of z = h lambda grows."""
        return np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))) > 1 + 1e-13

    angle = np.linspace(np.pi / 2, np.pi, 20001)[:, None]
    share = np.linspace(0, 1, 201)[None]
    disc = share * np.exp(1j * angle)
    assert not grows(rk4.SECTOR_REACH * disc).any()
    assert grows(1.001 * rk4.SECTOR_REACH * disc).any()
    assert not grows(-rk4.REAL_REACH * share).any()
    assert grows(-1.001 * rk4.REAL_REACH * share).any()
    half_disc = rk4.IMAGINARY_REACH * disc
    assert not grows(half_disc[half_disc.real >= -rk4.STRIP_REACH]).any()
    assert grows(half_disc[half_disc.real >= -1.01 * rk4.STRIP_REACH]).any()
    assert grows(1.001j * rk4.IMAGINARY_REACH)


@every_scheme
def test_more_stiffness_or_damping_never_allows_a_longer_step(scheme):
    step = INTEGRATORS[scheme].stable_step
    rates = np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 60)])
    steps = np.array([[step(Limits(omega, rate, min(rate, 1e-3))) for rate in rates] for omega in rates])
    assert (steps[2:, 1:] <= steps[1:-1, 1:]).all() and (steps[1:, 2:] <= steps[1:, 1:-1]).all()
    assert (steps[0] >= steps[1]).all()
    # Explicit Euler needs some drag.
    assert scheme == "explicit_euler" or (steps[:, 0] >= steps[:, 1]).all()


@every_scheme
def test_cuts_do_not_change_the_step_by_a_bit(scheme):
    sim = gs.Simulation(zoo.build("box"), gs.Material(5e3, 1e3, damping=1e-3, viscosity=1.0), integrator=scheme)
    before = stability.stable_step(sim.body, sim.integrator)
    assert before == sim.stable_step
    sim.split_face(0, 1)
    sim.remove_tetrahedron(7)
    assert stability.stable_step(sim.body, sim.integrator) == before
