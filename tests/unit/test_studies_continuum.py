"""The studies of model error and drift: their matrices against forces and energies, their continuum against beam theory."""

import numpy as np
import pytest

from gmapspring import Material, Simulation, meshes
from gmapspring.topology.darts import EDGE_CORNERS
from tests import zoo
from tests.benchmarks.studies import anisotropy, drift
from tests.benchmarks.studies.comparison import (
    SLENDERNESS,
    WHOLE,
    Comparison,
    beam_tip,
    block,
    cantilever,
    compare,
    least_wrong,
    liver,
)
from tests.benchmarks.studies.elasticity import TOLERANCE, Continuum, refined
from tests.benchmarks.studies.settling import settled_displacement
from tests.benchmarks.studies.statics import (
    body_of,
    mean_elasticity,
    point_forces,
    solve,
    spring_displacement,
    spring_stiffness,
)

UNIT = Material(young_modulus=1.0, density=1.0)
RATIOS = np.array([0.0, 0.25, 0.45])


def force_on_points(mesh, displacement):
    """Return the forces of a simulation at displaced points [N], (n_points, 3): m v / h after one short step from rest."""
    simulation = Simulation(mesh, UNIT, integrator="symplectic_euler")
    nodes, step = simulation.body.nodes, 1e-3 * simulation.stable_step
    nodes.position[:] += displacement[nodes.point]
    simulation.advance(step, step=step)
    force = np.empty_like(displacement)
    force[nodes.point] = nodes.mass[:, None] * nodes.velocity / step
    return force


def fields(rng, springs, *references):
    """Return a comparison of made-up fields."""
    linear = np.zeros((len(references), *springs.shape))
    return Comparison(block(2), WHOLE, RATIOS[: len(references)], springs, linear, np.array(references))


@pytest.mark.parametrize("name", ["two", "box", "ball"])
def test_the_stiffness_matrix_is_the_derivative_of_the_forces_of_a_simulation(name):
    mesh = zoo.build(name)
    direction = np.random.default_rng(0).standard_normal(mesh.points.shape)
    # A central difference is wrong by the square of its step, in units of edges of about 1 m, and by round-off over it.
    step = 1e-5 * np.ptp(mesh.points)
    derivative = (force_on_points(mesh, step * direction) - force_on_points(mesh, -step * direction)) / (2.0 * step)
    expected = -(spring_stiffness(body_of(mesh)) @ direction.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(derivative, expected, rtol=0, atol=1e-7 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["single", "box", "ball"])
def test_springs_are_linear_elements_of_the_tensor_that_sums_n_n_n_n_over_edges(name):
    mesh = zoo.build(name)
    displacement = np.random.default_rng(1).standard_normal(mesh.points.shape)
    corners, moved = mesh.points[mesh.tetrahedra], displacement[mesh.tetrahedra]
    # Rows of edges from corner 0: d = X g gives the gradient g, whose symmetric part is the strain.
    gradient = np.linalg.solve(corners[:, 1:] - corners[:, :1], moved[:, 1:] - moved[:, :1])
    strain = (gradient + gradient.transpose(0, 2, 1)) / 2.0
    edges = corners[:, EDGE_CORNERS]
    n = edges[:, :, 1] - edges[:, :, 0]
    n /= np.linalg.norm(n, axis=2, keepdims=True)
    energy = 0.5 * np.sum(mesh.volumes[:, None] * np.einsum("tei,tij,tej->te", n, strain, n) ** 2)
    flat = displacement.ravel()
    assert 0.5 * flat @ (spring_stiffness(body_of(mesh)) @ flat) == pytest.approx(energy, rel=1e-12)


def test_only_rigid_motions_cost_no_energy():
    eigenvalues = np.linalg.eigvalsh(spring_stiffness(body_of(zoo.build("ball"))).toarray())
    assert np.abs(eigenvalues[:6]).max() < 1e-12 * eigenvalues[-1]
    assert eigenvalues[6] > 1e-4 * eigenvalues[-1]


@pytest.mark.parametrize("make", [lambda: cantilever(1), lambda: block(2), liver], ids=["cantilever", "block", "liver"])
def test_point_forces_are_those_of_linear_elements(make):
    problem = make()
    continuum = Continuum(problem, degree=1)
    # Linear elements of scikit-fem number the coordinates of point i as 3 i, 3 i + 1, 3 i + 2.
    expected = continuum.force.reshape(-1, 3)
    forces = point_forces(problem, body_of(problem.mesh))
    np.testing.assert_allclose(forces, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.25])
def test_the_continuum_sinks_as_timoshenko_says(poisson_ratio):
    problem = cantilever(2)
    sinking = -Continuum(problem, degree=2).displacement(poisson_ratio, problem.mesh.points)[:, 2]
    tip = np.mean(sinking[problem.mesh.points[:, 0] == SLENDERNESS])
    # The clamp stops the cross-section from widening, which the theory lets it do: a share of nu^2 h / L; 1 % for elements.
    assert tip == pytest.approx(beam_tip(poisson_ratio), rel=0.01 + poisson_ratio**2 / SLENDERNESS)


def test_a_compressed_block_without_poisson_effect_shortens_by_its_stress():
    problem = block(2)
    for degree in (1, 2):
        displacement = Continuum(problem, degree).displacement(0.0, problem.mesh.points)
        np.testing.assert_allclose(displacement, -problem.mesh.points * (0, 0, 1), atol=10.0 * TOLERANCE)


def test_refined_problems_have_the_same_total_load_and_clamp():
    for problem in (cantilever(1), block(2), liver()):
        fine = refined(problem)
        assert fine.mesh.n_tetrahedra == 8 * problem.mesh.n_tetrahedra
        totals = [np.sum(point_forces(each, body_of(each.mesh)), axis=0) for each in (problem, fine)]
        np.testing.assert_allclose(*totals, atol=1e-12 * np.abs(totals[0]).max())
    beam = refined(cantilever(1))
    np.testing.assert_array_equal(beam.is_clamped, beam.mesh.points[:, 0] == 0.0)
    cube = refined(block(1))
    np.testing.assert_array_equal(cube.is_loaded, cube.mesh.points[:, 2] == 1.0)


def test_displacements_are_asked_for_at_nodes_only():
    with pytest.raises(AssertionError, match="nodes"):
        Continuum(block(1), degree=1).displacement(0.0, np.array([(0.0, 0.0, 0.0), (0.3, 0.2, 0.1)]))


def test_the_best_scale_recovers_a_known_constant():
    rng = np.random.default_rng(2)
    reference = rng.standard_normal((27, 3))
    comparison = fields(rng, 1.7 * reference, reference)
    assert comparison.best_scale(reference) == pytest.approx(1.7, rel=1e-12)
    assert comparison.scaled_error(reference, 1.0) == pytest.approx(0.7, rel=1e-12)
    assert comparison.scaled_error(reference) < 1e-12


def test_no_other_scale_leaves_less_error_than_the_best_one():
    rng = np.random.default_rng(3)
    reference = rng.standard_normal((27, 3))
    comparison = fields(rng, reference + 0.3 * rng.standard_normal((27, 3)), reference)
    best = comparison.best_scale(reference)
    assert all(comparison.scaled_error(reference) < comparison.scaled_error(reference, best * factor) for factor in (0.99, 1.01))


def test_the_least_wrong_ratio_is_that_of_the_continuum_itself():
    problem = block(2)
    continuum = Continuum(problem, degree=2)
    comparison = compare(problem, continuum, np.array([0.0, 0.15, 0.3, 0.45]))
    material = continuum.displacement(0.3, problem.mesh.points)
    ratio, error = least_wrong([comparison._replace(springs=material)], is_scaled=False)
    assert (ratio, error) == (pytest.approx(0.3), pytest.approx(0.0, abs=1e-12))
    # A stiffer continuum of that ratio is found by its ratio once the scale is free.
    scaled = comparison._replace(springs=material / 1.2)
    assert least_wrong([scaled], is_scaled=True) == (pytest.approx(0.3), pytest.approx(0.0, abs=1e-7))
    assert least_wrong([scaled], is_scaled=False)[1] > 0.05


def test_van_gelders_springs_keep_young_modulus_and_a_quarter_for_poisson_on_average():
    for mesh in (meshes.box((2, 2, 2)), meshes.ball(2), meshes.single()):
        assert anisotropy.closest_isotropic(mean_elasticity(body_of(mesh))) == pytest.approx((1.0, 0.25), rel=1e-12)


def test_an_isotropic_tensor_has_the_same_modulus_in_all_directions():
    one = np.eye(3)
    pairs = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    poisson_ratio, shear = 0.3, 0.5 / 1.3
    tensor = shear * pairs + 2.0 * shear * poisson_ratio / (1.0 - 2.0 * poisson_ratio) * np.einsum("ij,kl->ijkl", one, one)
    assert anisotropy.closest_isotropic(tensor) == pytest.approx((1.0, 0.3), rel=1e-12)
    for direction in anisotropy.DIRECTIONS.values():
        assert anisotropy.directional_modulus(tensor, anisotropy.unit(direction)) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("name", anisotropy.DIRECTIONS)
def test_measured_stiffness_of_a_lattice_tends_to_theory_from_below(name):
    direction = anisotropy.unit(anisotropy.DIRECTIONS[name])
    cubes = [meshes.box((n, n, n), 1.0 / n) for n in (2, 4)]
    theory = anisotropy.directional_modulus(mean_elasticity(body_of(cubes[0])), direction)
    coarse, fine = (anisotropy.measured_modulus(mesh, direction) for mesh in cubes)
    # Even strain is one way to deform under the load: relaxing at the surface can only make the body softer.
    assert coarse < fine < theory * (1.0 + 1e-12)
    assert fine == pytest.approx(theory, rel=0.01)


def test_a_simulation_comes_to_rest_where_linear_statics_says():
    problem = cantilever(1)
    linear = spring_displacement(problem)
    load = 1e-4 * SLENDERNESS / np.linalg.norm(linear, axis=1).max()
    # What is left is the square of the deflection, which is 1e-4 of the length.
    settled = settled_displacement(problem, load)
    assert np.linalg.norm(settled - linear) < 1e-3 * np.linalg.norm(linear)


def test_solving_leaves_what_is_not_free_at_zero():
    matrix = spring_stiffness(body_of(meshes.single()))
    is_free = np.arange(12) >= 9
    solution = solve(matrix, np.ones(12), is_free)
    assert not solution[~is_free].any()
    np.testing.assert_allclose((matrix @ solution)[is_free], 1.0, rtol=1e-12)


@pytest.mark.parametrize("scheme", ["rk4", "symplectic_euler"])
def test_drift_records_what_a_step_does_to_energy_and_momentum(scheme):
    curve = drift.record(scheme, np.float64, share=0.25, n_steps=512)
    assert curve.n_steps[-1] == 512
    assert drift.N_EARLY / 0.25 in curve.n_steps
    assert 0.0 < curve.largest[-1] < 0.1
    assert curve.momentum.max() < drift.ROUND_OFF
    assert (curve.angular.max() < drift.ROUND_OFF) == (scheme == "symplectic_euler")


def test_rk4_loses_the_energy_that_linear_theory_says():
    share, n_steps = 0.25, round(drift.N_EARLY / 0.25)
    curve = drift.record("rk4", np.float64, share, n_steps)
    # Strains of a tenth or two change frequencies, whose sixth power counts.
    assert -curve.energy[-1] == pytest.approx(drift.rk4_loss(curve.step, n_steps), rel=0.1)
