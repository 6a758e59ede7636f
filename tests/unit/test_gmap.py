"""The map: its tables, its involutions, its orbits, its boundary, its memory."""

import itertools

import numpy as np
import pytest
from numba import njit

from gmapspring.errors import TopologyError
from gmapspring.topology import gmap as topology
from gmapspring.topology import sewing
from gmapspring.topology.build import build_gmap, rarest_point
from gmapspring.topology.coverage import cell_of_darts, cover_by_marks, cover_by_representatives
from gmapspring.topology.darts import ALPHA, FACE_EDGES, ORDERINGS
from gmapspring.topology.gmap import alpha, orbit
from gmapspring.validity import check_gmap
from tests import zoo


def map_of(mesh):
    """Build the map of a mesh."""
    return build_gmap(mesh.tetrahedra, mesh.n_points)


def test_the_24_local_darts_are_the_24_orderings_of_four_corners():
    assert sorted(map(tuple, ORDERINGS.tolist())) == sorted(itertools.permutations(range(4)))


@pytest.mark.parametrize("i", [0, 1, 2])
def test_alpha_inside_a_tetrahedron_exchanges_two_neighbours_of_the_ordering(i):
    expected = ORDERINGS.copy()
    expected[:, [i, i + 1]] = expected[:, [i + 1, i]]
    np.testing.assert_array_equal(ORDERINGS[ALPHA[i]], expected)


def test_alpha3_keeps_the_vertex_edge_and_face_of_a_dart(any_mesh):
    gmap = map_of(any_mesh)
    darts = np.arange(24 * any_mesh.n_tetrahedra)
    corners = any_mesh.tetrahedra[darts[:, None] // 24, ORDERINGS[darts % 24, :3]]
    across = alpha(gmap, 3, darts)
    np.testing.assert_array_equal(any_mesh.tetrahedra[across[:, None] // 24, ORDERINGS[across % 24, :3]], corners)


def test_every_map_of_the_zoo_is_valid_and_keeps_the_point_numbers(any_mesh):
    gmap = map_of(any_mesh)
    check_gmap(gmap)
    own = gmap.vertex_of < any_mesh.n_points
    np.testing.assert_array_equal(gmap.vertex_of[own], any_mesh.tetrahedra[own])


@pytest.mark.parametrize("dimension", range(4))
def test_both_coverages_find_the_same_cells_and_the_orbits_agree(small_mesh, dimension):
    gmap = map_of(small_mesh)
    by_marks = cover_by_marks(gmap, dimension)
    np.testing.assert_array_equal(by_marks, np.sort(cover_by_representatives(gmap, dimension)))
    cells = cell_of_darts(gmap, dimension)
    involutions = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))[dimension]
    for dart in by_marks[:12]:
        np.testing.assert_array_equal(orbit(gmap, dart, involutions), np.flatnonzero(cells == dart))


def test_a_ball_has_the_euler_characteristic_of_a_ball():
    gmap = map_of(zoo.build("ball"))
    counts = [len(cover_by_marks(gmap, i)) for i in range(4)]
    assert counts[0] - counts[1] + counts[2] - counts[3] == 1  # V - E + F - T of a ball
    faces = topology.boundary_faces(gmap)
    n_surface = [len(topology.boundary_vertices(gmap)), len(topology.boundary_edges(gmap)), len(faces)]
    assert n_surface[0] - n_surface[1] + n_surface[2] == 2  # of its surface, a sphere


def test_vertices_are_on_the_boundary_exactly_if_a_free_face_touches_them(any_mesh):
    gmap = map_of(any_mesh)
    faces = topology.boundary_faces(gmap)
    edges = gmap.edge_of[faces[:, :1], FACE_EDGES[faces[:, 1]]]
    touched = {v for (t, f) in faces.tolist() for c, v in enumerate(gmap.vertex_of[t].tolist()) if c != f}
    assert touched == set(topology.boundary_vertices(gmap).tolist())
    assert set(edges.ravel().tolist()) == set(topology.boundary_edges(gmap).tolist())


def test_the_pinched_block_has_one_singular_vertex_and_the_box_none():
    assert len(topology.singular_vertices(map_of(zoo.build("box")))) == 0
    gmap = map_of(zoo.pinched_block())
    singular = topology.singular_vertices(gmap)
    assert len(singular) == 1
    assert topology.link_characteristic(gmap)[singular[0]] == 0  # a band: neither sphere (2) nor disc (1)


def test_parts_that_share_only_a_vertex_get_vertices_of_their_own():
    mesh = zoo.two_cubes((1, 1, 1))
    gmap = map_of(mesh)
    assert gmap.counts[topology.N_VERTICES] == mesh.n_points + 1
    assert topology.components(gmap).max() == 1


@njit
def rarest_point_of(corners, slot, degree):
    """Call what only kernels can call."""
    return rarest_point(corners, slot, degree)


@pytest.mark.parametrize("hub", [0, 7, 50])
def test_a_point_where_all_tetrahedra_meet_is_glued_without_comparing_all_with_all(hub):
    # A ring of tetrahedra about an axis, as an orange has wedges; the axis ends at the hub and at the next point.
    n = 400
    rim = np.setdiff1d(np.arange(n + 2), [hub, hub + 1])
    ring = np.stack([np.full(n, hub), np.full(n, hub + 1), rim, np.roll(rim, -1)], axis=1)
    gmap = build_gmap(ring, n + 2)
    check_gmap(gmap)
    assert gmap.counts[:4].tolist() == [n + 2, 1 + 3 * n, n, 1] and topology.is_free(gmap).sum() == 2 * n
    degree = np.bincount(ring.ravel())
    buckets = np.bincount([rarest_point_of(ring, slot, degree) for slot in range(4 * n)])
    assert buckets.max() <= 8


def test_unsewing_and_sewing_a_face_restores_the_map():
    gmap = map_of(zoo.build("ball"))
    image, vertex_of, edge_of = gmap.image.copy(), gmap.vertex_of.copy(), gmap.edge_of.copy()
    dart = int(np.flatnonzero(alpha(gmap, 3, np.arange(24 * len(image))) != np.arange(24 * len(image)))[5])
    other = alpha(gmap, 3, dart)
    sewing.unsew(gmap, dart)
    check_gmap(gmap)
    assert alpha(gmap, 3, dart) == dart
    sewing.sew(gmap, dart, other)
    check_gmap(gmap)
    np.testing.assert_array_equal(gmap.image, image)
    np.testing.assert_array_equal(gmap.vertex_of, vertex_of)
    np.testing.assert_array_equal(gmap.edge_of >= 0, edge_of >= 0)


def test_sewing_refuses_with_the_numbers_of_the_darts():
    gmap = map_of(zoo.build("two"))
    sewn = int(np.flatnonzero(alpha(gmap, 3, np.arange(48)) != np.arange(48))[0])
    other = alpha(gmap, 3, sewn)
    free = next(d for d in range(24) if alpha(gmap, 3, d) == d)
    with pytest.raises(TopologyError, match=f"cannot 3-sew darts {free} and {other}: dart {other} is not 3-free"):
        sewing.sew(gmap, free, other)
    with pytest.raises(TopologyError, match=f"cannot 3-unsew dart {free}"):
        sewing.unsew(gmap, free)
    with pytest.raises(TopologyError, match="belong to one face"):
        sewing.sew(gmap, free, free)
    sewing.unsew(gmap, sewn)
    with pytest.raises(TopologyError, match="inside out"):
        sewing.sew(gmap, sewn, alpha(gmap, 0, other))
    check_gmap(gmap)


def test_alpha_refuses_what_is_no_dart_or_no_involution():
    gmap = map_of(zoo.build("single"))
    with pytest.raises(TopologyError, match="dart 24 is out of range 0..23"):
        alpha(gmap, 0, 24)
    with pytest.raises(TopologyError, match="alpha_4 does not exist"):
        alpha(gmap, 4, 0)
    with pytest.raises(TopologyError, match="no 4-cells"):
        cover_by_marks(gmap, 4)


def test_the_map_takes_at_most_80_bytes_a_tetrahedron():
    mesh = zoo.build("liver")
    gmap = map_of(mesh)
    per_tetrahedron = [gmap.image, gmap.vertex_of, gmap.edge_of, gmap.component_of, gmap.mark, gmap.queue]
    n_vertices, n_edges = gmap.counts[:2]
    per_cell = [gmap.vertex_dart[:n_vertices], gmap.edge_dart[:n_edges], gmap.link[:n_vertices]]
    assert sum(array.nbytes for array in per_tetrahedron + per_cell) <= 80 * mesh.n_tetrahedra


CORRUPTIONS = {
    "image": ("alpha_3", lambda gmap: gmap.image.__setitem__((0, 0), gmap.image[0, 0] ^ 1)),
    "vertex number": ("vertex", lambda gmap: gmap.vertex_of.__setitem__((0, 0), gmap.vertex_of[0, 1])),
    "edge number": ("edge", lambda gmap: gmap.edge_of.__setitem__((3, 2), gmap.edge_of[0, 0])),
    "dart of a vertex": ("lowest", lambda gmap: gmap.vertex_dart.__setitem__(1, gmap.vertex_dart[0])),
    "link count": ("counter", lambda gmap: gmap.link.__setitem__((2, 1), 99)),
    "component": ("components", lambda gmap: gmap.component_of.__setitem__(4, 7)),
    "count of tetrahedra": ("counted", lambda gmap: gmap.counts.__setitem__(topology.N_TETRAHEDRA, 1)),
}


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_a_corrupted_map_is_found_out(name):
    message, corrupt = CORRUPTIONS[name]
    gmap = map_of(zoo.build("box"))
    corrupt(gmap)
    with pytest.raises(TopologyError, match=message):
        check_gmap(gmap)
