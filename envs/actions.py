"""Which actions are legal: what may be cut of the body as it stands, in modes of which one leaves out more than another."""

from collections.abc import Callable
from typing import Any

import numpy as np

from envs.arrays import LAST_CUT, read_task
from gmapspring.jit import kernel, part

FACE_EDGES = np.array([(3, 4, 5), (1, 2, 5), (0, 2, 4), (0, 1, 3)], dtype=np.int32)
"""Edges of the face opposite each corner; a tetrahedron's edges are 01 02 03 12 13 23."""


@kernel
def mask_all(table, rows, real):
    """Allow every sewn face of an attached tetrahedron, and every attached tetrahedron that is not an anchor."""
    for row in rows:
        task = read_task(table, row, real)
        allow_all(task)
        keep_in_reach(task)


@kernel
def mask_reachable(table, rows, real):
    """Allow what a blade gets at: a face with an edge on the surface, a tetrahedron with a free face."""
    for row in rows:
        task = read_task(table, row, real)
        allow_all(task)
        keep_reachable(task)
        keep_in_reach(task)


@kernel
def mask_focus(table, rows, real):
    """Allow only one ring around the interface between target and healthy tissue."""
    for row in rows:
        task = read_task(table, row, real)
        allow_all(task)
        keep_near(task)
        keep_in_reach(task)


@part
def allow_all(task):
    """Set the mask of mode all."""
    mask, is_attached, is_anchor = task.play.mask, task.play.is_attached, task.rules.is_anchor
    image, face_slots = task.body.gmap.image, task.rules.face_slots
    n_faces = len(face_slots)
    for face in range(n_faces):
        mask[face] = is_sewn(image, is_attached, face_slots[face, 0])
    for tet in range(len(is_attached)):
        mask[n_faces + tet] = is_attached[tet] and not is_anchor[tet]


@part
def is_sewn(image, is_attached, slot):
    """Tell whether a face, 4 * tetrahedron + face, can be cut."""
    tet = np.uint64(slot) >> np.uint64(2)
    return is_attached[tet] and image[tet, np.uint64(slot) & np.uint64(3)] != 6 * slot


@part
def keep_reachable(task):
    """Leave out what a blade does not get at."""
    mask, is_attached, is_surface_edge = task.play.mask, task.play.is_attached, task.play.is_surface_edge
    gmap, face_slots = task.body.gmap, task.rules.face_slots
    image, edge_of, n_faces = gmap.image, gmap.edge_of, len(face_slots)
    for edge in range(len(is_surface_edge)):
        is_surface_edge[edge] = False
    for tet in range(len(is_attached)):
        is_open = False
        if is_attached[tet]:
            for face in range(4):
                if image[tet, face] == 24 * tet + 6 * face:
                    is_open = True
                    for side in range(3):
                        is_surface_edge[edge_of[tet, FACE_EDGES[face, side]]] = True
        if not is_open:
            mask[n_faces + tet] = 0
    for face in range(n_faces):
        if mask[face]:
            slot = np.uint64(face_slots[face, 0])
            tet_of, local = slot >> np.uint64(2), slot & np.uint64(3)
            is_open = False
            for side in range(3):
                is_open = is_open or is_surface_edge[edge_of[tet_of, FACE_EDGES[local, side]]]
            if not is_open:
                mask[face] = 0


@part
def keep_near(task):
    """Leave out what does not touch the interface."""
    mask, is_near, face_slots = task.play.mask, task.rules.is_near, task.rules.face_slots
    n_faces = len(face_slots)
    for face in range(n_faces):
        for side in range(2):
            if not is_near[np.uint64(face_slots[face, side]) >> np.uint64(2)]:
                mask[face] = 0
    for tet in range(len(is_near)):
        if not is_near[tet]:
            mask[n_faces + tet] = 0


@part
def keep_in_reach(task):
    """Leave out what the tool does not reach from its last cut; where that would leave nothing, it is set down anew anywhere."""
    mask, last, reach = task.play.mask, task.play.whole[LAST_CUT], task.rules.reach[0]
    if last < 0 or reach == np.inf:
        return
    centroid, n_reached = task.rules.centroid, 0
    for action in range(len(mask)):
        if mask[action] and is_in_reach(centroid, reach, last, action):
            n_reached += 1
    if n_reached > 0:
        for action in range(len(mask)):
            if mask[action] and not is_in_reach(centroid, reach, last, action):
                mask[action] = 0


@part
def is_in_reach(centroid, reach, last, action):
    """Tell whether one cut lies near enough to another."""
    square = 0.0
    for axis in range(3):
        square += (centroid[action, axis] - centroid[last, axis]) ** 2
    return square <= reach * reach


MASKS: dict[str, Callable[[np.ndarray, np.ndarray, Any], None]] = {
    "all": mask_all, "reachable": mask_reachable, "focus": mask_focus,
}  # fmt: skip
"""Mask modes by name: (table, rows, real) -> sets Play.mask of rows of a table; see arrays.py.

While the target is attached none of them is empty: a chain of sewn faces leads from it to an anchor, so it crosses the
interface (focus), and a body of two tetrahedra or more has one with a free face, whose other faces have an edge on the
surface (reachable). A tool narrows each of them, but never to nothing."""
