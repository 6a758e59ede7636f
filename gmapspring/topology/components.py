"""The labels of components, kept true while the body falls apart or is sewn again: topology alone."""

from typing import NamedTuple

import numpy as np

from gmapspring.jit import part
from gmapspring.topology.darts import FACE_CORNERS
from gmapspring.topology.gmap import N_LABELS, neighbour
from gmapspring.topology.room import take, take_lists
from gmapspring.topology.walks import next_stamps, sort, walk_component, walk_smaller_side

MANY = 8
"""To walk through the whole body once is faster where more than every so-many-th of its tetrahedra is looked at otherwise."""
HALF, LOWER = 32, 2**32 - 1
"""Where two numbers share one, the first is in its upper half."""


class Suspects(NamedTuple):
    """Sides of faces at which the body may have come apart: those that were opened and have no corner in common any longer.

    Two unions of them: those that hang together, as far as their vertices tell, and those that hung together before.
    """

    tetrahedra: np.ndarray
    """The two sides of each face one after the other, (2 k,)."""
    piece: np.ndarray
    """Another one that hangs together with it by vertices they share, or itself; see `root`."""
    cause: np.ndarray
    """Another one that was connected to it by what has been opened or removed, or that hangs together with it, or itself."""


@part
def find_suspects(gmap, room, opened):
    """Find the suspects among the sides of opened faces."""
    n = np.int64(0)
    lists = take_lists(room, 3, len(opened))
    tetrahedra, piece, cause = lists[0], lists[1], lists[2]
    for i in range(0, len(opened), 2):
        if not meet_at_corner(gmap, opened[i], opened[i + 1]):
            tetrahedra[n], tetrahedra[n + 1] = opened[i] >> 2, opened[i + 1] >> 2
            n += 2
    for i in range(n):
        piece[i], cause[i] = i, i & -2
        if follows_itself(tetrahedra, i):
            cause[i] = cause[i - 2]
    return Suspects(tetrahedra[:n], piece[:n], cause[:n])


@part
def follows_itself(tetrahedra, i):
    """Return whether suspect i is a first side, and of the tetrahedron that the face before was of, as where one is removed."""
    return i % 2 == 0 and i >= 2 and tetrahedra[i] == tetrahedra[i - 2]


@part
def meet_at_corner(gmap, slot, other):
    """Return whether the two sides of an opened face have a vertex in common; what is removed has none."""
    for corner in FACE_CORNERS[slot & 3]:
        vertex = gmap.vertex_of[slot >> 2, corner]
        for across in FACE_CORNERS[other & 3]:
            if vertex >= 0 and gmap.vertex_of[other >> 2, across] == vertex:
                return True
    return False


@part
def unite_suspects(gmap, room, suspects):
    """Unite those that share a vertex; those that are of the same removed tetrahedron have been connected by it."""
    tetrahedra, n_vertices = suspects.tetrahedra, 4 * len(gmap.component_of)
    keys, n_keys = take(room, 4 * len(tetrahedra)), 0  # vertex first, then suspect: sorted, those at one vertex are neighbours
    for i in range(len(tetrahedra)):
        if gmap.component_of[tetrahedra[i]] >= 0:
            for corner in range(4):
                keys[n_keys] = np.int64(gmap.vertex_of[tetrahedra[i], corner]) << HALF | i
                n_keys += 1
        elif not follows_itself(tetrahedra, i):
            keys[n_keys] = n_vertices + tetrahedra[i] << HALF | i
            n_keys += 1
    sort(keys[:n_keys])
    for k in range(1, n_keys):
        if keys[k] >> HALF == keys[k - 1] >> HALF:
            unite(suspects.cause, keys[k] & LOWER, keys[k - 1] & LOWER)
            if keys[k] >> HALF < n_vertices:
                unite(suspects.piece, keys[k] & LOWER, keys[k - 1] & LOWER)


@part
def root(group, i):
    """Return the representative of a set, shortening the way to it."""
    while group[i] != i:
        group[i] = group[group[i]]
        i = group[i]
    return i


@part
def unite(group, i, j):
    """Join two sets; the lower representative stays."""
    i = root(group, i)
    j = root(group, j)
    group[max(i, j)] = min(i, j)


@part
def relabel_components(gmap, room, opened):
    """Give a new label to each piece that has come off its component; return the new labels.

    opened: slots that became free, the two sides of a face one after the other.

    Where all suspects with one cause still hang together, every old way has a way round; those with different causes, which may
    lie far apart, need not be asked whether they hang together. But where a piece that came off has suspects with two causes,
    what it has held together may have come apart too: the two causes become one, and are asked again.
    """
    suspects = find_suspects(gmap, room, opened)
    first_label, is_open = gmap.counts[N_LABELS], len(suspects.tetrahedra) > 0
    limit = len(gmap.component_of) // MANY - len(suspects.tetrahedra)
    if limit >= 0:
        unite_suspects(gmap, room, suspects)
    while is_open and limit >= 0:
        limit -= part_causes(gmap, room, suspects, first_label, limit)
        is_open = limit >= 0 and unite_causes(gmap, room, suspects, first_label)
    if limit < 0:
        relabel_all(gmap)
    labels = take(room, gmap.counts[N_LABELS] - first_label)
    for i in range(len(labels)):
        labels[i] = first_label + i
    return labels


@part
def part_causes(gmap, room, suspects, first_label, limit):
    """Give a new label to each piece but one of those that one cause has held together and that have no new label yet.

    Returns how many tetrahedra were found on the way; past the limit it gives up.
    """
    tetrahedra, n = suspects.tetrahedra, len(suspects.tetrahedra)
    lists = take_lists(room, 3, n)
    first, following, seeds = lists[0], lists[1], lists[2]  # a chain of suspects for each cause, ended by -1; what is walked from
    for i in range(n):
        first[i] = -1
    for i in range(n - 1, -1, -1):
        if suspects.piece[i] == i and gmap.component_of[tetrahedra[i]] >= 0:
            cause = root(suspects.cause, i)
            following[i], first[cause] = first[cause], i
    n_found = 0
    for cause in range(n):
        i, n_seeds = first[cause], 0
        while i >= 0:
            if gmap.component_of[tetrahedra[i]] < first_label:
                seeds[n_seeds] = tetrahedra[i]
                n_seeds += 1
            i = following[i]
        if n_seeds > 1 and n_found <= limit:
            ended, n_more = walk_apart(gmap, room, seeds[:n_seeds], limit - n_found)
            n_found += n_more
            for piece in ended:
                for member in gmap.queue[: walk_component(gmap, piece, gmap.queue)]:
                    gmap.component_of[member] = gmap.counts[N_LABELS]
                gmap.counts[N_LABELS] += 1
    return n_found


@part
def unite_causes(gmap, room, suspects, first_label):
    """Unite the causes of suspects in one piece that came off; return whether some were not one already."""
    found = take(room, gmap.counts[N_LABELS] - first_label)
    for i in range(len(found)):
        found[i] = -1
    has_united = False
    for i in range(len(suspects.tetrahedra)):
        piece = gmap.component_of[suspects.tetrahedra[i]] - first_label
        if piece >= 0:
            if found[piece] < 0:
                found[piece] = i
            elif root(suspects.cause, i) != root(suspects.cause, found[piece]):
                unite(suspects.cause, i, found[piece])
                has_united = True
    return has_united


class Walks(NamedTuple):
    """Walks through the body, one from each of some tetrahedra; walks that have met are one.

    What they find stands in the queue, in the order in which it is found.
    """

    group: np.ndarray
    """The walk that each has become part of, or itself; see `root`."""
    head: np.ndarray
    """Place in the queue of what each goes on from next, -1 where there is nothing left: it has ended."""
    tail: np.ndarray
    """Place of the last that it will go on from."""


@part
def walk_apart(gmap, room, seeds, limit):
    """Walk from tetrahedra of one component in turn, until all walks but one have met another or ended, or past the limit.

    Returns the seeds of those that ended, one of each piece but a last one, and how many tetrahedra were found. These are the
    pieces that came off and the ways on which others meet, and as much of the last piece, but not all of the body.
    """
    n_seeds = len(seeds)
    lists, following = take_lists(room, 5, n_seeds), take(room, 64 + n_seeds)
    walks, turn, ended = Walks(lists[0], lists[1], lists[2]), lists[3], lists[4]
    first_stamp = next_stamps(gmap, n_seeds)
    for i in range(n_seeds):
        gmap.mark[seeds[i]], gmap.queue[i] = first_stamp + i, seeds[i]
        walks.group[i], walks.head[i], walks.tail[i], turn[i], following[i] = i, i, i, i, -1
    n_found, n_turns, n_walking, n_ended = n_seeds, n_seeds, n_seeds, np.int64(0)
    while n_walking > 1 and n_found <= limit:
        n_kept = np.int64(0)
        for walk in turn[:n_turns]:
            if walks.group[walk] != walk or n_walking == 1:
                continue
            if walks.head[walk] < 0:
                ended[n_ended] = seeds[walk]
                n_ended += 1
                n_walking -= 1
                continue
            if n_found + 4 > len(following):
                following = lengthened(following)
            n_found, n_met = go_on(gmap, walks, walk, following, n_found, first_stamp)
            n_walking -= n_met
            turn[n_kept] = walk
            n_kept += 1
        n_turns = n_kept
    return ended[:n_ended], n_found


@part
def go_on(gmap, walks, walk, following, n_found, first_stamp):
    """Let a walk look across the faces of its next tetrahedron; return how many are found now, and how many walks it has met."""
    n_met = 0
    here = np.int64(gmap.queue[walks.head[walk]])
    walks.head[walk] = following[walks.head[walk]]
    for face in range(4):
        there = neighbour(gmap.image, here, face) >> 2
        finder = np.int64(gmap.mark[there]) - first_stamp
        if finder < 0:
            gmap.mark[there], gmap.queue[n_found], following[n_found] = first_stamp + walk, there, -1
            append(walks, walk, following, n_found, n_found)
            n_found += 1
        else:
            met = root(walks.group, finder)
            if met != walk:
                append(walks, walk, following, walks.head[met], walks.tail[met])
                walks.group[met] = walk
                n_met += 1
    return n_found, n_met


@part
def append(walks, walk, following, first, last):
    """Let a walk go on, when it has done all else, from what stands in the queue between two places; first: -1 for nothing."""
    if first < 0:
        return
    if walks.head[walk] < 0:
        walks.head[walk] = first
    else:
        following[walks.tail[walk]] = first
    walks.tail[walk] = last


@part
def lengthened(numbers):
    """Return a copy with room for as many again."""
    longer = np.empty(2 * len(numbers), dtype=np.int64)
    for i in range(len(numbers)):  # to assign to a slice takes two seconds to compile
        longer[i] = numbers[i]
    return longer


@part
def relabel_all(gmap):
    """Give new labels by walking through the whole body, which is faster once much of it has been cut.

    Of the pieces of one component the first keeps its label; the others get new ones in the order of their lowest tetrahedra.
    """
    is_taken = np.zeros(gmap.counts[N_LABELS], dtype=np.bool_)
    is_found = np.zeros(len(gmap.component_of), dtype=np.bool_)
    for seed in range(len(gmap.component_of)):
        if gmap.component_of[seed] < 0 or is_found[seed]:
            continue
        label = np.int64(gmap.component_of[seed])
        if is_taken[label]:
            label = gmap.counts[N_LABELS]
            gmap.counts[N_LABELS] += 1
        else:
            is_taken[label] = True
        for member in gmap.queue[: walk_component(gmap, seed, gmap.queue)]:
            gmap.component_of[member] = label
            is_found[member] = True


@part
def relabel_found(gmap, n_found, at_back, label):
    """Give a label to the tetrahedra that walk_smaller_side has found."""
    start = gmap.queue.shape[0] - n_found if at_back else 0
    for tetrahedron in gmap.queue[start: start + n_found]:
        gmap.component_of[tetrahedron] = label


@part
def join_components(gmap, first, second):
    """Give one label to the components of two tetrahedra that are about to be sewn: the larger one's."""
    if gmap.component_of[first] == gmap.component_of[second]:
        return
    n_found, at_back = walk_smaller_side(gmap, first, second)
    kept = gmap.component_of[first] if at_back else gmap.component_of[second]
    relabel_found(gmap, n_found, at_back, kept)
