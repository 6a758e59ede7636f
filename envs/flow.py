"""Maximum flow through a network of whole capacities, and what of the network the source still reaches then.

Dinic's algorithm (1970): phases of shortest augmenting paths, found by depth first search over the levels of a breadth first
search. scipy's does the same, but has to be given a matrix and gives one back: for networks of a few hundred nodes, of which a
minimum cut may be asked for after every action, the matrices take several times as long as the flow.
"""

from typing import Any

import numpy as np

from gmapspring.jit import kernel, part

Array = np.ndarray[Any, Any]


@kernel
def reached_from(source, sink, n_nodes, tails, heads, capacities):
    """Return which nodes the source reaches through what a maximum flow to the sink leaves of the capacities, bool (n_nodes,).

    They are the source's side of that minimum cut which has the fewest nodes there; it is the same for every maximum flow.

    Args:
        source: a node, as sink, which must be another.
        sink: where the flow goes.
        n_nodes: nodes are numbered from 0.
        tails: where each arc begins, int64 (n_arcs,).
        heads: where each arc ends, int64 (n_arcs,).
        capacities: the most that may flow through each, at least 0, int64 (n_arcs,).
    """
    n_arcs = len(tails)
    # Arc 2 a is arc a, and 2 a + 1 is what may flow back through it.
    ends, left = np.empty(2 * n_arcs, np.int64), np.empty(2 * n_arcs, np.int64)
    for arc in range(n_arcs):
        ends[2 * arc], ends[2 * arc + 1] = heads[arc], tails[arc]
        left[2 * arc], left[2 * arc + 1] = capacities[arc], 0
    first, arcs = arcs_by_tail(n_nodes, ends)
    level, queue, path = np.empty(n_nodes, np.int64), np.empty(n_nodes, np.int64), np.empty(n_nodes, np.int64)
    following = np.empty(n_nodes, np.int64)
    while True:
        find_levels(source, first, arcs, ends, left, level, queue)
        if level[sink] < 0:
            break
        for node in range(n_nodes):
            following[node] = first[node]
        fill_level_paths(source, sink, first, arcs, ends, left, level, following, path)
    is_reached = np.empty(n_nodes, np.bool_)
    for node in range(n_nodes):
        is_reached[node] = level[node] >= 0
    return is_reached


@part
def arcs_by_tail(n_nodes, ends):
    """Return (first, arcs): those of a node, at which their twins end, are arcs[first[node]:first[node + 1]], ascending."""
    first = np.zeros(n_nodes + 1, np.int64)
    for arc in range(len(ends)):
        first[ends[arc ^ 1] + 1] += 1
    for node in range(n_nodes):
        first[node + 1] += first[node]
    place, arcs = first.copy(), np.empty(len(ends), np.int64)
    for arc in range(len(ends)):
        tail = ends[arc ^ 1]
        arcs[place[tail]] = arc
        place[tail] += 1
    return first, arcs


@part
def find_levels(source, first, arcs, ends, left, level, queue):
    """Set how many arcs with something left lead from the source to each node, -1 where none do."""
    for node in range(len(level)):
        level[node] = -1
    level[source], queue[0] = 0, source
    n_met, n_seen = 1, 0
    while n_seen < n_met:
        node = queue[n_seen]
        n_seen += 1
        for place in range(first[node], first[node + 1]):
            arc = arcs[place]
            if left[arc] > 0 and level[ends[arc]] < 0:
                level[ends[arc]] = level[node] + 1
                queue[n_met] = ends[arc]
                n_met += 1


@part
def fill_level_paths(source, sink, first, arcs, ends, left, level, following, path):
    """Send as much as there is room for along paths that go up one level with every arc.

    following: the place in arcs of the first arc of each node that may still lead on; path: room for the arcs of a path.
    """
    node, length = source, 0
    while True:
        if node == sink:
            length = send(ends, left, path, length)
            node = ends[path[length] ^ 1]
        elif following[node] < first[node + 1]:
            arc = arcs[following[node]]
            if left[arc] > 0 and level[ends[arc]] == level[node] + 1:
                path[length] = arc
                length += 1
                node = ends[arc]
            else:
                following[node] += 1
        elif length == 0:
            return
        else:  # a dead end
            length -= 1
            node = ends[path[length] ^ 1]
            following[node] += 1


@part
def send(ends, left, path, length):
    """Send what a path has room for; return how much of the path still has some."""
    least = left[path[0]]
    for place in range(1, length):
        least = min(least, left[path[place]])
    remains = length
    for place in range(length - 1, -1, -1):
        left[path[place]] -= least
        left[path[place] ^ 1] += least
        if left[path[place]] == 0:
            remains = place
    return remains
