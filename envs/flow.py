"""Maximum flow through a network of whole capacities, and what of the network the source still reaches then.

Dinic's algorithm (1970): phases of shortest augmenting paths, found by depth first search over the levels of a breadth first
search. scipy's does the same, but has to be given a matrix and gives one back: for networks of a few hundred nodes, of which a
minimum cut may be asked for after every action, the matrices take several times as long as the flow.
"""

from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel, part

Array = np.ndarray[Any, Any]


class Arcs(NamedTuple):
    """What may still flow, there and back; arcs that begin at one node lie side by side, to be gone through quickly."""

    first: Array
    """Where those of each node begin, and where the last one's end, int32 (n_nodes + 1,)."""
    ends: Array
    """Where each ends, int32 (2 * n_arcs,)."""
    twins: Array
    """Place of the one that leads back, likewise."""
    left: Array
    """How much may still flow through each, int64 (2 * n_arcs,)."""


@kernel
def reached_from(source, sink, n_nodes, tails, heads, capacities):
    """Return which nodes the source reaches through what a maximum flow to the sink leaves of the capacities, bool (n_nodes,).

    They are the source's side of that minimum cut which has the fewest nodes there; it is the same for every maximum flow.

    Args:
        source: a node, as sink, which must be another.
        sink: where the flow goes.
        n_nodes: nodes are numbered from 0.
        tails: where each arc begins, int64 (n_arcs,).
        heads: where each arc ends, another node than its tail, int64 (n_arcs,).
        capacities: the most that may flow through each, at least 0, int64 (n_arcs,).
    """
    return reached(source, sink, n_nodes, tails, heads, capacities)


@part
def reached(source, sink, n_nodes, tails, heads, capacities):
    """Do what reached_from does, for kernels."""
    arcs = arcs_by_tail(n_nodes, tails, heads, capacities)
    level, queue = np.empty(n_nodes, np.int32), np.empty(n_nodes, np.int32)
    following, path = np.empty(n_nodes, np.int32), np.empty(n_nodes, np.int32)
    while find_levels(source, sink, arcs, level, queue):
        for node in range(n_nodes):
            following[node] = arcs.first[node]
        fill_level_paths(source, sink, arcs, level, following, path)
    is_reached = np.empty(n_nodes, np.bool_)
    for node in range(n_nodes):
        is_reached[node] = level[node] >= 0
    return is_reached


@part
def arcs_by_tail(n_nodes, tails, heads, capacities):
    """Return all arcs and their twins, through which nothing can flow yet."""
    n_arcs = len(tails)
    first, place = np.zeros(n_nodes + 1, np.int32), np.empty(n_nodes, np.int32)
    ends, twins, left = np.empty(2 * n_arcs, np.int32), np.empty(2 * n_arcs, np.int32), np.empty(2 * n_arcs, np.int64)
    for arc in range(n_arcs):
        first[tails[arc] + 1] += 1
        first[heads[arc] + 1] += 1
    for node in range(n_nodes):
        first[node + 1] += first[node]
        place[node] = first[node]
    for arc in range(n_arcs):
        tail, head = tails[arc], heads[arc]
        there, back = place[tail], place[head]
        ends[there], twins[there], left[there] = head, back, capacities[arc]
        ends[back], twins[back], left[back] = tail, there, 0
        place[tail] += 1
        place[head] += 1
    return Arcs(first, ends, twins, left)


@part
def find_levels(source, sink, arcs, level, queue):
    """Set how many arcs with something left lead from the source to each node, -1 where none do; tell whether one is the sink.

    What lies no nearer than the sink, once that is found, is of no use and may be left out.
    """
    first, ends, left = arcs.first, arcs.ends, arcs.left
    for node in range(len(level)):
        level[node] = -1
    level[source], queue[0] = 0, source
    n_met, n_seen = 1, 0
    while n_seen < n_met:
        node = queue[n_seen]
        n_seen += 1
        for arc in range(first[node], first[node + 1]):
            end = ends[arc]
            if left[arc] > 0 and level[end] < 0:
                level[end] = level[node] + 1
                if end == sink:
                    return True
                queue[n_met] = end
                n_met += 1
    return False


@part
def fill_level_paths(source, sink, arcs, level, following, path):
    """Send as much as there is room for along paths that go up one level with every arc.

    following: the first arc of each node that may still lead on; path: room for the arcs of a path.
    """
    first, ends, twins, left = arcs.first, arcs.ends, arcs.twins, arcs.left
    node, length = source, 0
    while True:
        if node == sink:
            length = send(twins, left, path, length)
            node = ends[twins[path[length]]]
        elif following[node] < first[node + 1]:
            arc = following[node]
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
            node = ends[twins[path[length]]]
            following[node] += 1


@part
def send(twins, left, path, length):
    """Send what a path has room for; return how much of the path still has some."""
    least = left[path[0]]
    for place in range(1, length):
        least = min(least, left[path[place]])
    remains = length
    for place in range(length - 1, -1, -1):
        left[path[place]] -= least
        left[twins[path[place]]] += least
        if left[path[place]] == 0:
            remains = place
    return remains
