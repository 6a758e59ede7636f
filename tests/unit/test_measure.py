"""Measures: one regular tetrahedron by hand, cut bodies by sums, and the kernel against NumPy."""

import numpy as np
import pytest

import gmapspring as gs
from gmapspring import measure
from tests import zoo

EDGE, YOUNG, DENSITY = 0.3, 4e3, 1.1e3
VOLUME = EDGE**3 / (6 * np.sqrt(2.0))
"""Of a regular tetrahedron [m^3]."""
MASS = DENSITY * VOLUME


def regular(dtype=np.float64, gravity=(0.0, 0.0, 0.0)):
    """Return a regular tetrahedron round the origin."""
    return gs.Simulation(gs.meshes.single(EDGE), gs.Material(YOUNG, DENSITY), gravity=gravity, dtype=dtype).body


def stirred(name, dtype=np.float64):
    """Return a body of the zoo with some tetrahedra removed, faces cut, and nodes moved at random."""
    mesh = zoo.build(name)
    sim = gs.Simulation(mesh, gs.Material(YOUNG, DENSITY), dtype=dtype)
    rng = np.random.default_rng(6)
    sim.cut(tetrahedra=rng.permutation(mesh.n_tetrahedra)[: mesh.n_tetrahedra // 4])
    sim.body.nodes.position[:] += 0.3 * rng.standard_normal(sim.body.nodes.position.shape)
    sim.body.nodes.velocity[:] = rng.standard_normal(sim.body.nodes.velocity.shape)
    return sim.body


@pytest.mark.parametrize(("dtype", "rel"), [(np.float64, 1e-14), (np.float32, 1e-6)])
def test_kinetic_energy_of_a_moving_body(dtype, rel):
    body = regular(dtype)
    body.nodes.velocity[:] = (3.0, 0.0, 4.0)
    assert measure.kinetic_energy(body) == pytest.approx(MASS * 5.0**2 / 2, rel=rel)


@pytest.mark.parametrize(("dtype", "rel"), [(np.float64, 1e-14), (np.float32, 1e-6)])
def test_elastic_energy_of_a_body_twice_as_large(dtype, rel):
    body = regular(dtype)
    assert measure.elastic_energy(body) == pytest.approx(0.0, abs=1e-12)
    body.nodes.position[:] *= 2.0
    # Six springs of stiffness E V / l^2, each longer by l: 6 (E V / l^2) l^2 / 2 = 3 E V.
    assert measure.elastic_energy(body) == pytest.approx(3 * YOUNG * VOLUME, rel=rel)


def test_gravitational_energy_grows_with_height():
    body = regular(gravity=(0.0, 0.0, -10.0))
    body.nodes.position[:] += (5.0, 6.0, 7.0)
    assert measure.gravitational_energy(body) == pytest.approx(MASS * 10.0 * 7.0, rel=1e-14)


def test_energy_is_conserved_between_its_forms():
    sim = gs.Simulation(gs.meshes.box((3, 2, 2), 0.1), gs.Material(YOUNG, DENSITY), gravity=(0.0, 0.0, -10.0),
                        pinned=np.arange(36) < 12)  # fmt: skip

    def total():
        """Return the sum of the three energies [J]."""
        forms = (measure.kinetic_energy, measure.elastic_energy, measure.gravitational_energy)
        return sum(form(sim.body) for form in forms)

    before = total()
    sim.advance(0.2, step=0.05 * sim.stable_step)
    assert measure.elastic_energy(sim.body) > 0.01
    # RK4 errs by O((h omega)^5 / 144) a step: (0.05 * 2.8)^5 / 144 * 600 steps = 2e-4 at the very most.
    assert total() == pytest.approx(before, abs=1e-4 * measure.elastic_energy(sim.body))


def test_momentum_of_a_moving_body():
    body = regular()
    body.nodes.velocity[:] = (3.0, -2.0, 4.0)
    np.testing.assert_allclose(measure.momentum(body), MASS * np.array([3.0, -2.0, 4.0]), rtol=1e-14)


def test_angular_momentum_of_a_spinning_body():
    body = regular()
    spin = np.array([1.0, -2.0, 0.5])
    body.nodes.velocity[:] = np.cross(spin, body.nodes.position)
    # Four masses m / 4 at a distance R = l sqrt(3 / 8): inertia (2 / 3) m R^2 = m l^2 / 4 about every axis.
    np.testing.assert_allclose(measure.angular_momentum(body), MASS * EDGE**2 / 4 * spin, rtol=1e-13)
    assert measure.kinetic_energy(body) == pytest.approx(MASS * EDGE**2 / 4 * (spin @ spin) / 2, rel=1e-13)


def test_volumes_and_strains_of_a_stretched_tetrahedron():
    body = regular()
    np.testing.assert_allclose(measure.volumes(body), [VOLUME], rtol=1e-14)
    body.nodes.position[:] *= 1.5
    np.testing.assert_allclose(measure.volume_ratios(body), [1.5**3], rtol=1e-14)
    np.testing.assert_allclose(measure.edge_strains(body), np.full(6, 0.5), rtol=1e-14)
    np.testing.assert_allclose(measure.tetrahedron_strains(body), [0.5], rtol=1e-14)


def test_the_volume_of_a_tetrahedron_turned_inside_out_is_negative():
    body = regular()
    body.nodes.position[:, 0] *= -1.0
    np.testing.assert_allclose(measure.volume_ratios(body), [-1.0], rtol=1e-14)


def test_a_removed_tetrahedron_has_no_volume_and_no_strain():
    sim = gs.Simulation(gs.meshes.two_tetrahedra(EDGE), gs.Material(YOUNG, DENSITY))
    sim.body.nodes.position[:] *= 2.0
    sim.remove_tetrahedron(0)
    np.testing.assert_allclose(measure.volumes(sim.body), [0.0, 8 * VOLUME], rtol=1e-14)
    np.testing.assert_allclose(measure.volume_ratios(sim.body), [0.0, 8.0], rtol=1e-14)
    np.testing.assert_allclose(measure.tetrahedron_strains(sim.body), [0.0, 1.0], rtol=1e-14)
    np.testing.assert_array_equal(measure.components(sim.body), [-1, 0])


def test_a_body_with_nothing_left_has_nothing_to_measure():
    sim = gs.Simulation(gs.meshes.two_tetrahedra(), gs.Material(YOUNG, DENSITY), gravity=(0.0, 0.0, -10.0))
    sim.cut(tetrahedra=[0, 1])
    for energy in (measure.kinetic_energy, measure.elastic_energy, measure.gravitational_energy):
        assert energy(sim.body) == 0.0
    for vector in (measure.momentum, measure.angular_momentum):
        np.testing.assert_array_equal(vector(sim.body), np.zeros(3))
    for per_tetrahedron in (measure.volumes, measure.volume_ratios, measure.tetrahedron_strains):
        np.testing.assert_array_equal(per_tetrahedron(sim.body), np.zeros(2))
    assert measure.edge_strains(sim.body).shape == (0,)


def test_components_are_counted_from_the_lowest_tetrahedron():
    sim = gs.Simulation(gs.meshes.two_tetrahedra(), gs.Material(YOUNG, DENSITY))
    np.testing.assert_array_equal(measure.components(sim.body), [0, 0])
    sim.split_face(0, 1)
    np.testing.assert_array_equal(measure.components(sim.body), [0, 1])


@pytest.mark.parametrize("name", ["single", "box", "ball", "torus"])
def test_the_strain_of_a_tetrahedron_is_its_longest_stretch(name):
    body = stirred(name)
    strains = measure.edge_strains(body)
    for tetrahedron in np.flatnonzero(body.is_alive):
        assert measure.tetrahedron_strains(body)[tetrahedron] == strains[body.edge_of[tetrahedron]].max()
    ends = body.nodes.position[body.springs.endpoints]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    np.testing.assert_allclose(strains, lengths / body.springs.rest_length - 1, rtol=0, atol=1e-14 * lengths.max() / 0.1)


def kernel_measures(body):
    """Return strains and volume ratios by the kernel, out of arrays filled with rubbish."""
    strain, ratio = np.full((2, body.mesh.n_tetrahedra), 9.0)
    measure.measure_tetrahedra(body.vertex_of, body.edge_of, body.node_rows.state, body.spring_rows.rest_length,
                               body.tetrahedra.volume, strain, ratio)  # fmt: skip
    return strain, ratio


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["single", "box", "ball", "torus"])
def test_the_kernel_measures_as_numpy_does(name, dtype):
    body = stirred(name, dtype)
    strain, ratio = kernel_measures(body)
    np.testing.assert_allclose(strain, measure.tetrahedron_strains(body), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(ratio, measure.volume_ratios(body), rtol=1e-12, atol=1e-12)
    assert (body.is_alive.all() or name != "single") and (strain[~body.is_alive] == 0.0).all()


@pytest.mark.parametrize("corner", range(4))
def test_the_kernel_does_not_hide_a_position_that_is_not_a_number(corner):
    body = stirred("single")
    body.nodes.position[corner, 1] = np.nan
    strain, ratio = kernel_measures(body)
    assert np.isnan(strain).all() and np.isnan(ratio).all()
