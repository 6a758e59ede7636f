"""Pieces that are gone from a body, drawn as they hung when they came loose: pale, beside what still stands."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gmapspring.body import Body
from gmapspring.mesh import Mesh
from gmapspring.rendering import shading
from gmapspring.rendering.skin import Surface, face_colors, faded, outside
from gmapspring.rendering.style import Style
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS


@dataclass(frozen=True)
class Moment:
    """The shape of a body at one moment, as copies that later cuts leave alone."""

    mesh: Mesh
    """The uncut body."""
    is_alive: NDArray[np.bool_]
    """Tetrahedra that there were, (n_tets,)."""
    neighbour: NDArray[np.int64]
    """Tetrahedron beyond each face, the tetrahedron itself where the face was free, (n_tets, 4)."""
    corners: NDArray[np.float64]
    """Positions [m], (n_tets, 4, 3); those of removed tetrahedra mean nothing."""


def moment_of(body: Body) -> Moment:
    """Return the shape of a body as it is now."""
    corners = np.asarray(body.nodes.position[body.vertex_of], dtype=np.float64)
    return Moment(body.mesh, body.is_alive.copy(), body.gmap.image.astype(np.int64) // 24, corners)


def piece_surface(moment: Moment, is_piece: NDArray[np.bool_], highlight: NDArray[Any], style: Style, fade: float) -> Surface:
    """Return the surface of some tetrahedra (n_tets,) of a moment, faded from 0, not at all, to 1."""
    tetrahedra, faces = np.nonzero(is_piece[:, None] & (~is_piece[moment.neighbour] | _is_self(moment.neighbour)))
    is_outside = outside(moment.mesh)[4 * tetrahedra + faces]
    points = moment.corners[tetrahedra[:, None], OUTWARD_FACE_CORNERS[faces]].reshape(-1, 3)
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    colors = faded(face_colors(is_outside, highlight[tetrahedra], style), style, fade)
    # Each face has corners of its own here: pieces look cut from stone, which tells them from what stands.
    normals = shading.corner_normals(points, triangles, np.zeros(len(triangles), dtype=np.bool_))
    return Surface(points, triangles, np.repeat(colors[:, None], 3, axis=1), normals, True)


def joined(one: Surface, other: Surface) -> Surface:
    """Return two surfaces as one."""
    triangles = np.concatenate([one.triangles, other.triangles + np.int32(len(one.points))])
    points, colors, normals = (
        np.concatenate(pair) for pair in ((one.points, other.points), (one.colors, other.colors), (one.normals, other.normals))
    )
    return Surface(points, triangles, colors, normals, one.is_closed and other.is_closed)


def _is_self(neighbour: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which faces are free, (n_tets, 4)."""
    return neighbour == np.arange(len(neighbour))[:, None]
