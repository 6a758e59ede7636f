"""The numbers of vertices and edges, kept true while faces are unlinked and linked: topology alone.

A cut is settled in three moves. `open_faces` unlinks everything. `settle_cells` finds the pieces of every old vertex or edge
that was touched: the piece that holds the old cell's lowest dart keeps its number, each other piece gets a new one at the
end. `compact_cells` fills the rows of cells that died with the last ones. The result depends on the set of cuts alone,
not on their order.
"""

from typing import NamedTuple

import numpy as np

from gmapspring.jit import part
from gmapspring.topology.darts import CORNER_EDGES, CORNER_FACES, EDGE_CORNERS, FACE_CORNERS, FACE_EDGES
from gmapspring.topology.gmap import (
    EDGE,
    EDGES,
    FACES,
    N_TETRAHEDRA,
    NO_DART,
    TETRAHEDRA,
    THREE,
    TWENTY_FOUR,
    TWO,
    VERTEX,
    alpha3,
    neighbour,
    unlink_face,
)  # fmt: skip
from gmapspring.topology.room import take, take_pairs
from gmapspring.topology.walks import code_of_dart, lowest_dart, put_sorted, sort, walk_cell


class Settled(NamedTuple):
    """What settling or merging did to the cells of one dimension."""

    pairs: np.ndarray
    """(kept, new) where a cell split, (kept, gone) where two merged, int64 (k, 2)."""
    changed: np.ndarray
    """Cells whose tetrahedra may have changed, the new ones included, int64 (k,)."""
    ends: np.ndarray
    """Where the members of each changed cell end; they begin where those of the one before end, int64 (k,)."""
    members: np.ndarray
    """Codes (see walk_cell) of all members of changed cells, ascending in each, int64 (n,)."""
    dead: np.ndarray
    """Cells that have no tetrahedron left, ascending, int64 (k,)."""


@part
def open_faces(gmap, room, slots, removed):
    """Unlink faces and whole tetrahedra; return the slots that became free, the two sides of a face one after the other."""
    opened = take(room, 2 * len(slots) + 8 * len(removed))
    n_opened = np.int64(0)
    for slot in slots:
        if neighbour(gmap.image, slot >> 2, slot & 3) != slot:
            opened[n_opened] = slot
            opened[n_opened + 1] = unlink_face(gmap.image, slot)
            n_opened += 2
    for tetrahedron in removed:
        for face in range(4):
            slot = 4 * tetrahedron + face
            if neighbour(gmap.image, tetrahedron, face) != slot:
                opened[n_opened] = slot
                opened[n_opened + 1] = unlink_face(gmap.image, slot)
                n_opened += 2
        gmap.component_of[tetrahedron] = -1
    gmap.counts[N_TETRAHEDRA] -= len(removed)
    return opened[:n_opened]


@part
def forget_removed(room, cell_of, dart_of, removed):
    """Take removed tetrahedra out of their cells, mark those cells as touched, and return their numbers."""
    per = cell_of.shape[1]
    left = take(room, per * len(removed))
    n_left = np.int64(0)
    for tetrahedron in removed:
        for local in range(per):
            cell = cell_of[tetrahedron, local]
            cell_of[tetrahedron, local] = -1
            if dart_of[cell] != NO_DART:
                dart_of[cell] = NO_DART
                left[n_left] = cell
                n_left += 1
    return left[:n_left]


@part
def touched_edges(gmap, room, opened):
    """Mark the edges of freed faces as touched; return the codes 6*tetrahedron + edge of live tetrahedra."""
    codes = take(room, 3 * len(opened))
    n_codes = np.int64(0)
    for slot in opened:
        tetrahedron = slot >> 2
        if gmap.component_of[tetrahedron] < 0:
            continue
        for edge in FACE_EDGES[slot & 3]:
            gmap.edge_dart[gmap.edge_of[tetrahedron, edge]] = NO_DART
            codes[n_codes] = 6 * tetrahedron + edge
            n_codes += 1
    return codes[:n_codes]


@part
def touched_vertices(gmap, room, opened, new_edges):
    """Return the codes 4*tetrahedron + corner at which a vertex can have split; count the freed faces at all others.

    A vertex splits only where one of its edges does: two pieces of its star that came apart at a face
    are in different pieces round an edge of that face. Vertices of removed tetrahedra are marked already.
    """
    for new in new_edges:
        code = code_of_dart(EDGE, np.int64(gmap.edge_dart[new]))
        for corner in EDGE_CORNERS[code % 6]:
            gmap.vertex_dart[gmap.vertex_of[code // 6, corner]] = NO_DART
    codes = take(room, 3 * len(opened))
    n_codes = np.int64(0)
    for i in range(len(opened)):
        tetrahedron = opened[i] >> 2
        if gmap.component_of[tetrahedron] < 0:
            continue
        for corner in FACE_CORNERS[opened[i] & 3]:
            vertex = gmap.vertex_of[tetrahedron, corner]
            if gmap.vertex_dart[vertex] == NO_DART:
                codes[n_codes] = 4 * tetrahedron + corner
                n_codes += 1
            else:
                gmap.link[vertex, FACES] += i % 2  # one face has become two: one more, for the two sides together
    return codes[:n_codes]


@part
def settle_cells(gmap, room, dimension, codes, left):
    """Number the pieces of touched cells; codes lie in every piece, left are cells that lost removed tetrahedra."""
    cell_of = gmap.vertex_of.reshape(-1) if dimension == VERTEX else gmap.edge_of.reshape(-1)  # by code
    dart_of = gmap.vertex_dart if dimension == VERTEX else gmap.edge_dart
    queue = gmap.queue
    changed = take(room, len(codes))
    ends = take(room, len(codes))
    members = take(room, 16 * len(codes))
    n_pieces = np.int64(0)
    n_members = np.int64(0)
    for code in codes:
        cell = np.int64(cell_of[code])
        if cell < -1:
            continue  # in a piece that has been found
        n_found = walk_cell(gmap, dimension, code, queue)
        if n_members + n_found > len(members):
            members = longer(room, members, n_members, n_found)
        put_sorted(queue, n_found, members, n_members)
        for i in range(n_found):
            cell_of[np.uint64(queue[i])] = -2 - n_pieces
        dart_of[cell] = min(np.int64(dart_of[cell]), lowest_dart(dimension, np.int64(members[n_members])))
        n_members += n_found
        changed[n_pieces] = cell
        ends[n_pieces] = n_members
        n_pieces += 1
    new = take_pairs(room, n_pieces)
    n_new = np.int64(0)
    start = np.int64(0)
    for piece in range(n_pieces):
        cell = changed[piece]
        first = lowest_dart(dimension, np.int64(members[start]))
        if first != dart_of[cell]:
            new[n_new, 0] = cell
            cell = gmap.counts[dimension]
            gmap.counts[dimension] += 1
            dart_of[cell] = first
            new[n_new, 1] = cell
            changed[piece] = cell
            n_new += 1
        for i in range(start, ends[piece]):
            cell_of[np.uint64(members[i])] = cell
        start = ends[piece]
    return Settled(new[:n_new], changed[:n_pieces], ends[:n_pieces], members, dead_cells(room, dart_of, left))


@part
def longer(room, members, n_members, n_more):
    """Return a copy of the first n_members with room for as many again, and for n_more."""
    result = take(room, 2 * len(members) + n_more)
    for i in range(n_members):  # a slice would take seconds to compile
        result[i] = members[i]
    return result


@part
def dead_cells(room, dart_of, left):
    """Return those of the cells that have no dart, ascending."""
    dead = take(room, len(left))
    n_dead = np.int64(0)
    for cell in left:
        if dart_of[cell] == NO_DART:
            dead[n_dead] = cell
            n_dead += 1
    sort(dead[:n_dead])
    return dead[:n_dead]


@part
def assign_cell(gmap, dimension, dart, cell):
    """Give a number to every corner (dimension 0) or edge (1) of the cell that a dart belongs to."""
    cell_of = gmap.vertex_of.reshape(-1) if dimension == VERTEX else gmap.edge_of.reshape(-1)  # by code
    for member in gmap.queue[: walk_cell(gmap, dimension, code_of_dart(dimension, dart), gmap.queue)]:
        cell_of[member] = cell


@part
def recount_link(gmap, vertex, members, start, stop):
    """Count the edges, faces and tetrahedra around a vertex whose members stand from start to stop."""
    image, edge_of, edge_dart = gmap.image, gmap.edge_of, gmap.edge_dart
    n_edges = 0
    n_free = 0
    for i in range(start, stop):
        tetrahedron = np.uint64(members[i]) >> TWO
        corner = np.uint64(members[i]) & THREE
        for j in range(3):
            # An edge is counted in the tetrahedron of its lowest dart, hence once.
            edge = np.uint64(edge_of[tetrahedron, np.uint64(CORNER_EDGES[corner, np.uint64(j)])])
            n_edges += np.uint64(edge_dart[edge]) // TWENTY_FOUR == tetrahedron
            # No two faces of a tetrahedron are linked: a face that leads back to its own is free.
            n_free += np.uint64(image[tetrahedron, np.uint64(CORNER_FACES[corner, np.uint64(j)])]) // TWENTY_FOUR == tetrahedron
    gmap.link[vertex, EDGES] = n_edges
    gmap.link[vertex, FACES] = (3 * (stop - start) + n_free) // 2
    gmap.link[vertex, TETRAHEDRA] = stop - start


@part
def recount_links(gmap, settled):
    """Count what is around each vertex that has changed."""
    start = np.int64(0)
    for piece in range(len(settled.changed)):
        recount_link(gmap, settled.changed[piece], settled.members, start, settled.ends[piece])
        start = settled.ends[piece]


@part
def compact_cells(gmap, room, dimension, dead):
    """Move the last cells into the rows of dead ones; return the moves (from, to), each row moving at most once."""
    dart_of = gmap.vertex_dart if dimension == VERTEX else gmap.edge_dart
    n_kept = gmap.counts[dimension] - len(dead)
    moved = take_pairs(room, len(dead))
    n_moved = np.int64(0)
    for cell in range(n_kept, gmap.counts[dimension]):
        if dart_of[cell] == NO_DART:
            continue
        hole = dead[n_moved]
        dart_of[hole] = dart_of[cell]
        if dimension == VERTEX:
            for i in range(3):
                gmap.link[hole, i] = gmap.link[cell, i]
        assign_cell(gmap, dimension, np.int64(dart_of[cell]), hole)
        moved[n_moved, 0] = cell
        moved[n_moved, 1] = hole
        n_moved += 1
    gmap.counts[dimension] = n_kept
    return moved[:n_moved]


@part
def merge_cells(gmap, room, dimension, dart):
    """Merge the cells on the two sides of a face that has just been linked: the lower number stays.

    Its lowest dart is the lower of the two.
    """
    cell_of = gmap.vertex_of.reshape(-1) if dimension == VERTEX else gmap.edge_of.reshape(-1)  # by code
    dart_of = gmap.vertex_dart if dimension == VERTEX else gmap.edge_dart
    merged = take_pairs(room, 3)
    changed = take(room, 3)
    ends = take(room, 3)
    members = take(room, 48)
    n_merged = np.int64(0)
    n_members = np.int64(0)
    for side in range(3):
        here = dart // 6 * 6 + 2 * side
        code = code_of_dart(dimension, here)
        other = code_of_dart(dimension, alpha3(gmap.image, here))
        first = np.int64(cell_of[code])
        second = np.int64(cell_of[other])
        kept = min(first, second)
        if first != second:
            gone = max(first, second)
            dart_of[kept] = min(np.int64(dart_of[kept]), np.int64(dart_of[gone]))
            dart_of[gone] = NO_DART
            merged[n_merged, 0] = kept
            merged[n_merged, 1] = gone
            n_merged += 1
        n_found = walk_cell(gmap, dimension, code, gmap.queue)
        if n_members + n_found > len(members):
            members = longer(room, members, n_members, n_found)
        put_sorted(gmap.queue, n_found, members, n_members)
        for i in range(n_found):
            cell_of[gmap.queue[i]] = kept
        n_members += n_found
        changed[side] = kept
        ends[side] = n_members
    return Settled(merged[:n_merged], changed, ends, members, dead_cells(room, dart_of, merged[:n_merged, 1].copy()))
