"""The skin of a body: what a frame shows of it, as triangles with colours and normals."""

from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from gmapspring.body import Body
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.rendering import shading
from gmapspring.rendering.heat import heat_colors
from gmapspring.rendering.style import Style
from gmapspring.topology import gmap as topology
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS


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


def free_faces(body: Body) -> NDArray[np.int64]:
    """Return the free faces of a body as slots 4 * tetrahedron + face, ascending, in the order of `body.surface()`."""
    return boundary(body)[0]


def body_surface(
    body: Body,
    highlight: NDArray[np.bool_] | None = None,
    strain: NDArray[Any] | None = None,
    style: Style | None = None,
) -> Surface:
    """Return the boundary of a body in the order of `free_faces`: smooth outside, flat on cut faces."""
    style = style or Style()
    slots, triangles = boundary(body)
    tetrahedra = slots // 4
    is_outside = outside(body.mesh)[slots]
    points = np.array(body.nodes.position, dtype=np.float64)
    if strain is None:
        colors = face_colors(is_outside, None if highlight is None else np.asarray(highlight, bool)[tetrahedra], style)
    else:
        colors = heat_colors(np.asarray(strain, dtype=np.float64)[tetrahedra] / style.strain_limit)
    colors = np.repeat(colors[:, None], 3, axis=1)
    colors[body.nodes.is_pinned[triangles] & is_outside[:, None]] = style.pinned
    is_loose = loose_tetrahedra(body)
    if is_loose.any():
        is_faded = is_loose[tetrahedra]
        colors[is_faded] = faded(colors[is_faded], style)
    return Surface(points, triangles, colors, shading.corner_normals(points, triangles, is_outside), True)


def face_colors(is_outside: NDArray[np.bool_], is_target: NDArray[np.bool_] | None, style: Style) -> NDArray[np.float64]:
    """Return the colours of faces (n, 3): of the original surface or raw, of the target or of other tissue."""
    palette = np.array([style.inside, style.outside, style.target_inside, style.target])
    kind = is_outside.astype(np.int64) if is_target is None else is_outside + 2 * is_target
    return palette[kind]


def loose_tetrahedra(body: Body) -> NDArray[np.bool_]:
    """Return which tetrahedra hang on no pinned node, (n_tets,); none in a body without pinned nodes, which floats as a whole."""
    label_of = body.gmap.component_of
    is_loose = np.zeros(len(label_of), dtype=np.bool_)
    # One label means one piece: most frames are told here.
    if body.gmap.counts[topology.N_LABELS] > 1 and body.nodes.is_pinned.any():
        is_alive = label_of >= 0
        is_anchor = is_alive & body.nodes.is_pinned[body.vertex_of].any(axis=1)
        is_loose[is_alive] = ~np.isin(label_of[is_alive], label_of[is_anchor])
    return is_loose


def faded(colors: NDArray[np.float64], style: Style, share: float | None = None) -> NDArray[np.float64]:
    """Return colours (..., 3) washed out towards the background, by the style's share unless another is given."""
    share = style.fade if share is None else share
    return (1.0 - share) * colors + share * np.mean(style.background, axis=0)


def boundary(body: Body) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return free faces as slots, ascending, and their nodes, counter-clockwise from outside, (n, 3)."""
    faces = topology.boundary_faces(body.gmap)
    return faces @ np.array([4, 1]), body.vertex_of[faces[:, :1], OUTWARD_FACE_CORNERS[faces[:, 1]]]


_OUTSIDE: WeakKeyDictionary[Mesh, NDArray[np.bool_]] = WeakKeyDictionary()


def outside(mesh: Mesh) -> NDArray[np.bool_]:
    """Return which slots 4 * tetrahedron + face lie on the surface of an uncut mesh, found once per mesh."""
    if mesh not in _OUTSIDE:
        is_outside = np.ones(4 * mesh.n_tetrahedra, dtype=np.bool_)
        is_outside[np.concatenate(paired_faces(mesh.tetrahedra, mesh.n_points))] = False
        _OUTSIDE[mesh] = is_outside
    return _OUTSIDE[mesh]
