"""Walks round a vertex, round an edge and through a component: what an orbit visits, a tetrahedron at a time."""

import numpy as np

from gmapspring.jit import part
from gmapspring.prefetch import prefetch
from gmapspring.topology.darts import (
    ACROSS,
    ALPHA2,
    CORNER_ACROSS,
    CORNER_FACES,
    CORNER_OF_DART,
    DARTS_AT_EDGE,
    EDGE_OF_DART,
    K_AT_CORNER,
    LOWEST_DART_OF_CORNER,
    LOWEST_DART_OF_EDGE,
)
from gmapspring.topology.gmap import SIX, STAMP, THREE, TWENTY_FOUR, TWO, VERTEX, neighbour

LAST_STAMP = 2**31 - 1


@part
def next_stamp(gmap):
    """Return a stamp that no mark bears."""
    return np.int32(next_stamps(gmap, np.int64(1)))


@part
def next_stamps(gmap, n):
    """Return the first of n stamps in a row that no mark bears."""
    if gmap.counts[STAMP] > LAST_STAMP - n:
        gmap.mark[:] = 0
        gmap.counts[STAMP] = 0
    gmap.counts[STAMP] += n
    return gmap.counts[STAMP] - n + 1


@part
def fetch_around(gmap, tetrahedron):
    """Prefetch the numbers of a tetrahedron's cells, and what walks read of the tetrahedra beyond its faces."""
    prefetch(gmap.vertex_of, tetrahedron)
    prefetch(gmap.edge_of, tetrahedron)
    for face in range(4):
        beyond = np.uint64(neighbour(gmap.image, tetrahedron, face)) >> TWO
        prefetch(gmap.image, beyond)
        prefetch(gmap.mark, beyond)


@part
def walk_vertex(gmap, tetrahedron, corner, found):
    """Find the corners of one vertex; fill found with 4*tetrahedron + corner and return how many."""
    image, mark = gmap.image, gmap.mark
    stamp = next_stamp(gmap)
    mark[tetrahedron] = stamp
    found[0] = 4 * tetrahedron + corner
    last = len(found) - 1
    n_found = 1
    i = 0
    while i < n_found:
        here = np.uint64(found[np.uint64(i)]) >> TWO
        at = np.uint64(found[np.uint64(i)]) & THREE
        i += 1
        prefetch(gmap.vertex_of, here)  # which whoever walks reads next
        prefetch(gmap.edge_of, here)
        for j in range(3):
            face = np.uint64(CORNER_FACES[at, np.uint64(j)])
            first = np.uint64(image[here, face])
            there = first // TWENTY_FOUR
            prefetch(image, there)
            # Noted in any case and kept if it is new: there is no telling which, so a branch would be mispredicted.
            place = np.uint64(min(n_found, last))
            is_known = mark[there] == stamp
            across = np.int64(4 * np.int64(there) + CORNER_ACROSS[first - there * TWENTY_FOUR, np.uint64(K_AT_CORNER[at, face])])
            found[place] = found[place] if is_known else across
            mark[there] = stamp
            n_found += not is_known
    return n_found


@part
def walk_edge(gmap, tetrahedron, edge, found):
    """Find the tetrahedra round one edge, one way, then the other; fill found with 6*tetrahedron + edge, return how many."""
    image = gmap.image
    found[0] = 6 * tetrahedron + edge
    n_found = 1
    for way in range(2):
        here, local = np.uint64(tetrahedron), np.uint64(DARTS_AT_EDGE[edge, way])
        while True:
            face = local // SIX
            first = np.uint64(image[here, face])
            there = first // TWENTY_FOUR
            if there == here:
                break  # a free face
            if there == np.uint64(tetrahedron):
                return n_found
            fetch_around(gmap, there)  # cuts walk round edges first: what lies beyond is in the stars of their ends
            across = np.uint64(ACROSS[first - there * TWENTY_FOUR, local - face * SIX])
            found[n_found] = 6 * np.int64(there) + EDGE_OF_DART[across]
            n_found += 1
            here, local = there, np.uint64(ALPHA2[across])
    return n_found


@part
def walk_cell(gmap, dimension, code, found):
    """Walk round a vertex (dimension 0, code 4*tetrahedron + corner) or an edge (1, 6*tetrahedron + edge)."""
    if dimension == VERTEX:
        return walk_vertex(gmap, code >> 2, code & 3, found)
    return walk_edge(gmap, code // 6, code % 6, found)


@part
def lowest_dart(dimension, code):
    """Return the lowest dart of a cell within one tetrahedron, from its code (see walk_cell)."""
    if dimension == VERTEX:
        return 24 * (code >> 2) + np.int64(LOWEST_DART_OF_CORNER[code & 3])
    return 24 * (code // 6) + np.int64(LOWEST_DART_OF_EDGE[code % 6])


@part
def code_of_dart(dimension, dart):
    """Return the code (see walk_cell) of the vertex or edge that a dart belongs to."""
    tetrahedron = dart // 24
    local = dart - 24 * tetrahedron
    if dimension == VERTEX:
        return 4 * tetrahedron + np.int64(CORNER_OF_DART[local])
    return 6 * tetrahedron + np.int64(EDGE_OF_DART[local])


@part
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


@part
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


@part
def sort(values):
    """Sort whole numbers in place (Shell sort: short to compile, and fast on the few numbers that a cut touches)."""
    gap = 1
    while 3 * gap + 1 < len(values):
        gap = 3 * gap + 1
    while gap > 0:
        for i in range(gap, len(values)):
            value = values[i]
            j = i
            while j >= gap and values[j - gap] > value:
                values[j] = values[j - gap]
                j -= gap
            values[j] = value
        gap //= 3


@part
def put_sorted(values, n, result, start):
    """Write the first n numbers, all different, into a longer array from a place on, in ascending order."""
    if n <= 6:
        for i in range(n):
            value = values[i]
            j = start + i
            while j > start and result[j - 1] > value:
                result[j] = result[j - 1]
                j -= 1
            result[j] = value
    elif n <= 64:
        # Each number's rank by comparison with all others: no branches, and many comparisons at a time.
        for i in range(n):
            rank = start
            for j in range(n):
                rank += values[j] < values[i]
            result[rank] = values[i]
    else:
        sort(values[:n])
        for i in range(n):
            result[start + i] = values[i]


@part
def ascending(values, limit):
    """Return whole numbers from 0 to limit - 1 in ascending order, each once."""
    n_values = 0
    if 32 * len(values) > limit:  # so many that to look at every number takes less time than to sort
        is_there = np.zeros(limit, dtype=np.bool_)
        for value in values:
            n_values += not is_there[value]
            is_there[value] = True
        result = np.empty(n_values, dtype=np.int64)
        n_values = 0
        for value in range(limit):
            if is_there[value]:
                result[n_values] = value
                n_values += 1
        return result
    result = values.astype(np.int64)
    sort(result)
    for value in result:
        if n_values == 0 or value != result[n_values - 1]:
            result[n_values] = value
            n_values += 1
    return result[:n_values]
