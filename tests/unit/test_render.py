"""Frames of bodies: what is seen and picked, what a cut looks like, and the same bytes every time."""

import numpy as np
import pytest

from gmapspring import Material, Simulation, meshes, render
from gmapspring.rendering import raster
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.heat import ticks
from gmapspring.rendering.pieces import moment_of, piece_surface
from gmapspring.rendering.shading import corner_normals

SIZE = (48, 32)
FRONT = Camera(distance=10.0, azimuth=-90.0, elevation=0.0)
"""Looks along +y from y = -10: x to the right, z up."""
PLAIN = render.Style(gloss=0.0, wire=0.0, occlusion=0.0)
OUTSIDE, INSIDE, TARGET = (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
LOUD = render.Style(outside=OUTSIDE, inside=INSIDE, target=TARGET, gloss=0.0, wire=0.0, background=((1.0,) * 3,) * 2)
"""Every part in a pure colour, so that a channel tells what is seen."""


def simulation(shape=(2, 1, 1), **named):
    """Return a box of unit cubes."""
    return Simulation(meshes.box(shape), Material(young_modulus=1e3, density=1e3), **named)


def opened():
    """Return two cubes, cut apart between them and pulled open."""
    simulated = simulation()
    mesh = simulated.body.mesh
    is_right = mesh.points[mesh.tetrahedra][:, :, 0].mean(axis=1) > 1.0
    pairs = sewn_pairs(simulated.body)
    for a, b in pairs[is_right[pairs[:, 0]] != is_right[pairs[:, 1]]]:
        simulated.split_face(a, b)
    body = simulated.body
    body.nodes.position[np.unique(body.vertex_of[is_right]), 0] += 1.0
    return body


def sewn_pairs(body):
    """Return the tetrahedra on both sides of each sewn face."""
    here = np.arange(body.gmap.image.size).reshape(-1, 4)
    there = body.gmap.image // 6
    return np.stack([here // 4, there // 4], axis=-1)[here < there]


def test_picking_names_the_face_in_front():
    mesh = meshes.single()
    body = Simulation(mesh, Material(1e3, 1e3)).body
    for face in range(4):
        outward = -mesh.points[face]  # away from the opposite corner, for the centre is the origin
        azimuth = np.degrees(np.arctan2(outward[1], outward[0]))
        elevation = np.degrees(np.arcsin(outward[2] / np.linalg.norm(outward)))
        picked = render.pick_faces(body, Camera(distance=5.0, azimuth=azimuth, elevation=elevation), SIZE)
        assert picked.shape == (32, 48)
        assert picked[16, 24] == face  # 4 * 0 + face
        assert set(np.unique(picked)) == {-1, face}


def test_picked_faces_are_free_and_seen_where_the_picture_is_drawn():
    body = simulation((2, 2, 2)).body
    picked = render.pick_faces(body, size=SIZE)
    seen = np.unique(picked[picked >= 0])
    assert np.isin(seen, render.free_faces(body)).all()
    background = render.render_surface(np.zeros((0, 3)), [], np.zeros((0, 3)), size=SIZE)
    is_drawn = (render.render_body(body, size=SIZE) != background).any(axis=2)
    assert is_drawn[picked >= 0].all()


def test_a_picture_is_height_by_width_by_three_bytes():
    picture = render.render_body(simulation().body, size=SIZE)
    assert picture.shape == (32, 48, 3)
    assert picture.dtype == np.uint8


def test_a_picture_is_the_same_bytes_every_time():
    first, second = (render.render_body(opened(), size=SIZE) for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_an_odd_size_can_be_drawn():
    for size in ((1, 1), (2, 3), (7, 5)):
        assert render.render_body(simulation().body, size=size).shape == (size[1], size[0], 3)


@pytest.mark.parametrize("size", [(48, 32), (97, 61), (7, 5), (1, 1)])
def test_drawing_only_where_the_body_is_changes_no_pixel(size, monkeypatch):
    body = opened()
    surface = render.body_surface(body)
    fitted = Camera.fit(body.nodes.position, aspect=size[0] / size[1])
    aside = tuple(np.array(fitted.target) + (2.0, 0.5, 0.3))
    views = [fitted, Camera(fitted.target, 4.0 * fitted.distance), Camera(aside, fitted.distance), Camera(fitted.target, 1.5),
             Camera((1e3, 0.0, 0.0), 1.0)]  # fmt: skip
    drawn = [render.draw_with_depth(surface, view, size) for view in views]
    windows = [raster.find_window(view.project(body.nodes.position, size), size, 4) for view in views]
    assert all(0 <= window.left < window.right <= size[0] and 0 <= window.top < window.bottom <= size[1] for window in windows)
    assert size != SIZE or windows[1].width * windows[1].height < 0.5 * size[0] * size[1]
    monkeypatch.setattr(raster, "find_window", lambda screen, size, grid: raster.Window(0, 0, *size))
    for view, (picture, depth) in zip(views, drawn, strict=True):
        whole, whole_depth = render.draw_with_depth(surface, view, size)
        np.testing.assert_array_equal(picture, whole)
        np.testing.assert_array_equal(depth, whole_depth)


def test_an_empty_body_gives_the_background():
    simulated = Simulation(meshes.single(), Material(1e3, 1e3))
    simulated.remove_tetrahedron(0)
    picture = render.render_body(simulated.body, size=SIZE)
    top, bottom = render.Style().background
    assert (picture == picture[:, :1]).all()
    np.testing.assert_allclose(picture[0, 0], np.array(top) * 255, atol=2)
    np.testing.assert_allclose(picture[-1, 0], np.array(bottom) * 255, atol=2)
    assert (render.pick_faces(simulated.body, size=SIZE) == -1).all()


def test_an_edge_half_over_a_pixel_is_half_as_strong():
    # A black wall left of x = 0, whose edge runs down the middle of a pixel of a picture 33 wide.
    points = [(-90, 0, -90), (0, 0, -90), (0, 0, 90), (-90, 0, 90)]
    camera = Camera(distance=10.0, azimuth=-90.0, elevation=0.0)
    picture = render.render_surface(points, [[0, 1, 2], [0, 2, 3]], np.zeros((2, 3)), None, camera, (33, 33))
    wall, edge, sky = picture[16, 15:18, 1].astype(float)
    assert (edge / 255) ** 2 == pytest.approx(((wall / 255) ** 2 + (sky / 255) ** 2) / 2, abs=0.01)


def test_an_uncut_body_shows_no_cut_colour():
    picture = render.render_body(simulation().body, size=SIZE, style=LOUD)
    is_drawn = picture[..., 1] < 128
    assert is_drawn.any()
    assert (picture[is_drawn, 0] == 0).sum() > 0.8 * is_drawn.sum()
    colors = render.body_surface(simulation().body, style=LOUD).colors
    np.testing.assert_array_equal(colors, np.broadcast_to(OUTSIDE, colors.shape))


def test_an_opened_cut_shows_its_faces_in_the_cut_colour():
    body = opened()
    camera = Camera.fit(body.nodes.position, azimuth=-30.0, aspect=1.5)
    picture = render.render_body(body, camera=camera, size=SIZE, style=LOUD).astype(int)
    is_cut = (picture[..., 0] > 60) & (picture[..., 1] == 0) & (picture[..., 2] == 0)
    picked = render.pick_faces(body, camera, SIZE)
    centres = body.nodes.position[body.vertex_of].mean(axis=1)
    # Seen from +x, the raw faces that show are those of the left cube.
    assert is_cut.sum() > 20
    assert (centres[picked[is_cut] // 4, 0] < 1.0).all()


def test_a_closed_cut_cannot_be_seen():
    simulated = simulation((2, 2, 2))
    before = render.render_body(simulated.body, size=SIZE, style=LOUD)
    for a, b in sewn_pairs(simulated.body):
        simulated.split_face(a, b)
    after = render.render_body(simulated.body, size=SIZE, style=LOUD)
    is_body = before[..., 1] < 128
    assert (after[is_body, 0] > 60).sum() < 0.02 * is_body.sum() + 1


def test_a_removed_tetrahedron_lays_raw_faces_open():
    simulated = simulation((2, 2, 2))
    simulated.remove_tetrahedron(0)
    colors = render.body_surface(simulated.body, style=LOUD).colors[:, 0]
    assert (colors == INSIDE).all(axis=1).sum() + (colors == OUTSIDE).all(axis=1).sum() == len(colors)
    neighbours_of_removed = 4 - (colors == INSIDE).all(axis=1).sum()
    assert 1 <= neighbours_of_removed <= 2  # faces that it had on the surface


def test_highlighted_tetrahedra_show_in_the_target_colour():
    body = simulation().body
    highlight = np.arange(12) < 6
    colors = render.body_surface(body, highlight, style=LOUD).colors[:, 0]
    expected = np.where((render.free_faces(body) // 4 < 6)[:, None], TARGET, OUTSIDE)
    np.testing.assert_array_equal(colors, expected)


def test_strain_runs_from_the_first_to_the_last_colour_of_the_heat_map():
    body = simulation().body
    for strain, color in ((0.0, render.HEAT[0]), (0.5, render.HEAT[-1]), (9.0, render.HEAT[-1]), (np.nan, render.HEAT[-1])):
        colors = render.body_surface(body, strain=np.full(12, strain)).colors
        np.testing.assert_allclose(colors, np.broadcast_to(color, colors.shape))


def test_pinned_nodes_are_darker():
    mesh = meshes.box((2, 1, 1))
    pinned = mesh.points[:, 0] == 0.0
    body = simulation(pinned=pinned).body
    surface = render.body_surface(body)
    is_pinned = pinned[body.nodes.point[surface.triangles]]
    assert (surface.colors[is_pinned] == render.Style().pinned).all()
    assert (surface.colors[~is_pinned] == render.Style().outside).all()


def test_contact_shadows_darken_a_groove_and_leave_a_plane_alone():
    groove = np.array([(-2, 0, -9), (0, 2, -9), (2, 0, -9), (-2, 0, 9), (0, 2, 9), (2, 0, 9)], dtype=float)
    triangles, colors = [[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], np.full((4, 3), 0.8)
    flat = groove * (1, 0, 1)
    for points, is_darker in ((groove, True), (flat, False)):
        normals = corner_normals(points, np.array(triangles, dtype=np.int32), np.zeros(4, np.bool_))
        surface = render.Surface(points, np.array(triangles, dtype=np.int32), colors, normals)
        lit = render.draw(surface, FRONT, (64, 64), PLAIN)
        shaded = render.draw(surface, FRONT, (64, 64), render.Style(gloss=0.0, wire=0.0, occlusion=1.0))
        assert (lit[32, 30:34].astype(int).mean() - shaded[32, 30:34].mean() > 10) == is_darker


def test_faces_and_depths_are_those_of_the_nearest_surface():
    # The front of a unit cube at y = 0, seen along +y from y = -10: all of it lies 10 m deep.
    body = simulation((1, 1, 1)).body
    seen = render.see_faces(body, FRONT, SIZE)
    is_seen = seen.face >= 0
    assert is_seen.any() and not is_seen.all()
    np.testing.assert_allclose(seen.depth[is_seen], 10.0, rtol=1e-6)
    assert np.isinf(seen.depth[~is_seen]).all()
    np.testing.assert_array_equal(seen.face, render.pick_faces(body, FRONT, SIZE))


def hung():
    """Return two cubes, one of them pinned, cut apart between them."""
    mesh = meshes.box((2, 1, 1))
    simulated = simulation(pinned=mesh.points[:, 0] == 0.0)
    is_right = mesh.points[mesh.tetrahedra][:, :, 0].mean(axis=1) > 1.0
    pairs = sewn_pairs(simulated.body)
    faces = pairs[is_right[pairs[:, 0]] != is_right[pairs[:, 1]]]
    return simulated, faces, is_right


def test_what_hangs_on_no_pinned_node_pales_into_the_background():
    simulated, faces, is_right = hung()
    for a, b in faces[:-1]:
        simulated.split_face(a, b)
    still_hung = render.body_surface(simulated.body)
    simulated.split_face(*faces[-1])
    freed, style = render.body_surface(simulated.body), render.Style()
    is_loose = is_right[render.free_faces(simulated.body) // 4]
    is_outside = (still_hung.colors[:, 0] == style.outside).all(axis=1)
    assert is_outside.any()
    paled = (1.0 - style.fade) * np.array(style.outside) + style.fade * np.mean(style.background, axis=0)
    raw = (1.0 - style.fade) * np.array(style.inside) + style.fade * np.mean(style.background, axis=0)
    found = np.unique(freed.colors[is_loose].reshape(-1, 3), axis=0)
    np.testing.assert_allclose(found, np.unique([paled, raw], axis=0))
    assert not np.isclose(freed.colors[~is_loose][:, :, None], found[None, None]).all(axis=-1).any()


def test_a_body_that_is_pinned_nowhere_keeps_its_colours_in_pieces():
    colors = render.body_surface(opened(), style=LOUD).colors
    assert {tuple(color) for color in colors.reshape(-1, 3)} == {OUTSIDE, INSIDE}


def test_a_gone_piece_is_drawn_where_it_was():
    simulated, faces, is_right = hung()
    before = moment_of(simulated.body)
    whole = render.body_surface(simulated.body)
    simulated.cut(tetrahedra=np.flatnonzero(is_right))
    simulated.body.nodes.position[:] += 5.0
    piece = piece_surface(before, is_right, np.zeros(12, bool), render.Style(), 0.0)
    # Its outside is what was there; towards the rest of the body it is raw.
    assert (piece.colors[:, 0] == render.Style().inside).all(axis=1).sum() == len(faces)
    assert (piece.colors[:, 0] == render.Style().outside).all(axis=1).sum() == 12 - len(faces)
    assert piece.points[:, 0].min() == 1.0 and piece.points.max() == whole.points.max() == 2.0


@pytest.mark.parametrize(
    ("limit", "expected"),
    [(0.5, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]), (1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]), (3e-4, [0.0, 1e-4, 2e-4, 3e-4]),
     (0.37, [0.0, 0.1, 0.2, 0.3])],
)  # fmt: skip
def test_a_legend_counts_in_round_numbers(limit, expected):
    np.testing.assert_allclose(ticks(limit), expected, rtol=1e-12)


def test_a_heat_map_has_a_legend_unless_it_is_told_to_have_none_or_is_small():
    body, strain = simulation().body, np.full(12, 0.2)
    bare = render.render_body(body, strain=strain, size=(200, 180), style=render.Style(legend=""))
    named = render.render_body(body, strain=strain, size=(200, 180))
    differs = (bare != named).any(axis=2)
    # A bar in the lower left, and nothing elsewhere.
    assert differs[90:, :60].any() and not differs[:60].any() and not differs[:, 100:].any()
    hottest = (np.abs(named.astype(float) - 255 * render.HEAT[-1]).max(axis=2) < 12).any()
    assert hottest and not (np.abs(bare.astype(float) - 255 * render.HEAT[-1]).max(axis=2) < 12).any()
    small = [render.render_body(body, strain=strain, size=SIZE, style=render.Style(legend=title)) for title in ("strain", "")]
    np.testing.assert_array_equal(*small)
    tissue = [render.render_body(body, size=(200, 180), style=render.Style(legend=title)) for title in ("strain", "")]
    np.testing.assert_array_equal(*tissue)
