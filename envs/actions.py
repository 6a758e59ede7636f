"""Actions of a resection: one per interior face and one per tetrahedron of the uncut mesh, numbered once and for all."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]

FACE_EDGES = np.array([(3, 4, 5), (1, 2, 5), (0, 2, 4), (0, 1, 3)], dtype=np.int32)
"""Edges of the face opposite each corner; a tetrahedron's edges are 01 02 03 12 13 23."""


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


def action_table(mesh: Mesh) -> ActionTable:
    """Number the actions of a mesh: faces ascending by their lower slot, then tetrahedra in the mesh's order."""
    slots = np.sort(np.column_stack(paired_faces(mesh.tetrahedra, mesh.n_points)), axis=1)
    slots = slots[np.argsort(slots[:, 0])]
    face_of_slot = np.full(4 * mesh.n_tetrahedra, -1, dtype=np.int32)
    face_of_slot[slots] = np.arange(len(slots))[:, None]
    local = np.sort(OUTWARD_FACE_CORNERS[slots % 4], axis=2)
    ids = mesh.tetrahedra[(slots // 4)[:, :, None], local]
    corners = np.take_along_axis(local, np.argsort(ids, axis=2), axis=2)
    points = mesh.points[np.sort(ids, axis=2)[:, 0]]
    spans = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    return ActionTable(
        face_slots=slots.astype(np.int32),
        face_of_slot=face_of_slot.reshape(-1, 4),
        face_corners=corners.astype(np.int32),
        face_area=0.5 * np.linalg.norm(spans, axis=1),
        face_centroid=points.mean(axis=1),
        volume=np.array(mesh.volumes),
    )


class Surroundings(NamedTuple):
    """What the masks need to know about a scene."""

    is_anchor: Array
    """Tetrahedra with a pinned corner: they cannot be removed, bool (n_tetrahedra,)."""

    is_near: Array
    """Tetrahedra that touch the interface between target and healthy tissue, bool (n_tetrahedra,)."""

    is_surface_edge: Array
    """Scratch: which springs lie on the surface, bool (6 * n_tetrahedra,)."""


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
        is_surface_edge=np.zeros(6 * mesh.n_tetrahedra, dtype=bool),
    )


@kernel
def mask_all(table, around, image, edge_of, is_attached, mask):
    """Allow every sewn face of an attached tetrahedron, and every attached tetrahedron that is not an anchor."""
    n_faces = table.face_slots.shape[0]
    for face in range(n_faces):
        slot = table.face_slots[face, 0]
        mask[face] = is_attached[slot // 4] and image[slot // 4, slot % 4] // 6 != slot
    for tet in range(is_attached.shape[0]):
        mask[n_faces + tet] = is_attached[tet] and not around.is_anchor[tet]


@kernel
def mask_reachable(table, around, image, edge_of, is_attached, mask):
    """Allow what a blade gets at: a face with an edge on the surface, a tetrahedron with a free face."""
    mask_all(table, around, image, edge_of, is_attached, mask)
    n_faces = table.face_slots.shape[0]
    around.is_surface_edge[:] = False
    for tet in range(is_attached.shape[0]):
        is_open = False
        if is_attached[tet]:
            for face in range(4):
                if image[tet, face] // 6 == 4 * tet + face:
                    is_open = True
                    for side in range(3):
                        around.is_surface_edge[edge_of[tet, FACE_EDGES[face, side]]] = True
        if not is_open:
            mask[n_faces + tet] = 0
    for face in range(n_faces):
        if mask[face]:
            tet, local = divmod(table.face_slots[face, 0], 4)
            is_open = False
            for side in range(3):
                is_open = is_open or around.is_surface_edge[edge_of[tet, FACE_EDGES[local, side]]]
            if not is_open:
                mask[face] = 0


@kernel
def mask_focus(table, around, image, edge_of, is_attached, mask):
    """Allow only one ring around the interface between target and healthy tissue."""
    mask_all(table, around, image, edge_of, is_attached, mask)
    n_faces = table.face_slots.shape[0]
    for face in range(n_faces):
        first, second = table.face_slots[face, 0] // 4, table.face_slots[face, 1] // 4
        if not (around.is_near[first] and around.is_near[second]):
            mask[face] = 0
    for tet in range(is_attached.shape[0]):
        if not around.is_near[tet]:
            mask[n_faces + tet] = 0


MaskKernel = Callable[[ActionTable, Surroundings, Array, Array, Array, Array], None]

MASKS: dict[str, MaskKernel] = {"all": mask_all, "reachable": mask_reachable, "focus": mask_focus}
"""Mask modes by name: (table, around, image, edge_of, is_attached, mask) -> fills mask, int8 (n_actions,).

While the target is attached none of them is empty: a chain of sewn faces leads from it to an anchor, so it crosses the
interface (focus), and a body of two tetrahedra or more has one with a free face, whose other faces have an edge on the
surface (reachable)."""
