"""A mesh refuses everything that a body cannot be built on, and says what is wrong where."""

import pickle
import time

import numpy as np
import pytest

from gmapspring import meshes
from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh, pinched_points

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], dtype=float)
TWO_POINTS = np.array([*CORNERS, (1, 1, 1)])
TWO = np.array([(0, 1, 2, 3), (1, 2, 3, 4)])


def refusal(points, tetrahedra, **regions):
    """Return the message of the error that a mesh is refused with."""
    with pytest.raises(MeshError) as caught:
        Mesh(points, tetrahedra, **regions)
    return str(caught.value)


def test_a_good_mesh_keeps_its_arrays_and_knows_its_volumes():
    mesh = Mesh(TWO_POINTS, TWO, {"left": [True, False]}, {"tip": np.arange(5) == 4})
    assert mesh.n_points == 5 and mesh.n_tetrahedra == 2
    assert mesh.points.dtype == np.float64 and mesh.tetrahedra.dtype == np.int32
    assert np.array_equal(mesh.tetrahedra, TWO)
    assert mesh.volumes == pytest.approx([1 / 6, 2 / 6])
    assert mesh.cell_regions["left"].tolist() == [True, False]
    assert mesh.point_regions["tip"].tolist() == [False] * 4 + [True]


def test_a_mesh_cannot_be_changed_from_outside():
    points = TWO_POINTS.copy()
    mesh = Mesh(points, TWO, {"left": np.array([True, False])})
    points[0] = 5.0
    assert mesh.points[0].tolist() == [0, 0, 0]
    for array in (mesh.points, mesh.tetrahedra, mesh.volumes, mesh.cell_regions["left"]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    with pytest.raises(AttributeError):
        mesh.points = points


def test_a_pickled_mesh_comes_back_the_same_and_read_only():
    mesh = meshes.box((1, 2, 1), 0.1)
    copy = pickle.loads(pickle.dumps(mesh))
    assert np.array_equal(copy.points, mesh.points) and np.array_equal(copy.tetrahedra, mesh.tetrahedra)
    assert not copy.points.flags.writeable and not copy.tetrahedra.flags.writeable


def test_a_face_with_three_tetrahedra_is_refused():
    points = np.array([*CORNERS, (0, 0, -1), (1, 1, 2)])
    message = refusal(points, [(0, 1, 2, 3), (0, 2, 1, 4), (0, 1, 2, 5)])
    assert "face [0, 1, 2] has three tetrahedra: [0, 1, 2]" in message


def test_two_tetrahedra_on_the_same_corners_are_refused():
    assert "tetrahedra 0 and 2 are on the same corners [0, 1, 2, 3]" in refusal(TWO_POINTS, [*TWO, (1, 2, 0, 3)])


def test_two_tetrahedra_on_the_same_side_of_their_face_are_refused():
    """Both volumes are positive, yet the gluing would not be oriented."""
    points = np.array([*CORNERS, (0.2, 0.2, 2)])
    message = refusal(points, [(0, 1, 2, 3), (0, 1, 2, 4)])
    assert "tetrahedra 0 and 1 lie on the same side of their face [0, 1, 2]" in message


def test_a_repeated_corner_is_refused():
    assert "tetrahedron 1 has a repeated corner: [1, 2, 2, 4]" in refusal(TWO_POINTS, [TWO[0], (1, 2, 2, 4)])


def test_an_inverted_tetrahedron_is_refused():
    message = refusal(TWO_POINTS, [TWO[0], (2, 1, 3, 4)])
    assert "tetrahedron 1" in message and "negative volume -0.333" in message and "swap two" in message


@pytest.mark.parametrize("height", [0.0, 1e-15, -1e-15])
@pytest.mark.parametrize("size", [1e-60, 1.0, 1e60])
def test_a_flat_tetrahedron_is_refused_at_any_scale(height, size):
    points = size * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.3, height)])
    assert "tetrahedron 0 (corners [0, 1, 2, 3]) is flat" in refusal(points, [(0, 1, 2, 3)])


def test_a_thin_but_sound_tetrahedron_is_accepted():
    points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.3, 0.3, 1e-6)])
    assert Mesh(points, [(0, 1, 2, 3)]).volumes == pytest.approx([1e-6 / 6])


def test_points_too_large_for_their_volume_are_refused():
    assert "tetrahedron 0" in refusal(1e200 * CORNERS, [(0, 1, 2, 3)])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_points_that_are_not_finite_are_refused(value):
    points = TWO_POINTS.copy()
    points[3, 1] = value
    assert "point 3 is not finite" in refusal(points, TWO)


@pytest.mark.parametrize("culprit", [-1, 5, 2**40])
def test_an_id_out_of_range_is_refused(culprit):
    message = refusal(TWO_POINTS, [TWO[0], (1, 2, 3, culprit)])
    assert f"tetrahedron 1 has corners [1, 2, 3, {culprit}]" in message and "0 to 4" in message


def test_an_unused_point_is_refused():
    message = refusal(np.array([*CORNERS[:2], (9, 9, 9), *CORNERS[2:]]), [(0, 1, 3, 4)])
    assert "point 2 is a corner of no tetrahedron (1 such points)" in message and "read_mesh" in message


@pytest.mark.parametrize("tetrahedra", [[], np.zeros((0, 4), dtype=int)])
def test_a_mesh_without_tetrahedra_is_refused(tetrahedra):
    assert "no tetrahedra" in refusal(CORNERS, tetrahedra)


@pytest.mark.parametrize(
    ("points", "tetrahedra", "reason"),
    [
        (CORNERS[:, :2], [(0, 1, 2, 3)], "points have shape (4, 2)"),
        (CORNERS.ravel(), [(0, 1, 2, 3)], "points have shape (12,)"),
        (CORNERS.astype(complex), [(0, 1, 2, 3)], "points have dtype complex128"),
        ([[0, 0], [1]], [(0, 1, 2, 3)], "points are not an array"),
        ("points", [(0, 1, 2, 3)], "points have dtype"),
        (CORNERS, [(0, 1, 2)], "tetrahedra have shape (1, 3)"),
        (CORNERS, (0, 1, 2, 3), "tetrahedra have shape (4,)"),
        (CORNERS, [(0.0, 1.0, 2.0, 3.0)], "tetrahedra have dtype float64"),
        (CORNERS, [(True, True, True, False)], "tetrahedra have dtype bool"),
        (CORNERS, [(0, 1, 2, 3), (0, 1)], "tetrahedra are not an array"),
    ],
)
def test_arrays_of_another_shape_or_type_are_refused(points, tetrahedra, reason):
    assert reason in refusal(points, tetrahedra)


@pytest.mark.parametrize(
    ("regions", "reason"),
    [
        ({"cell_regions": {"lump": [True]}}, "cell_regions['lump'] has dtype bool and shape (1,)"),
        ({"cell_regions": {"lump": [0, 1]}}, "dtype int64"),
        ({"cell_regions": {"": [True, False]}}, "the name ''"),
        ({"cell_regions": [True, False]}, "cell_regions is a list"),
        ({"point_regions": {"tip": [True, False]}}, "one entry for each of the points"),
    ],
)
def test_regions_that_do_not_fit_are_refused(regions, reason):
    assert reason in refusal(TWO_POINTS, TWO, **regions)


def test_points_that_faces_do_not_hold_together_are_reported():
    """Two tetrahedra share point 3, two others share the edge 7-8, whose ends become two nodes each."""
    points = [*CORNERS, (0, 0, 2), (1, 0, 2), (0, 1, 2), (5, 0, 0), (5, 0, 1), (6, 0, 0), (6, 1, 0), (4, 0, 0), (4, -1, 0)]
    tetrahedra = [(0, 1, 2, 3), (3, 4, 5, 6), (7, 9, 10, 8), (7, 11, 12, 8)]
    pinched = pinched_points(Mesh(np.array(points, dtype=float), tetrahedra))
    assert pinched.points.tolist() == [3, 7, 8]
    assert pinched.n_nodes.tolist() == [2, 2, 2]


def test_a_whole_box_has_no_pinched_points():
    pinched = pinched_points(meshes.box((3, 2, 2)))
    assert len(pinched.points) == len(pinched.n_nodes) == 0


def test_pinched_points_agree_with_walking_each_star():
    """A box with half of its tetrahedra gone: count the face-connected parts of each star by flooding it."""
    whole = meshes.box((3, 3, 3))
    kept = whole.tetrahedra[np.random.default_rng(4).random(whole.n_tetrahedra) < 0.5]
    used, tetrahedra = np.unique(kept, return_inverse=True)
    mesh = Mesh(whole.points[used], tetrahedra.reshape(-1, 4))
    expected = {point: parts for point in range(mesh.n_points) if (parts := count_parts(mesh, point)) > 1}
    pinched = pinched_points(mesh)
    assert len(expected) > 5
    assert dict(zip(pinched.points.tolist(), pinched.n_nodes.tolist(), strict=True)) == expected


def count_parts(mesh, point):
    """Return the number of parts of a point's star that share faces at the point, by flooding."""
    left = [set(row) for row in mesh.tetrahedra.tolist() if point in row]
    n_parts = 0
    while left:
        n_parts += 1
        front = [left.pop()]
        while front:
            corners = front.pop()
            front += (beside := [other for other in left if len(corners & other) == 3])
            left = [other for other in left if other not in beside]
    return n_parts


def test_a_mesh_of_200_000_tetrahedra_is_checked_within_a_second():
    """About 0.3 s of processor time; the rest is for slow machines."""
    mesh = meshes.box((32, 32, 33))
    assert mesh.n_tetrahedra > 200_000
    start = time.process_time()
    Mesh(mesh.points, mesh.tetrahedra)
    assert time.process_time() - start < 1.0
