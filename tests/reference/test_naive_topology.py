"""The fast body against the naive one: random cuts over the zoo, topology exactly, mechanics to round-off."""

import numpy as np
import pytest

import gmapspring as gs
from gmapspring.topology import gmap as maps
from tests import naive_links, naive_mechanics, zoo
from tests.bits import assert_same_bits, bits_of
from tests.naive import NaiveBody, same_partition
from tests.twins import Twins, assert_same_topology

N_OPERATIONS = {"liver": 2, "ball": 4, "hollow_box": 8}
"""Fewer on large meshes, to save time; elsewhere 20."""


@pytest.mark.parametrize("name", zoo.ALL)
def test_fast_equals_naive_after_every_random_operation(name):
    twins, rng = Twins(zoo.build(name), seed=3), np.random.default_rng(4)
    twins.assert_agreement()
    for _ in range(N_OPERATIONS.get(name, 20)):
        if twins.random_operation(rng):
            twins.assert_agreement()


@pytest.mark.parametrize("name", ["box", "pinched_block", "torus", "star"])
def test_fast_equals_naive_while_a_body_is_taken_apart_face_by_face(name):
    twins, rng = Twins(zoo.build(name), seed=5), np.random.default_rng(6)
    for tet, other in rng.permutation(twins.naive.sewn_faces()).tolist():
        twins.split_face(tet, other)
        assert_same_topology(twins.sim, twins.naive)
    twins.assert_agreement()
    assert twins.sim.body.n_nodes == 4 * twins.mesh.n_tetrahedra


@pytest.mark.parametrize("integrator", gs.simulation.INTEGRATORS)
@pytest.mark.parametrize("name", ["two", "ring", "torus", "cubes_sharing_an_edge"])
def test_fast_moves_as_naive_between_cuts(name, integrator):
    twins, rng = Twins(zoo.build(name), seed=7, integrator=integrator), np.random.default_rng(8)
    precision = 1e-5 if integrator == "backward_euler" else 1e-12  # its equation is solved to 1e-6, twenty times
    for _ in range(4):
        twins.random_operation(rng, kinds=("split", "remove"))
        twins.advance(5)
        twins.assert_agreement(precision)


@pytest.mark.parametrize("options", [{"has_all_terms": False}, {"dtype": np.float32}], ids=["no terms", "float32"])
@pytest.mark.parametrize("name", ["star", "cubes_sharing_a_vertex"])
def test_fast_equals_naive_without_optional_terms_and_in_single_precision(name, options):
    twins, rng = Twins(zoo.build(name), seed=9, **options), np.random.default_rng(10)
    # Single precision rounds each stored number to 6e-8 of itself, and an average of a few of them.
    precision = 1e-12 if "dtype" not in options else 1e-6
    for _ in range(12):
        if twins.random_operation(rng):
            twins.assert_agreement(precision)


@pytest.mark.parametrize("name", ["star", "box"])
def test_a_saved_state_goes_on_as_if_nothing_had_happened_between(name):
    twins, rng = Twins(zoo.build(name), seed=11), np.random.default_rng(12)
    for _ in range(4):
        twins.random_operation(rng)
    state, snapshot = twins.sim.save_state(), twins.naive.snapshot()
    bits = []
    for digression in (2, 3):
        twins.set_loads(np.random.default_rng(digression))
        for _ in range(6):
            twins.random_operation(np.random.default_rng(digression))
            twins.sim.advance(0.01)
        twins.sim.load_state(state)
        twins.naive.restore(snapshot)
        following = np.random.default_rng(13)
        for _ in range(4):
            twins.random_operation(following)
            twins.sim.advance(0.01)
        bits.append(bits_of(twins.sim))
        twins.sim.check_validity()
    assert_same_bits(*bits)


@pytest.mark.parametrize("name", zoo.SMALL)
def test_fast_measures_as_naive(name):
    twins, rng = Twins(zoo.build(name), seed=9), np.random.default_rng(10)
    for _ in range(5):
        twins.random_operation(rng)
        body, naive = twins.sim.body, twins.naive
        assert gs.measure.kinetic_energy(body) == pytest.approx(naive_mechanics.kinetic_energy(naive), rel=1e-12)
        assert gs.measure.elastic_energy(body) == pytest.approx(naive_mechanics.elastic_energy(naive), rel=1e-12)
        # Momentum is a sum with signs: its round-off scales with its parts, at most the total mass times 1 m/s.
        scale = float(np.sum(naive.mass))
        np.testing.assert_allclose(
            gs.measure.momentum(body), naive_mechanics.momentum(naive), rtol=0, atol=1e-12 * scale
        )


def naive(name):
    """Return a naive body of plain material."""
    return NaiveBody(zoo.build(name), gs.Material(young_modulus=1.0, density=1.0))


def test_the_naive_body_finds_the_singular_node_of_the_pinched_block_and_no_other():
    assert {name: len(naive_links.singular_nodes(naive(name))) for name in zoo.SMALL if name != "pinched_block"} == {
        name: 0 for name in zoo.SMALL if name != "pinched_block"
    }
    assert len(naive_links.singular_nodes(naive("pinched_block"))) == 1


@pytest.mark.parametrize(
    ("name", "n_nodes", "n_springs", "n_components", "n_boundary_faces"),
    [
        ("single", 4, 6, 1, 4),
        ("two", 5, 9, 1, 6),
        ("ring", 8, 6 + 12 + 1, 1, 12),  # rim, spokes to both poles, axis
        ("cubes_sharing_a_vertex", 16, 2 * 19, 2, 24),  # a cube: 12 edges, 6 face diagonals, 1 space diagonal
        ("cubes_sharing_an_edge", 16, 2 * 19, 2, 24),
    ],
)
def test_the_naive_body_counts_cells_as_by_hand(name, n_nodes, n_springs, n_components, n_boundary_faces):
    body = naive(name)
    assert len(np.unique(body.vertex_labels())) == n_nodes
    assert len(np.unique(body.edge_labels())) == n_springs
    assert len(np.unique(body.component_labels())) == n_components
    assert len(body.boundary_faces()) == n_boundary_faces


@pytest.mark.parametrize(
    ("one", "other", "is_same"),
    [
        ([0, 0, 1], [5, 5, 2], True),
        ([0, 0, 1], [5, 5, 5], False),
        ([0, 1, 2], [0, 1, 1], False),
        ([0, -1, 2], [0, -1, 1], True),
        ([0, -1, 2], [0, 3, 1], False),
        ([0, 1], [0, 1, 2], False),
    ],
)
def test_same_partition_compares_up_to_renumbering(one, other, is_same):
    assert same_partition(one, other) == is_same


@pytest.mark.parametrize("name", ["two", "cubes_sharing_a_vertex", "box"])
def test_a_load_on_a_point_is_shared_by_mass_among_the_nodes_it_becomes(name):
    mesh = zoo.build(name)
    sim, rng = Twins(mesh, seed=14, has_all_terms=False).sim, np.random.default_rng(15)
    loads = rng.uniform(-1.0, 1.0, (mesh.n_points, 3))
    sim.set_loads(loads)
    sim.cut(faces=NaiveBody(mesh, sim.body.material).sewn_faces())
    nodes = sim.body.nodes
    mass_at_point = np.bincount(nodes.point, nodes.mass, mesh.n_points)
    expected = loads[nodes.point] * (nodes.mass / mass_at_point[nodes.point])[:, None]
    np.testing.assert_allclose(nodes.external[:, :3], expected, rtol=1e-12)


@pytest.mark.parametrize("old_mark", range(1, 12))
def test_walks_survive_the_overflow_of_their_stamps(old_mark):
    twins = Twins(zoo.build("ring"), seed=16)
    gmap = twins.sim.body.gmap
    gmap.counts[maps.STAMP] = 2**31 - 1
    gmap.mark[:] = old_mark  # left by an old walk, and soon the mark of a new one
    twins.remove_tetrahedron(2)
    twins.split_face(4, 5)
    twins.assert_agreement()
    assert 0 < gmap.counts[maps.STAMP] < 10_000
