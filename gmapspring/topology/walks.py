"""Walks round a vertex, round an edge and through a component: what an orbit visits, a tetrahedron at a time."""

import numpy as np

from gmapspring.jit import kernel
from gmapspring.topology.darts import (
    ALPHA2,
    CORNER_FACES,
    CORNER_OF_DART,
    DART_AT_CORNER,
    DARTS_AT_EDGE,
    EDGE_OF_DART,
    LOWEST_DART_OF_CORNER,
    LOWEST_DART_OF_EDGE,
)
from gmapspring.topology.gmap import STAMP, VERTEX, alpha3, neighbour

LAST_STAMP = 2**31 - 1


@kernel
def next_stamp(gmap):
    """Return a stamp that no mark bears."""
    if gmap.counts[STAMP] == LAST_STAMP:
        gmap.mark[:] = 0
        gmap.counts[STAMP] = 0
    gmap.counts[STAMP] += 1
    return np.int32(gmap.counts[STAMP])


@kernel
def walk_vertex(gmap, tetrahedron, corner, found):
    """Find the corners of one vertex; fill found with 4*tetrahedron + corner and return how many."""
    stamp = next_stamp(gmap)
    gmap.mark[tetrahedron] = stamp
    found[0] = 4 * tetrahedron + corner
    n_found = 1
    i = 0
    while i < n_found:
        here = np.int64(found[i]) >> 2
        at = np.int64(found[i]) & 3
        i += 1
        for j in range(3):
            face = CORNER_FACES[at, j]
            there = neighbour(gmap.image, here, face) >> 2
            if gmap.mark[there] != stamp:
                gmap.mark[there] = stamp
                across = alpha3(gmap.image, 24 * here + DART_AT_CORNER[at, face])
                found[n_found] = 4 * there + CORNER_OF_DART[across - 24 * there]
                n_found += 1
    return n_found


@kernel
def walk_edge(gmap, tetrahedron, edge, found):
    """Find the tetrahedra round one edge, one way, then the other; fill found with 6*tetrahedron + edge, return how many."""
    found[0] = 6 * tetrahedron + edge
    n_found = 1
    for way in range(2):
        dart = 24 * tetrahedron + np.int64(DARTS_AT_EDGE[edge, way])
        while True:
            across = alpha3(gmap.image, dart)
            there = across // 24
            if across == dart:
                break
            if there == tetrahedron:
                return n_found
            local = across - 24 * there
            found[n_found] = 6 * there + EDGE_OF_DART[local]
            n_found += 1
            dart = 24 * there + np.int64(ALPHA2[local])
    return n_found


@kernel
def walk_cell(gmap, dimension, code, found):
    """Walk round a vertex (dimension 0, code 4*tetrahedron + corner) or an edge (1, 6*tetrahedron + edge)."""
    if dimension == VERTEX:
        return walk_vertex(gmap, code >> 2, code & 3, found)
    return walk_edge(gmap, code // 6, code % 6, found)


@kernel
def lowest_dart(dimension, code):
    """Return the lowest dart of a cell within one tetrahedron, from its code (see walk_cell)."""
    if dimension == VERTEX:
        return 24 * (code >> 2) + np.int64(LOWEST_DART_OF_CORNER[code & 3])
    return 24 * (code // 6) + np.int64(LOWEST_DART_OF_EDGE[code % 6])


@kernel
def code_of_dart(dimension, dart):
    """Return the code (see walk_cell) of the vertex or edge that a dart belongs to."""
    tetrahedron = dart // 24
    local = dart - 24 * tetrahedron
    if dimension == VERTEX:
        return 4 * tetrahedron + np.int64(CORNER_OF_DART[local])
    return 6 * tetrahedron + np.int64(EDGE_OF_DART[local])


@kernel
def walk_component(gmap, tetrahedron, found):
    """Find the tetrahedra of one component; fill found and return how many."""
    stamp = next_stamp(gmap)
    gmap.mark[tetrahedron] = stamp
    found[0] = tetrahedron
    n_found = 1
    i = 0
    while i < n_found:
        here = np.int64(found[i])
        i += 1
        for face in range(4):
            there = neighbour(gmap.image, here, face) >> 2
            if gmap.mark[there] != stamp:
                gmap.mark[there] = stamp
                found[n_found] = there
                n_found += 1
    return n_found


@kernel
def walk_smaller_side(gmap, first, second):
    """Walk from two tetrahedra in turn until one walk ends or they meet.

    Returns (n_found, from_back): how many tetrahedra the walk that ended has found, 0 where the two meet, and whether they
    lie at the back of the queue. The cost is that of the smaller side, not of the body.
    """
    queue = gmap.queue
    size = queue.shape[0]
    stamps = (next_stamp(gmap), next_stamp(gmap))
    gmap.mark[first] = stamps[0]
    gmap.mark[second] = stamps[1]
    queue[0] = first
    queue[size - 1] = second
    n_found = np.ones(2, dtype=np.int64)
    n_done = np.zeros(2, dtype=np.int64)
    side = 0
    while n_done[side] < n_found[side]:
        here = np.int64(queue[n_done[side]] if side == 0 else queue[size - 1 - n_done[side]])
        n_done[side] += 1
        for face in range(4):
            there = neighbour(gmap.image, here, face) >> 2
            if gmap.mark[there] == stamps[1 - side]:
                return 0, False
            if gmap.mark[there] != stamps[side]:
                gmap.mark[there] = stamps[side]
                queue[n_found[side] if side == 0 else size - 1 - n_found[side]] = there
                n_found[side] += 1
        side = 1 - side
    return n_found[side], side == 1


@kernel
def sort(values):
    """Sort whole numbers in place (Shell sort: short to compile, and fast on the few numbers that a cut touches)."""
    gap = len(values) // 2
    while gap > 0:
        for i in range(gap, len(values)):
            value = values[i]
            j = i
            while j >= gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value
        gap //= 2
