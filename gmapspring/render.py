"""Frames: a body, or any surface of triangles, drawn on the processor without a system library."""

from dataclasses import dataclass
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gmapspring.body import Body
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.rendering import painting, raster, shading
from gmapspring.rendering.camera import Camera
from gmapspring.topology import gmap as topology

SAMPLES = 2
"""Samples along each side of a pixel."""

OCCLUSION_REACH = 0.04
"""How far contact shadows reach, as a share of the camera's distance."""

HEAT = np.array([[0.17, 0.25, 0.55], [0.20, 0.60, 0.70], [0.95, 0.88, 0.55], [0.93, 0.50, 0.25], [0.70, 0.08, 0.10]])
"""Colours of strain, evenly spaced from none to `Style.strain_limit`."""

Color = tuple[float, float, float]
"""Red, green, blue, each from 0 to 1."""


@dataclass(frozen=True)
class Style:
    """Colours and light of a frame."""

    outside: Color = (0.62, 0.21, 0.18)
    """The original surface."""
    inside: Color = (0.97, 0.58, 0.52)
    """Raw faces that a cut has laid open."""
    target: Color = (0.25, 0.66, 0.70)
    """Highlighted tetrahedra, on the original surface."""
    target_inside: Color = (0.58, 0.88, 0.88)
    """Highlighted tetrahedra, on raw faces."""
    pinned: Color = (0.22, 0.20, 0.26)
    """Surface at pinned nodes, fading out towards free ones."""
    background: tuple[Color, Color] = ((0.96, 0.97, 0.98), (0.84, 0.87, 0.90))
    """Behind the body, at the top and at the bottom."""
    strain_limit: float = 0.5
    """Strain at the end of the heat map, the limit of tearing in the shipped scenes."""
    gloss: float = 0.5
    """Strength of highlights: 0 is dull, 1 wet."""
    wire: float = 0.12
    """Darkness of the mesh lines: 0 draws none, 1 draws black."""
    occlusion: float = 1.0
    """Strength of contact shadows in clefts: 0 draws none and saves their time."""


class Surface(NamedTuple):
    """Triangles with a colour and a normal at each corner."""

    points: NDArray[np.float64]
    """Positions [m], shape (n_points, 3)."""
    triangles: NDArray[np.int32]
    """Points of each triangle, counter-clockwise seen from outside, shape (n_triangles, 3)."""
    colors: NDArray[np.float64]
    """Red, green, blue of each triangle (n_triangles, 3) or of each corner (n_triangles, 3, 3), from 0 to 1."""
    normals: NDArray[np.float64]
    """Unit normal of each corner, shape (n_triangles, 3, 3)."""
    is_closed: bool = False
    """Whether the triangles bound a solid, so that those that face away from the eye need no drawing."""


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
    surface = Surface(points, triangles, np.asarray(colors, np.float64), np.asarray(normals, np.float64))
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
    by a number per tetrahedron instead, from 0 to the style's limit. Without a camera, one is fitted to the mesh at
    rest, so that the frames of a film share it.
    """
    style = style or Style()
    surface = body_surface(body, highlight, strain, style)
    return draw(surface, camera or _camera_of(body, size), size, style)


def pick_faces(body: Body, camera: Camera | None = None, size: tuple[int, int] = (480, 480)) -> NDArray[np.int32]:
    """Return the face seen at the centre of each pixel, 4 * tetrahedron + face or -1, shape (height, width)."""
    slots = free_faces(body)
    screen = (camera or _camera_of(body, size)).project(body.nodes.position, size)
    _, owner = raster.rasterise(screen, body.surface(), size, is_closed=True)
    return np.append(slots, raster.BACKGROUND).astype(np.int32)[owner]


def draw(surface: Surface, camera: Camera, size: tuple[int, int], style: Style | None = None) -> NDArray[np.uint8]:
    """Draw a surface and return the picture, uint8, shape (height, width, 3); size is (width, height) [pixels]."""
    style = style or Style()
    width, height = size
    screen = camera.project(surface.points, size)
    # Snapped as the z-buffer will: a triangle that it draws then has an area above zero here too.
    fine = SAMPLES * raster.SUBSAMPLES
    screen[:, :2] = np.floor(screen[:, :2] * fine + 0.5) / fine
    nearness, owner = raster.rasterise(
        screen * (SAMPLES, SAMPLES, 1.0), surface.triangles, (SAMPLES * width, SAMPLES * height), surface.is_closed
    )
    colors = np.clip(np.nan_to_num(surface.colors), 0.0, 1.0) ** 2
    if colors.ndim == 2:
        colors = np.repeat(colors[:, None], 3, axis=1)
    drawing = shading.Drawing(screen, surface.triangles, camera.turn(surface.normals), colors)
    eye = (0.5 * width, 0.5 * height, 1.0 / camera.focal_length(size))
    look = shading.Look(float(style.gloss), float(style.wire), float(style.occlusion), eye)
    plan = np.empty((len(surface.triangles), shading.N_PLAN))
    shading.make_plan(drawing, look, surface.is_closed, plan)
    openness = np.ones([-(-n // painting.CELL) for n in owner.shape], np.float32)
    if style.occlusion > 0.0:
        reach, focal = OCCLUSION_REACH * camera.distance, SAMPLES / painting.CELL / eye[2]
        painting.occlude(nearness, owner, drawing.normals.mean(axis=1), focal, reach, openness)
    picture = np.empty((height, width, 3), np.uint8)
    background = np.array(style.background, dtype=np.float64) ** 2
    painting.paint(plan, owner, openness, look, background, picture.reshape(height, 3 * width))
    return picture


def free_faces(body: Body) -> NDArray[np.int64]:
    """Return the free faces of a body as slots 4 * tetrahedron + face, ascending, in the order of `body.surface()`."""
    return topology.boundary_faces(body.gmap) @ np.array([4, 1])


def body_surface(
    body: Body,
    highlight: NDArray[np.bool_] | None = None,
    strain: NDArray[Any] | None = None,
    style: Style | None = None,
) -> Surface:
    """Return the boundary of a body in the order of `free_faces`: smooth outside, flat on cut faces."""
    style = style or Style()
    slots = free_faces(body)
    tetrahedra = slots // 4
    is_outside = _outside(body.mesh)[slots]
    points = np.array(body.nodes.position, dtype=np.float64)
    triangles = body.surface()
    colors = np.where(is_outside[:, None], style.outside, style.inside)
    if highlight is not None:
        target = np.where(is_outside[:, None], style.target, style.target_inside)
        colors = np.where(np.asarray(highlight, dtype=bool)[tetrahedra, None], target, colors)
    if strain is not None:
        colors = _heat(np.asarray(strain, dtype=np.float64)[tetrahedra] / style.strain_limit)
    is_pinned = (body.nodes.is_pinned[triangles] & is_outside[:, None])[..., None]
    colors = np.where(is_pinned, style.pinned, colors[:, None])
    return Surface(points, triangles, colors, shading.corner_normals(points, triangles, is_outside), True)


def _heat(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the colour of each number between 0 and 1, shape (n, 3)."""
    stops = np.linspace(0.0, 1.0, len(HEAT))
    share = np.nan_to_num(share, nan=1.0)
    return np.stack([np.interp(share, stops, channel) for channel in HEAT.T], axis=1)


def _camera_of(body: Body, size: tuple[int, int]) -> Camera:
    """Return a camera that fits the mesh at rest."""
    return Camera.fit(body.mesh.points, aspect=size[0] / size[1])


_OUTSIDE: WeakKeyDictionary[Mesh, NDArray[np.bool_]] = WeakKeyDictionary()


def _outside(mesh: Mesh) -> NDArray[np.bool_]:
    """Return which slots 4 * tetrahedron + face lie on the surface of an uncut mesh, found once per mesh."""
    if mesh not in _OUTSIDE:
        is_outside = np.ones(4 * mesh.n_tetrahedra, dtype=np.bool_)
        is_outside[np.concatenate(paired_faces(mesh.tetrahedra, mesh.n_points))] = False
        _OUTSIDE[mesh] = is_outside
    return _OUTSIDE[mesh]
