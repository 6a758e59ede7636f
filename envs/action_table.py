"""The table of actions: one per interior face and one per tetrahedron of the uncut mesh, numbered once and for all."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]


class ActionTable(NamedTuple):
    """Geometry of all actions at rest: action a < n_faces cuts face a, the others remove tetrahedron a - n_faces."""

    face_slots: Array
    """Both sides of each interior face as 4 * tetrahedron + face, the lower one first, ascending, int32 (n_faces, 2)."""

    face_of_slot: Array
    """Interior face of each tetrahedron's faces, -1 on the surface of the uncut mesh, int32 (n_tetrahedra, 4)."""

    face_corners: Array
    """The face's corners in either tetrahedron, the same three points in the same order, int32 (n_faces, 2, 3)."""

    face_area: Array
    """Rest area [m^2], shape (n_faces,)."""

    face_centroid: Array
    """Rest centroid [m], shape (n_faces, 3)."""

    volume: Array
    """Rest volume of each tetrahedron [m^3], shape (n_tetrahedra,)."""

    @property
    def n_faces(self) -> int:
        """Return the number of interior faces."""
        return len(self.face_slots)

    @property
    def n_tetrahedra(self) -> int:
        """Return the number of tetrahedra."""
        return len(self.volume)

    @property
    def n_actions(self) -> int:
        """Return the number of actions."""
        return len(self.face_slots) + len(self.volume)

    @property
    def face_tetrahedra(self) -> Array:
        """Return the two tetrahedra of each interior face, int32 (n_faces, 2)."""
        sides: Array = self.face_slots // 4
        return sides


@lru_cache(maxsize=16)
def action_table(mesh: Mesh) -> ActionTable:
    """Number the actions of a mesh, faces ascending by their lower slot, then tetrahedra in the mesh's order; read-only."""
    slots = np.sort(np.column_stack(paired_faces(mesh.tetrahedra, mesh.n_points)), axis=1)
    slots = slots[np.argsort(slots[:, 0])]
    face_of_slot = np.full(4 * mesh.n_tetrahedra, -1, dtype=np.int32)
    face_of_slot[slots] = np.arange(len(slots))[:, None]
    local = np.sort(OUTWARD_FACE_CORNERS[slots % 4], axis=2)
    ids = mesh.tetrahedra[(slots // 4)[:, :, None], local]
    corners = np.take_along_axis(local, np.argsort(ids, axis=2), axis=2)
    points = mesh.points[np.sort(ids, axis=2)[:, 0]]
    spans = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    found = ActionTable(
        face_slots=slots.astype(np.int32),
        face_of_slot=face_of_slot.reshape(-1, 4),
        face_corners=corners.astype(np.int32),
        face_area=0.5 * np.linalg.norm(spans, axis=1),
        face_centroid=points.mean(axis=1),
        volume=np.array(mesh.volumes),
    )
    for array in found:
        array.flags.writeable = False
    return found


def beside(table: ActionTable, members: Array) -> Array:
    """Return the tetrahedra that are members or have one across a face, bool (n_tetrahedra,)."""
    sides = table.face_tetrahedra
    found = members.copy()
    found[sides[members[sides].any(axis=1)]] = True
    return found


def touching_actions(table: ActionTable, vessel: Array) -> Array:
    """Return the actions that lay open a face of a vessel's tetrahedron, bool (n_actions,)."""
    return np.concatenate([vessel[table.face_tetrahedra].any(axis=1), beside(table, vessel)])


def face_pieces(table: ActionTable, members: Array) -> Array:
    """Return the face-connected piece that each member belongs to, 0, 1 ..., and -1 for others, int32 (n_tetrahedra,)."""
    one, other = table.face_tetrahedra[members[table.face_tetrahedra].all(axis=1)].T
    lowest, is_growing = np.arange(table.n_tetrahedra), True
    while is_growing:  # pieces are a few tetrahedra across: each sweep hands the lowest number on to all neighbours
        before, low = lowest.copy(), np.minimum(lowest[one], lowest[other])
        np.minimum.at(lowest, one, low)
        np.minimum.at(lowest, other, low)
        is_growing = not np.array_equal(lowest, before)
    piece_of = np.full(table.n_tetrahedra, -1, dtype=np.int32)
    piece_of[members] = np.unique(lowest[members], return_inverse=True)[1]
    return piece_of


class Surroundings(NamedTuple):
    """What the masks need to know about a scene."""

    is_anchor: Array
    """Tetrahedra with a pinned corner: they cannot be removed, bool (n_tetrahedra,)."""

    is_near: Array
    """Tetrahedra that touch the interface between target and healthy tissue, bool (n_tetrahedra,)."""


def surroundings(mesh: Mesh, table: ActionTable, target: Array, anchor: Array) -> Surroundings:
    """Return what the masks need; a tetrahedron is near if it has a point of a face between target and healthy."""
    sides = table.face_tetrahedra
    is_interface = target[sides[:, 0]] != target[sides[:, 1]]
    corners = table.face_corners[is_interface, 0]
    is_interface_point = np.zeros(mesh.n_points, dtype=bool)
    is_interface_point[mesh.tetrahedra[sides[is_interface, :1], corners]] = True
    return Surroundings(
        is_anchor=np.array(anchor, dtype=bool),
        is_near=np.asarray(is_interface_point[mesh.tetrahedra].any(axis=1)),
    )
