"""Picking: from a ray into the picture to the cut that is meant.

What is seen is a skin: the boundary of the tetrahedra that are shown, all of them or those that peeling has left. A face that
peeling lays bare is still sewn, and is cut by a click on it. On the body's own surface a click means the tetrahedron below;
of its faces, the legal one behind the nearest edge is cut.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from envs.action_table import ActionTable
from gmapspring.body import Body
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]

EDGE_CORNERS_OF_TRIANGLE = ((1, 2), (2, 0), (0, 1))
"""Places in a triangle of the edge opposite each of its corners."""


@dataclass(frozen=True, eq=False)
class Skin:
    """The boundary of what is shown."""

    slots: Array
    """Faces as 4 * tetrahedron + face, ascending, int64 (n_triangles,)."""
    triangles: Array
    """Nodes of each, counter-clockwise from outside, int (n_triangles, 3)."""
    is_bare: Array
    """Whether it is a free face of the body, and not one that peeling lays bare, bool (n_triangles,)."""


@dataclass(frozen=True)
class Hit:
    """Where a ray meets a skin."""

    slot: int
    """The face, 4 * tetrahedron + face."""
    corners: Array
    """Positions of its corners [m], (3, 3)."""
    point: Array
    """Where it is met [m], (3,)."""


def skin_of(body: Body, is_shown: Array) -> Skin:
    """Return the boundary of the tetrahedra that are shown, bool (n_tetrahedra,); removed ones do not count."""
    n_tets = body.mesh.n_tetrahedra
    slots = np.arange(4 * n_tets).reshape(-1, 4)
    image = np.asarray(body.gmap.image, dtype=np.int64)
    is_in = is_shown & body.is_alive
    is_bare = image == 6 * slots
    neighbour = np.where(is_in[:, None], image // 24, 0)
    is_boundary = is_in[:, None] & (is_bare | ~is_in[neighbour])
    found = slots[is_boundary]
    corners = OUTWARD_FACE_CORNERS[found % 4]
    return Skin(found, body.vertex_of[found[:, None] // 4, corners], is_bare[is_boundary])


def hit(origin: Array, direction: Array, skin: Skin, position: Array) -> Hit | None:
    """Return where a ray first meets a skin with nodes at a position [m], None where it misses (Möller and Trumbore, 1997)."""
    direction = np.asarray(direction, dtype=np.float64)
    corners = np.asarray(position, dtype=np.float64)[skin.triangles]
    one, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(direction, other)
    volume = np.sum(one * across, axis=1)
    # A triangle seen from its edge, or one without area, is not hit.
    is_seen = np.abs(volume) > 1e-12 * np.linalg.norm(one, axis=1) * np.linalg.norm(across, axis=1)
    scale = np.divide(1.0, volume, out=np.zeros_like(volume), where=is_seen)
    start = np.asarray(origin, dtype=np.float64) - corners[:, 0]
    turned = np.cross(start, one)
    u, v = np.sum(start * across, axis=1) * scale, turned @ direction * scale
    distance = np.sum(other * turned, axis=1) * scale
    is_hit = is_seen & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
    if not is_hit.any():
        return None
    nearest = int(np.where(is_hit, distance, np.inf).argmin())
    point = np.asarray(origin, dtype=np.float64) + distance[nearest] * direction
    return Hit(int(skin.slots[nearest]), corners[nearest], point)


def face_cut(table: ActionTable, legal: Array, met: Hit) -> int | None:
    """Return the action that cuts the face meant by a click, None where the tetrahedron there has no legal face."""
    tet, face = divmod(met.slot, 4)
    itself = int(table.face_of_slot[tet, face])
    if itself >= 0 and legal[itself]:
        return itself
    nearest, action = np.inf, None
    for place, corner in enumerate(OUTWARD_FACE_CORNERS[face].tolist()):
        # The face opposite a corner meets this one in the edge opposite that corner.
        candidate = int(table.face_of_slot[tet, corner])
        first, second = (met.corners[each] for each in EDGE_CORNERS_OF_TRIANGLE[place])
        distance = _distance(met.point, first, second)
        if candidate >= 0 and legal[candidate] and distance < nearest:
            nearest, action = distance, candidate
    return action


def removal(table: ActionTable, legal: Array, met: Hit) -> int | None:
    """Return the action that removes the tetrahedron that was clicked, None where that is not legal."""
    action = table.n_faces + met.slot // 4
    return action if legal[action] else None


def cuttable_edges(table: ActionTable, legal: Array, skin: Skin, *, is_removing: bool) -> Array:
    """Return the edges at which a click cuts something, as nodes (n, 2): behind them is a legal face, or a legal tetrahedron."""
    tets, faces = np.divmod(skin.slots, 4)
    edges = skin.triangles[:, EDGE_CORNERS_OF_TRIANGLE]
    if is_removing:
        return edges[legal[table.n_faces + tets]].reshape(-1, 2)
    behind = table.face_of_slot[tets[:, None], OUTWARD_FACE_CORNERS[faces]]
    itself = table.face_of_slot[tets, faces][:, None]
    is_legal = ((behind >= 0) & legal[behind]) | ((itself >= 0) & legal[itself])
    return edges[is_legal]


def action_corners(table: ActionTable, action: int, body: Body) -> Array:
    """Return the nodes of the triangles that show an action, counter-clockwise from one side, (n, 3)."""
    if action < table.n_faces:
        tet = int(table.face_slots[action, 0]) // 4
        return body.vertex_of[tet][table.face_corners[action, 0]][None]
    return body.vertex_of[action - table.n_faces][OUTWARD_FACE_CORNERS]


def _distance(point: Array, first: Array, second: Array) -> float:
    """Return how far a point is from a stretch of line [m]."""
    along = second - first
    square = float(along @ along)
    # Corners that lie on each other make a stretch of no length.
    share = np.clip((point - first) @ along / square, 0.0, 1.0) if square > 0.0 else 0.0
    return float(np.linalg.norm(point - first - share * along))
