"""Frames: a body, or any surface of triangles, drawn on the processor without a system library."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmapspring.body import Body
from gmapspring.rendering import heat, painting, raster, shading
from gmapspring.rendering.camera import Camera
from gmapspring.rendering.skin import Surface, body_surface, boundary, free_faces
from gmapspring.rendering.style import Style

__all__ = ["HEAT", "Sight", "Style", "Surface", "body_surface", "draw", "draw_with_depth", "free_faces", "pick_faces",
           "render_body", "render_surface", "see_faces", "see_triangles"]  # fmt: skip

SAMPLES = 2
"""Samples along each side of a pixel."""

OCCLUSION_REACH = 0.04
"""How far contact shadows reach, as a share of the camera's distance."""

HEAT = heat.STOPS
"""Colours of strain, evenly spaced from none to `Style.strain_limit`."""


@dataclass(frozen=True)
class Sight:
    """What is seen at the centre of each pixel."""

    face: NDArray[np.int32]
    """4 * tetrahedron + face, or -1 where there is nothing, shape (height, width)."""
    depth: NDArray[np.float32]
    """Distance from the eye along the direction in which it looks [m], infinite where there is nothing, (height, width)."""


def render_surface(
    points: ArrayLike,
    triangles: ArrayLike,
    colors: ArrayLike,
    normals: ArrayLike | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (480, 480),
) -> NDArray[np.uint8]:
    """Draw triangles and return the picture, uint8, shape (height, width, 3); size is (width, height) [pixels].

    points (n_points, 3) [m]; triangles (n_triangles, 3), whose both sides are drawn; colors (n_triangles, 3), or
    (n_triangles, 3, 3) for one a corner, from 0 to 1; normals (n_triangles, 3, 3), without which shading is flat.
    A triangle with a corner that is not finite, or behind the eye, is left out.
    """
    points = np.array(points, dtype=np.float64).reshape(-1, 3)
    triangles = np.array(triangles, dtype=np.int32).reshape(-1, 3)
    if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
        raise ValueError(f"triangles name points {triangles.min()} to {triangles.max()} of {len(points)}")
    if normals is None:
        normals = shading.corner_normals(points, triangles, np.zeros(len(triangles), np.bool_))
    colors, normals = np.asarray(colors, np.float64), np.asarray(normals, np.float64)
    n = len(triangles)
    if colors.shape not in ((n, 3), (n, 3, 3)):
        raise ValueError(f"colors must be ({n}, 3), one for each triangle, or ({n}, 3, 3), one a corner, not {colors.shape}")
    if normals.shape != (n, 3, 3):
        raise ValueError(f"normals must be ({n}, 3, 3), one for each corner of each triangle, not {normals.shape}")
    surface = Surface(points, triangles, colors, normals)
    return draw(surface, camera or Camera.fit(points, aspect=size[0] / size[1]), size)


def render_body(
    body: Body,
    *,
    highlight: NDArray[np.bool_] | None = None,
    strain: NDArray[Any] | None = None,
    camera: Camera | None = None,
    size: tuple[int, int] = (480, 480),
    style: Style | None = None,
) -> NDArray[np.uint8]:
    """Draw a body and return the picture, uint8, shape (height, width, 3); size is (width, height) [pixels].

    highlight (n_tets,) marks tetrahedra to be shown in the target's colours; strain (n_tets,) colours the whole body
    by a number per tetrahedron instead, from 0 to the style's limit, with a legend. Without a camera, one is fitted to the
    mesh at rest, so that the frames of a film share it. Pieces that hang on no pinned node are faded.
    """
    style = style or Style()
    surface = body_surface(body, highlight, strain, style)
    picture = draw(surface, camera or _camera_of(body, size), size, style)
    if strain is not None and style.legend:
        heat.stamp_legend(picture, style.strain_limit, style.legend)
    return picture


def pick_faces(body: Body, camera: Camera | None = None, size: tuple[int, int] = (480, 480)) -> NDArray[np.int32]:
    """Return the face seen at the centre of each pixel, 4 * tetrahedron + face or -1, shape (height, width)."""
    return see_faces(body, camera, size).face


def see_faces(body: Body, camera: Camera | None = None, size: tuple[int, int] = (480, 480)) -> Sight:
    """Return face and depth [m] at the centre of each pixel; size is (width, height) [pixels]."""
    slots, triangles = boundary(body)
    triangle, depth = see_triangles(body.nodes.position, triangles, camera or _camera_of(body, size), size)
    return Sight(np.append(slots, raster.BACKGROUND).astype(np.int32)[triangle], depth)


def see_triangles(
    points: ArrayLike, triangles: NDArray[np.int32], camera: Camera, size: tuple[int, int], is_closed: bool = True
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return triangle (-1 for none) and depth (infinite for none) [m] at the centre of each pixel, (height, width) each."""
    nearness, owner = raster.rasterise(camera.project(points, size), triangles, size, is_closed)
    depth = np.full(nearness.shape, np.inf, np.float32)
    return owner.copy(), np.divide(np.float32(1.0), nearness, out=depth, where=nearness > 0.0)


def draw(surface: Surface, camera: Camera, size: tuple[int, int], style: Style | None = None) -> NDArray[np.uint8]:
    """Draw a surface and return the picture, uint8, shape (height, width, 3); size is (width, height) [pixels]."""
    return _drawn(surface, camera, size, style or Style())[0]


def draw_with_depth(
    surface: Surface, camera: Camera, size: tuple[int, int], style: Style | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Draw a surface and return the picture and depths [m], (height, width): of each pixel's samples the nearest, or infinite."""
    picture, nearness, window = _drawn(surface, camera, size, style or Style())
    depth = np.full(picture.shape[:2], np.inf, np.float32)
    raster.find_depths(nearness, SAMPLES, window, depth)
    return picture, depth


def _drawn(
    surface: Surface, camera: Camera, size: tuple[int, int], style: Style
) -> tuple[NDArray[np.uint8], NDArray[np.float32], raster.Window]:
    """Return the picture of a surface, the window of it where there is something, and one over the depth of its samples."""
    screen = camera.project(surface.points, size)
    # Snapped as the z-buffer will: a triangle that it draws then has an area above zero here too.
    fine = SAMPLES * raster.SUBSAMPLES
    screen[:, :2] = np.floor(screen[:, :2] * fine + 0.5) / fine
    # Nothing is drawn outside the window, and from here on the picture begins at its corner.
    window = raster.find_window(screen, size, painting.SQUARE // SAMPLES)
    screen[:, :2] -= window.left, window.top
    nearness, owner = raster.rasterise(
        screen * (SAMPLES, SAMPLES, 1.0), surface.triangles, (SAMPLES * window.width, SAMPLES * window.height), surface.is_closed
    )
    colors = surface.colors if surface.colors.ndim == 3 else np.repeat(surface.colors[:, None], 3, axis=1)
    light = np.empty(colors.shape)
    shading.square_colors(np.ascontiguousarray(colors, np.float64).reshape(-1), light.reshape(-1))
    drawing = shading.Drawing(screen, surface.triangles, camera.turn(surface.normals), light)
    eye = (0.5 * size[0] - window.left, 0.5 * size[1] - window.top, 1.0 / camera.focal_length(size))
    look = shading.Look(float(style.gloss), float(style.wire), float(style.occlusion), eye)
    plan = np.empty((len(surface.triangles), shading.N_PLAN))
    shading.make_plan(drawing, look, surface.is_closed, plan)
    openness = np.ones([-(-n // painting.CELL) for n in owner.shape], np.float32)
    if style.occlusion > 0.0:
        painting.occlude(nearness, owner, drawing.normals.mean(axis=1), look, OCCLUSION_REACH * camera.distance, openness)
    picture = np.empty((size[1], size[0], 3), np.uint8)
    background = np.array(style.background, dtype=np.float64) ** 2
    painting.paint(plan, owner, openness, look, background, window, picture.reshape(size[1], 3 * size[0]))
    return picture, nearness, window


def _camera_of(body: Body, size: tuple[int, int]) -> Camera:
    """Return a camera that fits the mesh at rest."""
    return Camera.fit(body.mesh.points, aspect=size[0] / size[1])
