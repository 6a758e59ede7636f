"""The promises of a cut: nothing is lost or made, order does not matter, a refused cut changes nothing."""

import itertools

import numpy as np
import pytest

import gmapspring as gs
from gmapspring.topology import gmap as maps
from tests import naive_links, naive_mechanics, zoo
from tests.bits import assert_same_bits, bits_of
from tests.naive import EDGES, same_partition
from tests.twins import Twins, at_corners

MULTI = tuple(name for name in zoo.SMALL if name != "single")
"""Meshes with an interior face."""


def totals(sim):
    """Return mass [kg], momentum [kg m/s], angular momentum [kg m^2/s], kinetic and elastic energy [J] of a body."""
    body = sim.body
    return {
        "mass": np.sum(body.nodes.mass),
        "momentum": gs.measure.momentum(body),
        "angular_momentum": gs.measure.angular_momentum(body),
        "kinetic_energy": gs.measure.kinetic_energy(body),
        "elastic_energy": gs.measure.elastic_energy(body),
    }


def assert_close(found, expected, scale):
    """Compare totals to 1e-12 of their scale: that of a sum is the sum of the sizes of its parts."""
    for name, value in found.items():
        np.testing.assert_allclose(value, expected[name], rtol=0, atol=1e-12 * scale[name], err_msg=name)


def scales(sim):
    """Return the size of each total if all its parts had one sign."""
    nodes = sim.body.nodes
    speed = np.linalg.norm(nodes.velocity, axis=1)
    reach = np.linalg.norm(nodes.position, axis=1)
    return {**totals(sim), "momentum": nodes.mass @ speed, "angular_momentum": nodes.mass @ (reach * speed)}


def elastic_share(twins, tet):
    """Return the elastic energy [J] that one tetrahedron owns: its E V / l0^2 on each of its six springs."""
    naive = twins.naive
    total = 0.0
    for i, j in EDGES:
        a, b = (naive.points[naive.tetrahedra[tet][corner]] for corner in (i, j))
        rest = np.linalg.norm(b - a)
        length = np.linalg.norm(naive.position[tet, j] - naive.position[tet, i])
        total += 0.5 * naive.modulus[tet] / rest**2 * (length - rest) ** 2
    return total


def share_of(twins, tet):
    """Return the totals that one tetrahedron owns: a quarter of its mass at each corner, and its springs."""
    naive = twins.naive
    quarter = naive.mass[tet] / 4
    positions = np.array([naive.position[tet, corner] for corner in range(4)])
    velocities = np.array([naive.velocity[tet, corner] for corner in range(4)])
    return {
        "mass": naive.mass[tet],
        "momentum": quarter * velocities.sum(axis=0),
        "angular_momentum": quarter * np.cross(positions, velocities).sum(axis=0),
        "kinetic_energy": 0.5 * quarter * np.sum(velocities**2),
        "elastic_energy": elastic_share(twins, tet),
    }


@pytest.mark.parametrize("name", MULTI)
def test_splitting_a_face_conserves_everything(name):
    twins, rng = Twins(zoo.build(name), seed=11), np.random.default_rng(12)
    for tet, other in rng.permutation(twins.naive.sewn_faces())[:25].tolist():
        before, scale = totals(twins.sim), scales(twins.sim)
        twins.split_face(tet, other)
        assert_close(totals(twins.sim), before, scale)


def test_splitting_every_face_of_a_liver_conserves_everything():
    sim = Twins(zoo.build("liver"), seed=13).sim
    before, scale = totals(sim), scales(sim)
    sim.cut(faces=sewn_pairs(sim))
    assert sim.body.n_nodes == 4 * len(sim.body.vertex_of)
    # Thousands of springs instead of a few hundred: the sums are longer, hence ten times the tolerance.
    assert_close(totals(sim), before, {name: 10 * value for name, value in scale.items()})


def sewn_pairs(sim):
    """Return the tetrahedra at every sewn face, int (k, 2)."""
    slots = np.arange(sim.body.gmap.image.size).reshape(-1, 4)
    other = sim.body.gmap.image // 6
    is_lower = slots < other
    return np.stack([slots[is_lower] // 4, other[is_lower] // 4], axis=1)


@pytest.mark.parametrize("name", MULTI)
def test_removing_a_tetrahedron_takes_exactly_its_own_share(name):
    twins, rng = Twins(zoo.build(name), seed=14), np.random.default_rng(15)
    for tet in rng.permutation(sorted(twins.naive.alive))[:-1][:15].tolist():
        before, scale, share = totals(twins.sim), scales(twins.sim), share_of(twins, tet)
        twins.remove_tetrahedron(tet)
        assert_close(totals(twins.sim), {key: before[key] - share[key] for key in before}, scale)


def random_cuts(twins, rng):
    """Draw a set of faces to split and tetrahedra to remove."""
    faces = [pair for pair in twins.naive.sewn_faces() if rng.uniform() < 0.3]
    tetrahedra = [tet for tet in sorted(twins.naive.alive)[1:] if rng.uniform() < 0.15]
    return faces, tetrahedra


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", MULTI)
def test_a_batch_gives_the_same_body_as_its_cuts_one_by_one_in_any_order(name, seed):
    batch, single, shuffled = (Twins(zoo.build(name), seed=16) for _ in range(3))
    rng = np.random.default_rng(seed)
    faces, tetrahedra = random_cuts(batch, rng)
    batch.sim.cut(faces=faces, tetrahedra=tetrahedra)
    for tet, other in faces:
        single.sim.split_face(tet, other)
    for tet in tetrahedra:
        single.sim.remove_tetrahedron(tet)
    for index in rng.permutation(len(faces) + len(tetrahedra)):
        if index < len(faces):
            if set(faces[index]) <= set(np.flatnonzero(shuffled.sim.body.is_alive).tolist()):
                shuffled.sim.split_face(*faces[index])
        else:
            shuffled.sim.remove_tetrahedron(tetrahedra[index - len(faces)])
    for other in (single, shuffled):
        assert_same_body(batch.sim, other.sim)


def assert_same_body(one, other):
    """Check that two bodies are the same up to the numbers of their nodes and springs: masses and the rest bit for bit."""
    a, b = one.body, other.body
    assert same_partition(a.vertex_of, b.vertex_of)
    assert same_partition(a.edge_of, b.edge_of)
    assert same_partition(one.components(), other.components())
    np.testing.assert_array_equal(a.face_of, b.face_of)
    alive = a.is_alive
    for name in ("mass", "inverse_mass", "viscosity", "external", "state", "is_pinned", "point"):
        rows_a, rows_b = getattr(a.node_rows, name), getattr(b.node_rows, name)
        np.testing.assert_array_equal(rows_a[a.vertex_of[alive]], rows_b[b.vertex_of[alive]], err_msg=name)
    for name in ("rest_length", "stiffness", "damping"):
        rows_a, rows_b = getattr(a.spring_rows, name), getattr(b.spring_rows, name)
        np.testing.assert_array_equal(rows_a[a.edge_of[alive]], rows_b[b.edge_of[alive]], err_msg=name)


@pytest.mark.parametrize("name", MULTI)
def test_the_order_inside_a_batch_does_not_matter_to_the_last_bit(name):
    one, other = (Twins(zoo.build(name), seed=17) for _ in range(2))
    faces, tetrahedra = random_cuts(one, np.random.default_rng(18))
    one.sim.cut(faces=faces, tetrahedra=tetrahedra)
    other.sim.cut(faces=[pair[::-1] for pair in faces[::-1]], tetrahedra=tetrahedra[::-1])
    assert_same_bits(bits_of(one.sim), bits_of(other.sim))


@pytest.mark.parametrize("name", MULTI)
def test_splitting_all_faces_and_sewing_them_again_restores_the_body(name):
    twins, rng = Twins(zoo.build(name), seed=19), np.random.default_rng(20)
    intact = Twins(zoo.build(name), seed=19)
    faces = twins.naive.sewn_faces()
    twins.sim.cut(faces=faces)
    for tet, other in rng.permutation(faces).tolist():
        twins.sim.sew_face(tet, other)
    # All copies of a node have the same state, so that sewing leaves its bits alone.
    assert_same_body(twins.sim, intact.sim)
    twins.sim.check_validity()


@pytest.mark.parametrize("name", zoo.SMALL)
def test_sewing_nodes_that_have_drifted_apart_conserves_mass_and_momentum(name):
    twins, rng = Twins(zoo.build(name), seed=21, pinned_share=0.0), np.random.default_rng(22)
    faces = twins.naive.sewn_faces()
    twins.cut(faces)
    twins.stir(rng)
    for tet, other in rng.permutation(np.reshape(faces, (-1, 2))).tolist()[:12]:
        before, scale = totals(twins.sim), scales(twins.sim)
        twins.sew_face(tet, other)
        after = totals(twins.sim)
        assert_close({key: after[key] for key in ("mass", "momentum")}, before, scale)
        assert after["kinetic_energy"] <= before["kinetic_energy"] * (1 + 1e-12)
    twins.assert_agreement()


@pytest.mark.parametrize("name", [name for name in MULTI if name in zoo.MANIFOLD])
def test_a_split_on_a_manifold_body_follows_the_local_rules(name):
    """A face with 0, 1, 2 or 3 edges on the boundary splits (edges, vertices): (0, 0), (1, 0), (2, 1), (3, 3)."""
    twins, rng = Twins(zoo.build(name), seed=23), np.random.default_rng(24)
    for tet, other in rng.permutation(twins.naive.sewn_faces()).tolist():
        if naive_links.singular_nodes(twins.naive):
            break
        n_boundary_edges = boundary_edges_of_face(twins.sim.body, tet, other)
        report = twins.split_face(tet, other)
        expected = {0: (0, 0), 1: (1, 0), 2: (2, 1), 3: (3, 3)}[n_boundary_edges]
        assert (len(report.new_springs), len(report.new_nodes)) == expected
        assert len(report.boundary_faces) == 2


def boundary_edges_of_face(body, tet, other):
    """Count the edges of the face between two tetrahedra that lie on the boundary."""
    mesh_points = [set(body.mesh.tetrahedra[t].tolist()) for t in (tet, other)]
    shared = mesh_points[0] & mesh_points[1]
    corners = [i for i in range(4) if int(body.mesh.tetrahedra[tet, i]) in shared]
    edges = {int(body.edge_of[tet, EDGES.index(pair)]) for pair in itertools.combinations(corners, 2)}
    return len(edges & set(maps.boundary_edges(body.gmap).tolist()))


@pytest.mark.parametrize("integrator", ["rk4", "symplectic_euler"])
@pytest.mark.parametrize("name", MULTI)
def test_no_cut_changes_the_stable_step(name, integrator):
    twins, rng = Twins(zoo.build(name), seed=25, integrator=integrator), np.random.default_rng(26)
    step = twins.sim.stable_step
    for _ in range(10):
        twins.random_operation(rng)
        assert twins.sim.stable_step == step


def test_the_copies_of_a_split_node_keep_its_state_pin_and_mesh_point():
    twins = Twins(zoo.build("two"), seed=27, pinned_share=0.5)
    before = {name: at_corners(twins.sim.body, getattr(twins.sim.body.nodes, name)) for name in NODE_STATE}
    twins.split_face(0, 1)
    for name in NODE_STATE:
        np.testing.assert_array_equal(at_corners(twins.sim.body, getattr(twins.sim.body.nodes, name)), before[name])


NODE_STATE = ("position", "velocity", "is_pinned", "point")
"""What both copies of a split node have of the old one."""


def bad_calls():
    """Return calls on a box whose face (0, 1) is cut and whose tetrahedron 7 is removed, each of them wrong."""
    return {
        "split what is cut": lambda sim: sim.split_face(0, 1),
        "split what is cut, the other way round": lambda sim: sim.split_face(1, 0),
        "split tetrahedra that share no face": lambda sim: sim.split_face(0, 47),
        "split a tetrahedron from itself": lambda sim: sim.split_face(0, 0),
        "split from a removed one": lambda sim: sim.split_face(*removed_neighbours(sim)[0]),
        "split out of range": lambda sim: sim.split_face(0, 48),
        "split a negative one": lambda sim: sim.split_face(-1, 0),
        "split by a fraction": lambda sim: sim.split_face(0.5, 1),
        "remove a removed one": lambda sim: sim.remove_tetrahedron(7),
        "remove out of range": lambda sim: sim.remove_tetrahedron(48),
        "remove a negative one": lambda sim: sim.remove_tetrahedron(-1),
        "remove by a fraction": lambda sim: sim.remove_tetrahedron(1.5),
        "sew what is sewn": lambda sim: sim.sew_face(*sewn_pairs(sim)[0]),
        "sew strangers": lambda sim: sim.sew_face(0, 47),
        "sew to itself": lambda sim: sim.sew_face(0, 0),
        "sew to a removed one": lambda sim: sim.sew_face(*removed_neighbours(sim)[0]),
        "sew out of range": lambda sim: sim.sew_face(0, 48),
        "sew a negative one": lambda sim: sim.sew_face(-1, 0),
        "batch with a cut face last": lambda sim: sim.cut(faces=[*sewn_pairs(sim)[:3], (0, 1)]),
        "batch with strangers last": lambda sim: sim.cut(faces=[*sewn_pairs(sim)[:3], (0, 47)]),
        "batch with a face out of range": lambda sim: sim.cut(faces=[*sewn_pairs(sim)[:3], (0, 48)]),
        "batch with a removed tetrahedron": lambda sim: sim.cut(faces=sewn_pairs(sim)[:3], tetrahedra=[3, 7]),
        "batch out of range": lambda sim: sim.cut(faces=sewn_pairs(sim)[:3], tetrahedra=[3, 48]),
        "batch with a negative one": lambda sim: sim.cut(faces=sewn_pairs(sim)[:3], tetrahedra=[3, -2]),
        "batch of fractions": lambda sim: sim.cut(tetrahedra=[3.5]),
        "batch of triples": lambda sim: sim.cut(faces=[(0, 1, 2)]),
        "batch of pairs and one more": lambda sim: sim.cut(faces=[*sewn_pairs(sim)[:3], (2,)]),
        "batch that is one number": lambda sim: sim.cut(tetrahedra=5),
    }


def removed_neighbours(sim):
    """Return pairs (a live tetrahedron, 7) that shared a face in the mesh."""
    points = [set(row) for row in sim.body.mesh.tetrahedra.tolist()]
    return [(tet, 7) for tet in range(len(points)) if tet != 7 and len(points[tet] & points[7]) == 3]


@pytest.mark.parametrize("wrong", bad_calls())
def test_a_wrong_call_is_refused_and_changes_nothing(wrong):
    twins = Twins(zoo.build("box"), seed=28)
    pair = twins.naive.sewn_faces()[0]
    assert pair == (0, 1)
    twins.split_face(*pair)
    twins.remove_tetrahedron(7)
    before = bits_of(twins.sim)
    with pytest.raises(gs.TopologyError, match=r"\d"):
        bad_calls()[wrong](twins.sim)
    assert_same_bits(bits_of(twins.sim), before)
    twins.assert_agreement()


def test_an_empty_batch_changes_nothing():
    sim = Twins(zoo.build("box"), seed=29).sim
    before = bits_of(sim)
    report = sim.cut()
    assert_same_bits(bits_of(sim), before)
    assert len(report.new_nodes) == len(report.new_springs) == len(report.boundary_faces) == 0


def test_what_appears_twice_in_a_batch_is_cut_once():
    once, twice = (Twins(zoo.build("box"), seed=30).sim for _ in range(2))
    pairs = sewn_pairs(once)[:3].tolist()
    once.cut(faces=pairs, tetrahedra=[9])
    twice.cut(faces=[*pairs, pairs[0][::-1]], tetrahedra=[9, 9])
    assert_same_bits(bits_of(once), bits_of(twice))


@pytest.mark.parametrize("name", MULTI)
def test_the_mass_of_every_node_is_that_of_its_tetrahedra_to_the_last_bit(name):
    twins, rng = Twins(zoo.build(name), seed=31), np.random.default_rng(32)
    for _ in range(10):
        twins.random_operation(rng)
    mass = at_corners(twins.sim.body, twins.sim.body.nodes.mass)
    twins.naive.mass = twins.sim.body.tetrahedra.mass  # their own bits: volumes may be computed in another order
    np.testing.assert_array_equal(mass, naive_mechanics.node_mass(twins.naive))


def test_numbers_of_any_whole_type_name_the_same_tetrahedra():
    plain, typed = Twins(zoo.build("box")).sim, Twins(zoo.build("box")).sim
    first, second = sewn_pairs(plain)[5]
    plain.split_face(first, second)
    typed.split_face(np.uint64(first), np.int8(second))
    plain.sew_face(first, second)
    typed.sew_face(np.uint8(first), np.int16(second))
    plain.cut(sewn_pairs(plain)[:2], [40])
    typed.cut(np.array(sewn_pairs(typed)[:2], dtype=np.uint16), np.array([40], dtype=np.uint64))
    plain.remove_tetrahedron(41)
    typed.remove_tetrahedron(np.int8(41))
    assert_same_bits(bits_of(plain), bits_of(typed))
