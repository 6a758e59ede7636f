"""The labels of components, kept true while the body falls apart or is sewn again: topology alone."""

import numpy as np

from gmapspring.jit import part
from gmapspring.topology.gmap import N_LABELS
from gmapspring.topology.room import take
from gmapspring.topology.walks import sort, walk_component, walk_smaller_side


@part
def seeds_of_pieces(gmap, room, opened):
    """Pick live tetrahedra beside freed faces, one from each set that hangs together by shared vertices."""
    seeds = take(room, len(opened))
    n_seeds = np.int64(0)
    for slot in opened:
        if gmap.component_of[slot >> 2] >= 0:
            seeds[n_seeds] = slot >> 2
            n_seeds += 1
    group = take(room, n_seeds)
    for i in range(n_seeds):
        group[i] = i
    keys = take(room, 4 * n_seeds)  # vertex first, then seed: sorted, the seeds at one vertex are neighbours
    for i in range(n_seeds):
        for corner in range(4):
            keys[4 * i + corner] = gmap.vertex_of[seeds[i], corner] * n_seeds + i
    sort(keys)
    for j in range(1, len(keys)):
        if keys[j] // n_seeds == keys[j - 1] // n_seeds:
            unite(group, keys[j] % n_seeds, keys[j - 1] % n_seeds)
    n_sets = np.int64(0)
    for i in range(n_seeds):
        if group[i] == i:
            seeds[n_sets] = seeds[i]
            n_sets += 1
    return seeds[:n_sets]


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

    Tetrahedra that share a vertex are in one component, so most cuts need no search: a face must have lost all three corners.
    """
    if 8 * len(opened) > len(gmap.component_of):
        return relabel_all(gmap, room)
    seeds = seeds_of_pieces(gmap, room, opened)
    n_seeds = len(seeds)
    if n_seeds < 2:
        return seeds[:0]
    keys = take(room, n_seeds)  # old label first, then seed
    for i in range(n_seeds):
        keys[i] = gmap.component_of[seeds[i]] * n_seeds + i
    sort(keys)
    labels = take(room, n_seeds)
    n_labels = np.int64(0)
    reference = np.int64(-1)
    reference_label = np.int64(-1)
    for key in keys:
        seed = seeds[key % n_seeds]
        if key // n_seeds != reference_label:
            reference, reference_label = seed, key // n_seeds
        elif gmap.component_of[seed] == reference_label:
            n_found, at_back = walk_smaller_side(gmap, reference, seed)
            if n_found > 0:
                labels[n_labels] = gmap.counts[N_LABELS]
                relabel_found(gmap, n_found, at_back, labels[n_labels])
                gmap.counts[N_LABELS] += 1
                n_labels += 1
                if not at_back:
                    reference = seed  # the reference was on the piece that came off
    return labels[:n_labels]


@part
def relabel_all(gmap, room):
    """Do the same by walking through the whole body, which is faster once much of it has been cut.

    Of the pieces of one component the first keeps its label; the others get new ones in the order of their lowest tetrahedra.
    """
    is_taken = np.zeros(gmap.counts[N_LABELS], dtype=np.bool_)
    is_found = np.zeros(len(gmap.component_of), dtype=np.bool_)
    labels = take(room, len(gmap.component_of))
    n_labels = np.int64(0)
    for seed in range(len(gmap.component_of)):
        if gmap.component_of[seed] < 0 or is_found[seed]:
            continue
        label = np.int64(gmap.component_of[seed])
        if is_taken[label]:
            label = gmap.counts[N_LABELS]
            gmap.counts[N_LABELS] += 1
            labels[n_labels] = label
            n_labels += 1
        else:
            is_taken[label] = True
        for member in gmap.queue[: walk_component(gmap, seed, gmap.queue)]:
            gmap.component_of[member] = label
            is_found[member] = True
    return labels[:n_labels]


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
