"""Sewing and unsewing faces of the map, with the numbers of its cells kept true: 3-sew and 3-unsew, topology alone."""

from typing import NamedTuple

import numpy as np

from gmapspring.addresses import address_row
from gmapspring.errors import TopologyError
from gmapspring.jit import inlined_part, kernel, part
from gmapspring.topology.build import ANY, read_gmap
from gmapspring.topology.cells import (
    compact_cells,
    forget_removed,
    merge_cells,
    open_faces,
    recount_links,
    settle_cells,
    touched_edges,
    touched_vertices,
)
from gmapspring.topology.components import join_components, relabel_components
from gmapspring.topology.darts import CORNER_OF_DART, FACE_CORNERS, IS_EVEN
from gmapspring.topology.gmap import EDGE, VERTEX, GMap, check_sewable, link_faces
from gmapspring.topology.room import clear, empty_room, take, take_pairs
from gmapspring.topology.walks import fetch_around


class CellChanges(NamedTuple):
    """What happened to the vertices, or the edges; row numbers, in the order in which rows follow."""

    copied: np.ndarray
    """(kept, new) pieces of a cell that split, in numbers before the moves, (k, 2)."""
    moved: np.ndarray
    """(from, to) rows that fill those of dead cells, (k, 2)."""
    changed: np.ndarray
    """Cells whose tetrahedra may have changed, the new ones included, in final numbers, (k,)."""
    is_joined: np.ndarray
    """Which of these gained corners of others, 1 or 0, (k,)."""
    ends: np.ndarray
    """Where the members of each changed cell end; they begin where those of the one before end, (k,)."""
    members: np.ndarray
    """Codes (see walk_cell) of all members of changed cells, ascending in each, int64 (n,)."""
    n_dead: int
    """How many cells are gone."""
    final_copied: np.ndarray
    """(kept, new) in final numbers, (k, 2)."""
    final_moved: np.ndarray
    """(from, to) of cells that were there before, (k, 2)."""


class MapChange(NamedTuple):
    """What one operation did to the map."""

    vertices: CellChanges
    edges: CellChanges
    opened: np.ndarray
    """Slots 4*tetrahedron + face of live tetrahedra that became free, (k,)."""
    labels: np.ndarray
    """Labels of the components that came off, (k,)."""


def sew(gmap: GMap, dart: int, other: int) -> None:
    """Sew two free faces so that alpha_3 exchanges the two darts; raise TopologyError, with nothing changed, if it cannot be."""
    check_sewable(gmap, dart, other)
    if IS_EVEN[dart % 24] == IS_EVEN[other % 24]:
        raise TopologyError(f"cannot 3-sew darts {dart} and {other}: it would turn one tetrahedron inside out")
    sew_kernel(address_row(gmap)[None], 0, ANY, empty_room(), dart, other)


def unsew(gmap: GMap, dart: int) -> None:
    """Unsew the face of a dart; raise TopologyError, with nothing changed, if it is free."""
    slot = int(dart) // 6
    if gmap.image.reshape(-1)[slot] == 6 * slot:
        raise TopologyError(f"cannot 3-unsew dart {dart}: it is 3-free already")
    unsew_kernel(address_row(gmap)[None], 0, ANY, empty_room(), np.array([slot]))


def face_gluing(corners: np.ndarray, tet_a: int, tet_b: int) -> tuple[int, int]:
    """Return the darts of two tetrahedra at the face whose points they share; raise TopologyError where they share none."""
    for face, (a, b, c) in enumerate(corners[tet_a][FACE_CORNERS].tolist()):
        for other in range(4):
            points = corners[tet_b][FACE_CORNERS[other]].tolist()
            if sorted(points) == sorted((a, b, c)):
                starts = corners[tet_b][CORNER_OF_DART[6 * other: 6 * other + 6]]
                k = next(k for k in range(6) if starts[k] == a and starts[k ^ 1] == b)
                if tet_a != tet_b:
                    return 24 * int(tet_a) + 6 * face, 24 * int(tet_b) + 6 * other + k
    raise TopologyError(f"tetrahedra {tet_a} and {tet_b} share no face, in this body or in the mesh it came from")


@kernel
def sew_kernel(table, row, real, room, dart, other):
    """Sew two free faces of a map found by its addresses."""
    sew_faces(read_gmap(table, row, real), room, dart, other)


@kernel
def unsew_kernel(table, row, real, room, slots):
    """Unsew faces of a map found by its addresses."""
    unsew_faces(read_gmap(table, row, real), room, slots, slots[:0])


@inlined_part
def unsew_faces(gmap, room, slots, removed):
    """Unlink faces and remove tetrahedra, then settle all splits once. Slots and removed are ascending."""
    clear(room)
    n_vertices = gmap.counts[0]
    n_edges = gmap.counts[1]
    for tetrahedron in removed:
        fetch_around(gmap, tetrahedron)
    left_edges = forget_removed(room, gmap.edge_of, gmap.edge_dart, removed)
    left_vertices = forget_removed(room, gmap.vertex_of, gmap.vertex_dart, removed)
    opened = open_faces(gmap, room, slots, removed)
    edges = settle_cells(gmap, room, EDGE, touched_edges(gmap, room, opened), left_edges)
    vertices = settle_cells(gmap, room, VERTEX, touched_vertices(gmap, room, opened, edges.pairs[:, 1]), left_vertices)
    recount_links(gmap, vertices)
    labels = opened[:0]
    if len(vertices.pairs) > 0 or len(removed) > 0:
        labels = relabel_components(gmap, room, opened)
    n_alive = np.int64(0)
    for slot in opened:
        if gmap.component_of[slot >> 2] >= 0:
            opened[n_alive] = slot
            n_alive += 1
    return MapChange(
        follow(room, vertices, vertices.pairs, n_vertices, compact_cells(gmap, room, VERTEX, vertices.dead), n_vertices),
        follow(room, edges, edges.pairs, n_edges, compact_cells(gmap, room, EDGE, edges.dead), n_edges),
        opened[:n_alive],
        labels,
    )


@part
def sew_faces(gmap, room, dart, other):
    """Link two free faces, then merge their cells; also return the (kept, gone) vertices, in numbers before the moves."""
    clear(room)
    n_vertices = gmap.counts[0]
    n_edges = gmap.counts[1]
    join_components(gmap, dart // 24, other // 24)
    link_faces(gmap.image, dart, other)
    edges = merge_cells(gmap, room, EDGE, dart)
    vertices = merge_cells(gmap, room, VERTEX, dart)
    recount_links(gmap, vertices)
    change = MapChange(
        follow(room, vertices, vertices.pairs[:0], 0, compact_cells(gmap, room, VERTEX, vertices.dead), n_vertices),
        follow(room, edges, edges.pairs[:0], 0, compact_cells(gmap, room, EDGE, edges.dead), n_edges),
        vertices.dead[:0],
        vertices.dead[:0],
    )
    return change, vertices.pairs


@inlined_part
def follow(room, settled, copied, first_joined, moved, n_before):
    """Express what settling did in the numbers after the moves; cells from first_joined on gained corners of others."""
    final_copied = copied
    changed = settled.changed
    is_joined = take(room, len(changed))
    for i in range(len(changed)):
        is_joined[i] = changed[i] >= first_joined
    if len(moved) > 0:
        final_copied = take_pairs(room, len(copied))
        for i in range(len(copied)):
            final_copied[i, 0] = renumbered(copied[i, 0], moved)
            final_copied[i, 1] = renumbered(copied[i, 1], moved)
        changed = take(room, len(settled.changed))
        for i in range(len(changed)):
            changed[i] = renumbered(settled.changed[i], moved)
    n_old = len(moved)  # cells that were there before move before those that are new, since rows move in ascending order
    while n_old > 0 and moved[n_old - 1, 0] >= n_before:
        n_old -= 1
    return CellChanges(copied, moved, changed, is_joined, settled.ends, settled.members, len(settled.dead), final_copied,
                       moved[:n_old])


@part
def renumbered(cell, moved):
    """Return the number of a cell after the moves (from, to), which are ascending."""
    low, high = 0, len(moved)
    while low < high:
        middle = (low + high) // 2
        if moved[middle, 0] < cell:
            low = middle + 1
        else:
            high = middle
    if low < len(moved) and moved[low, 0] == cell:
        return moved[low, 1]
    return np.int64(cell)
