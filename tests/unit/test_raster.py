"""Triangles on the sample grid: which samples they cover, which is in front, through which camera, under which light."""

import numpy as np
import pytest

from gmapspring import Material, Simulation, meshes, render
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.raster import rasterise
from gmapspring.rendering.shading import corner_normals

SIZE = (48, 32)
FRONT = Camera(distance=10.0, azimuth=-90.0, elevation=0.0)
"""Looks along +y from y = -10: x to the right, z up."""
OUTSIDE, INSIDE = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0)


def covered(corners, size=SIZE, is_closed=False):
    """Return where one triangle with corners x, y on the sample grid is drawn."""
    screen = np.column_stack([np.asarray(corners, dtype=float), np.ones(len(corners))])
    triangles = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    return rasterise(screen, triangles, size, is_closed)[1].copy()


def naive_cover(corners, size):
    """Return which sample centres lie strictly inside a triangle, by the signs of three areas."""
    columns, rows = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    (ax, ay), (bx, by), (cx, cy) = corners
    signs = np.stack([(qx - px) * (rows - py) - (qy - py) * (columns - px)
                      for px, py, qx, qy in ((ax, ay, bx, by), (bx, by, cx, cy), (cx, cy, ax, ay))])  # fmt: skip
    return (signs > 0).all(axis=0) | (signs < 0).all(axis=0)


def test_a_right_triangle_covers_exactly_the_samples_under_its_diagonal():
    # Legs of 4 samples from the corner: rows of 3, 2, 1; centres on the diagonal fall to no left or top edge.
    seen = covered([(0, 0), (4, 0), (0, 4)], (5, 5))
    expected = np.array([[0, 0, 0, -1, -1], [0, 0, -1, -1, -1], [0, -1, -1, -1, -1], [-1] * 5, [-1] * 5])
    np.testing.assert_array_equal(seen, expected)


def test_triangles_cover_the_samples_whose_centres_lie_inside():
    random = np.random.default_rng(0)
    for _ in range(40):
        # Corners on the grid of 1/256 that never meet a centre's row or column: no rule for edges is needed.
        corners = (random.integers(-8 * 128, 56 * 128, (3, 2)) * 2 + 1) / 256
        np.testing.assert_array_equal(covered(corners) >= 0, naive_cover(corners, SIZE))


def test_two_triangles_of_a_square_share_no_sample_and_leave_none():
    square = [(2, 2), (10, 2), (10, 10), (2, 2), (10, 10), (2, 10)]
    both = covered(square) >= 0
    first, second = covered(square[:3]) >= 0, covered(square[3:]) >= 0
    assert not (first & second).any()
    assert both.sum() == first.sum() + second.sum() == 8 * 8
    assert both[2:10, 2:10].all()


def test_a_triangle_larger_than_the_picture_covers_all_of_it():
    assert (covered([(-900, -900), (900, -900), (0, 1500)]) == 0).all()


def test_the_nearer_triangle_wins_in_either_order():
    screen = np.array([(0, 0, 1.0), (40, 0, 1.0), (0, 40, 1.0), (0, 0, 2.0), (40, 0, 2.0), (0, 40, 2.0)])
    for triangles, nearer in (([[0, 1, 2], [3, 4, 5]], 1), ([[3, 4, 5], [0, 1, 2]], 0)):
        nearness, owner = rasterise(screen, np.array(triangles, dtype=np.int32), SIZE)
        assert set(np.unique(owner)) == {-1, nearer}
        assert set(np.unique(nearness)) == {0.0, 2.0}


def test_crossing_triangles_hide_each_other_where_they_cross():
    # The first grows nearer to the right (1/depth = 1 + x / 20), the second keeps 2: they meet at x = 20.
    screen = np.array([(0, -99, 1.0), (40, -99, 3.0), (20, 999, 2.0), (0, -99, 2.0), (40, -99, 2.0), (20, 999, 2.0)])
    _, owner = rasterise(screen, np.arange(6, dtype=np.int32).reshape(2, 3), (40, 20))
    assert (owner[2, 5:19] == 1).all()
    assert (owner[2, 21:35] == 0).all()


def test_a_closed_surface_shows_only_triangles_that_face_the_eye():
    outward = [(2, 10), (10, 10), (2, 2)]  # counter-clockwise, with y down
    assert (covered(outward, is_closed=True) >= 0).any()
    assert not (covered(outward[::-1], is_closed=True) >= 0).any()
    np.testing.assert_array_equal(covered(outward), covered(outward[::-1]))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300])
def test_triangles_with_corners_that_are_not_finite_are_left_out(bad):
    points = np.array([(-1, 0, -1), (1, 0, -1), (0, 0, 1), (bad, 0, 0)])
    kept = render.render_surface(points, [[0, 1, 2]], [OUTSIDE], None, FRONT, SIZE)
    both = render.render_surface(points, [[0, 1, 2], [0, 1, 3]], [OUTSIDE, INSIDE], None, FRONT, SIZE)
    np.testing.assert_array_equal(both, kept)


def test_triangles_behind_the_eye_are_left_out():
    points = [(-1, -20, -1), (1, -20, -1), (0, -20, 1)]
    picture = render.render_surface(points, [[0, 1, 2]], [OUTSIDE], None, FRONT, SIZE)
    np.testing.assert_array_equal(picture, render.render_surface(np.zeros((0, 3)), [], np.zeros((0, 3)), size=SIZE))


def test_colours_may_be_out_of_range_or_not_finite():
    points, triangle = [(-1, 0, -1), (1, 0, -1), (0, 0, 1)], [[0, 1, 2]]
    wild = render.render_surface(points, triangle, [(np.nan, 7.0, -1.0)], None, FRONT, SIZE)
    tame = render.render_surface(points, triangle, [(0.0, 1.0, 0.0)], None, FRONT, SIZE)
    np.testing.assert_array_equal(wild, tame)


def test_triangles_that_name_no_point_are_refused():
    with pytest.raises(ValueError, match="points 0 to 3 of 3"):
        render.render_surface(np.zeros((3, 3)), [[0, 1, 3]], [OUTSIDE])


def test_a_point_lands_where_similar_triangles_say():
    # One metre beside the axis at 10 m: focal / 10 pixels from the middle, focal = 16 / tan(14 degrees).
    x, y, near = FRONT.project([(1.0, 0.0, 2.0)], SIZE)[0]
    focal = 16 / np.tan(np.radians(14))
    np.testing.assert_allclose((x, y, near), (24 + focal / 10, 16 - focal / 5, 0.1), rtol=1e-12)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 3.0])
@pytest.mark.parametrize("azimuth", [0.0, 100.0])
def test_a_fitted_camera_sees_every_point_and_touches_the_margin(aspect, azimuth):
    points = np.random.default_rng(1).normal(size=(50, 3)) * (3.0, 1.0, 0.3) + 5.0
    size = (int(400 * aspect), 400)
    x, y, near = Camera.fit(points, azimuth, 30.0, aspect=aspect, margin=1.0).project(points, size).T
    assert (near > 0).all()
    reach = np.maximum(np.abs(2 * x / size[0] - 1), np.abs(2 * y / size[1] - 1)).max()
    assert reach == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("distance", [0.0, -1.0, np.nan])
def test_a_camera_without_distance_is_refused(distance):
    with pytest.raises(ValueError, match="distance"):
        Camera(distance=distance)


def test_a_camera_without_field_of_view_is_refused():
    with pytest.raises(ValueError, match="field_of_view"):
        Camera(field_of_view=0.0)


def test_normals_are_smooth_on_a_ball_and_sharp_on_a_box():
    ball, box = (Simulation(mesh, Material(1e3, 1e3)).body for mesh in (meshes.ball(3), meshes.box((2, 2, 2))))
    surface = render.body_surface(ball)
    radial = surface.points[surface.triangles]
    radial = radial / np.linalg.norm(radial, axis=2, keepdims=True)
    assert (surface.normals * radial).sum(axis=2).min() > 0.98
    normals = render.body_surface(box).normals
    np.testing.assert_allclose(np.abs(normals).max(axis=2), 1.0, atol=1e-12)


def test_normals_of_triangles_without_area_are_finite():
    normals = corner_normals(np.zeros((3, 3)), np.array([[0, 1, 2]], dtype=np.int32), np.ones(1, np.bool_))
    np.testing.assert_array_equal(normals[0], [(0, 0, 1)] * 3)


@pytest.mark.parametrize(
    ("colors", "normals", "message"),
    [
        (np.zeros((1, 3)), None, r"colors must be \(2, 3\), one for each triangle, or \(2, 3, 3\), one a corner, not \(1, 3\)"),
        (np.zeros((2, 2)), None, "colors must be"),
        (np.zeros((2, 3, 2)), None, "colors must be"),
        (np.zeros((2, 3)), np.zeros((1, 3, 3)), r"normals must be \(2, 3, 3\)"),
    ],
)
def test_colors_and_normals_of_another_shape_are_refused(colors, normals, message):
    points = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1.0, 0.0)])
    with pytest.raises(ValueError, match=message):
        render.render_surface(points, [[0, 1, 2], [1, 3, 2]], colors, normals, FRONT, SIZE)
