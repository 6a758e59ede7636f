"""The generated meshes are sound and repeatable; the shipped liver is what it claims to be."""

import numpy as np
import pytest

from gmapspring import meshes
from gmapspring.errors import MeshError
from gmapspring.mesh import pinched_points
from gmapspring.paths import configs_folder

EDGE_CORNERS = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
FACE_CORNERS = [(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)]
PAPER_COUNTS = np.array([564, 2850, 1856])
"""Nodes, springs and tetrahedra of the body in Meseure, Darles and Skapin (2010)."""


def edges(mesh):
    """Return the edges of a mesh, shape (n_edges, 2)."""
    return np.unique(np.sort(mesh.tetrahedra[:, EDGE_CORNERS].reshape(-1, 2), axis=1), axis=0)


def faces(mesh):
    """Return the faces of a mesh and on how many tetrahedra each lies."""
    return np.unique(np.sort(mesh.tetrahedra[:, FACE_CORNERS].reshape(-1, 3), axis=1), axis=0, return_counts=True)


def dihedral_angles(mesh):
    """Return the dihedral angles [degrees], shape (n_tetrahedra, 6)."""
    corners = mesh.points[mesh.tetrahedra][:, FACE_CORNERS]
    normals = np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    first, second = np.array(EDGE_CORNERS).T
    return np.degrees(np.arccos(-(normals[:, first] * normals[:, second]).sum(axis=2)))


def components(rows, n):
    """Return the number of connected parts of ids 0 to n - 1, those in a row being joined; unnamed ids count alone."""
    leader = list(range(n))

    def find(item):
        while leader[item] != item:
            leader[item] = leader[leader[item]]
            item = leader[item]
        return item

    for row in rows:
        for other in row[1:]:
            leader[find(other)] = find(row[0])
    return len({find(item) for item in range(n)})


def assert_is_one_ball(mesh):
    """Assert what makes a mesh a ball: connected through faces, Euler number 1, and one sphere as its boundary."""
    all_faces, counts = faces(mesh)
    surface = all_faces[counts == 1]
    place_of_face = {tuple(face): place for place, face in enumerate(all_faces.tolist())}
    tetrahedra_of = [[] for _ in all_faces]
    for tetrahedron, corners in enumerate(np.sort(mesh.tetrahedra, axis=1).tolist()):
        for skipped in range(4):
            face = tuple(corners[:skipped] + corners[skipped + 1 :])
            tetrahedra_of[place_of_face[face]].append(tetrahedron)
    assert components(tetrahedra_of, mesh.n_tetrahedra) == 1
    assert mesh.n_points - len(edges(mesh)) + len(all_faces) - mesh.n_tetrahedra == 1
    surface_points, renumbered = np.unique(surface, return_inverse=True)
    surface_edges, on_edge = np.unique(
        np.sort(surface[:, [(0, 1), (1, 2), (0, 2)]].reshape(-1, 2), axis=1), axis=0, return_counts=True
    )
    assert (on_edge == 2).all()
    assert components(renumbered.reshape(-1, 3).tolist(), len(surface_points)) == 1
    assert len(surface_points) - len(surface_edges) + len(surface) == 2
    assert len(pinched_points(mesh).points) == 0
    # No two parts of the surface touch at a point: around each, its triangles form one ring.
    for point in surface_points:
        ring = [[corner for corner in face if corner != point] for face in surface.tolist() if point in face]
        used, places = np.unique(ring, return_inverse=True)
        assert components(places.reshape(-1, 2).tolist(), len(used)) == 1


def test_a_single_tetrahedron_is_regular():
    mesh = meshes.single(0.2)
    assert mesh.n_points == 4 and mesh.n_tetrahedra == 1
    assert mesh.volumes == pytest.approx([0.2**3 / (6 * np.sqrt(2))])
    assert dihedral_angles(mesh) == pytest.approx(np.degrees(np.arccos(1 / 3)))


def test_two_tetrahedra_share_one_face():
    mesh = meshes.two_tetrahedra(0.2)
    assert np.isin([0, 1, 2], mesh.tetrahedra[0]).all() and np.isin([0, 1, 2], mesh.tetrahedra[1]).all()
    assert mesh.volumes == pytest.approx([0.2**3 / (6 * np.sqrt(2))] * 2)
    lengths = np.linalg.norm(mesh.points[edges(mesh)[:, 0]] - mesh.points[edges(mesh)[:, 1]], axis=1)
    assert lengths == pytest.approx(0.2)


@pytest.mark.parametrize("is_mirrored", [False, True])
@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 3, 4), (5, 1, 2)])
def test_a_box_is_cut_into_six_equal_tetrahedra_per_cube(shape, is_mirrored):
    mesh = meshes.box(shape, 0.01, is_mirrored)
    assert mesh.n_tetrahedra == 6 * np.prod(shape)
    assert mesh.n_points == np.prod(np.add(shape, 1))
    assert mesh.volumes == pytest.approx(0.01**3 / 6)
    assert mesh.points.min(axis=0) == pytest.approx([0, 0, 0])
    assert mesh.points.max(axis=0) == pytest.approx(0.01 * np.array(shape))
    assert_is_one_ball(mesh)


@pytest.mark.parametrize("is_mirrored", [False, True])
def test_each_cube_of_a_box_owns_six_consecutive_tetrahedra(is_mirrored):
    mesh = meshes.box((2, 3, 4), is_mirrored=is_mirrored)
    cubes = mesh.points[mesh.tetrahedra].reshape(-1, 24, 3).min(axis=1)
    assert np.array_equal(cubes, np.stack(np.meshgrid(range(2), range(3), range(4), indexing="ij"), -1).reshape(-1, 3))


@pytest.mark.parametrize(("is_mirrored", "n_ways"), [(False, 1), (True, 4)])
def test_the_space_diagonals_of_a_mirrored_box_run_all_ways_and_of_a_plain_one_the_same_way(is_mirrored, n_ways):
    mesh = meshes.box((2, 2, 2), is_mirrored=is_mirrored)
    ends = mesh.points[edges(mesh)]
    offsets = ends[:, 1] - ends[:, 0]
    diagonals = offsets[np.linalg.norm(offsets, axis=1) > 1.7]
    assert len(diagonals) == 8
    assert len({tuple(way) for way in diagonals * np.sign(diagonals[:, :1])}) == n_ways


@pytest.mark.parametrize("n_shells", [1, 2, 4])
def test_a_ball_is_round_whole_and_well_shaped(n_shells):
    mesh = meshes.ball(n_shells, radius=0.05)
    all_faces, counts = faces(mesh)
    surface = np.unique(all_faces[counts == 1])
    assert mesh.n_tetrahedra == 20 * n_shells**3
    assert np.linalg.norm(mesh.points[surface], axis=1) == pytest.approx(0.05)
    assert dihedral_angles(mesh).min() > 40 and dihedral_angles(mesh).max() < 130
    assert_is_one_ball(mesh)


def test_a_finer_ball_fills_the_sphere():
    """The gap between a sphere and its facets shrinks with the square of the facets' size."""
    sphere = 4 / 3 * np.pi
    gaps = [1 - meshes.ball(n_shells).volumes.sum() / sphere for n_shells in (2, 4, 8)]
    assert np.diff(np.log2(gaps)) == pytest.approx(-2, abs=0.2)


@pytest.mark.parametrize("make", [meshes.single, meshes.two_tetrahedra, lambda: meshes.box((3, 2, 2), 0.1), meshes.ball])
def test_generated_meshes_are_the_same_every_time(make):
    first, second = make(), make()
    assert np.array_equal(first.points, second.points) and np.array_equal(first.tetrahedra, second.tetrahedra)


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: meshes.single(0), "size is 0"),
        (lambda: meshes.two_tetrahedra(np.nan), "size is nan"),
        (lambda: meshes.box((0, 1, 1)), r"shape is \(0, 1, 1\)"),
        (lambda: meshes.box((1, 1)), r"shape is \(1, 1\)"),
        (lambda: meshes.box((1.5, 1, 1)), r"shape is \(1.5, 1, 1\)"),
        (lambda: meshes.box((1, 1, 1), spacing=-1), "spacing is -1"),
        (lambda: meshes.box((1, 1, 1), spacing="wide"), "spacing is 'wide'"),
        (lambda: meshes.ball(0), "n_shells is 0"),
        (lambda: meshes.ball(2.0), "n_shells is 2.0"),
        (lambda: meshes.ball(2, radius=np.inf), "radius is inf"),
    ],
)
def test_sizes_that_make_no_mesh_are_refused(make, reason):
    with pytest.raises(MeshError, match=reason):
        make()


def test_the_liver_has_the_size_of_the_papers_body():
    """Points, edges and tetrahedra within 2 % of the paper's."""
    liver = meshes.liver()
    counts = np.array([liver.n_points, len(edges(liver)), liver.n_tetrahedra])
    assert (np.abs(counts / PAPER_COUNTS - 1) < 0.02).all()
    assert np.ptp(liver.points, axis=0) == pytest.approx([0.20, 0.12, 0.08], rel=0.1)


def test_the_liver_is_one_ball():
    assert_is_one_ball(meshes.liver())


def test_the_liver_has_no_bad_angles():
    angles = dihedral_angles(meshes.liver())
    assert angles.min() > 15 and angles.max() < 150


def test_the_liver_is_stored_near_its_neighbours():
    """The corners of a tetrahedron, and tetrahedra that follow each other, lie close in memory: a shuffled mesh has a
    mean spread of 0.6 of all points among four corners."""
    liver = meshes.liver()
    assert np.ptp(liver.tetrahedra, axis=1).mean() < 0.15 * liver.n_points
    assert np.abs(np.diff(liver.tetrahedra.mean(axis=1))).mean() < 0.05 * liver.n_points


def test_the_liver_hangs_by_an_anchor_on_its_surface():
    liver = meshes.liver()
    all_faces, counts = faces(liver)
    anchor = np.flatnonzero(liver.point_regions["anchor"])
    assert 10 <= len(anchor) <= 60
    assert np.isin(anchor, all_faces[counts == 1]).all()


def test_the_liver_has_a_tumour_under_its_surface_away_from_the_anchor():
    """In one piece, and so is the rest without it."""
    liver = meshes.liver()
    tumour = liver.cell_regions["tumour"]
    assert 15 <= tumour.sum() <= 40
    assert not liver.point_regions["anchor"][liver.tetrahedra[tumour]].any()
    for part in (tumour, ~tumour):
        used, renumbered = np.unique(liver.tetrahedra[part], return_inverse=True)
        rows = renumbered.reshape(-1, 4)
        sides = {}
        for tetrahedron, corners in enumerate(np.sort(rows, axis=1).tolist()):
            for skipped in range(4):
                sides.setdefault(tuple(corners[:skipped] + corners[skipped + 1 :]), []).append(tetrahedron)
        assert components(sides.values(), len(rows)) == 1


def test_the_liver_ships_with_the_script_that_made_it():
    assert (configs_folder() / "meshes" / "make_liver.py").is_file()
    assert (configs_folder() / "meshes" / "liver.vtu").stat().st_size < 60_000
