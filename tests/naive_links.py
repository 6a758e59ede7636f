"""Vertex links of a naive body, built as surfaces: which nodes are singular, told without the Euler characteristic."""

import itertools
from collections import defaultdict

import numpy as np

from tests.naive import EDGES, Forest


def links(body):
    """Return, per vertex cell (named by its lowest corner), its link: a list of triangles (three link vertices,
    each an edge cell, and three link edges, each a face cell)."""
    edges, faces, vertices = body.edge_labels(), body.face_labels(), body.vertex_labels()
    triangles_of = defaultdict(list)
    for tet, corner in itertools.product(sorted(body.alive), range(4)):
        others = [i for i in range(4) if i != corner]
        spokes = {i: int(edges[tet, EDGES.index(tuple(sorted((corner, i))))]) for i in others}
        sides = {int(faces[tet, f]): frozenset(spokes[i] for i in others if i != f) for f in others}
        triangles_of[divmod(int(vertices[tet, corner]), 4)].append((frozenset(spokes.values()), sides))
    return triangles_of


def link_counts(body):
    """Return, per corner (n, 4, 3), how many edges, faces and tetrahedra the star of its node has."""
    counts = np.full((body.n, 4, 3), -1)
    cells = body.vertex_cells()
    for corner, triangles in links(body).items():
        spokes = set().union(*(corners for corners, _ in triangles))
        sides = {side for _, edges in triangles for side in edges}
        for member in cells[corner]:
            counts[member] = len(spokes), len(sides), len(triangles)
    return counts


def singular_nodes(body):
    """Return the vertex cells, by lowest corner, whose link is neither a sphere nor a disc."""
    return {corner for corner, triangles in links(body).items() if not is_sphere_or_disc(triangles)}


def is_sphere_or_disc(triangles):
    """Tell whether a link is a sphere or a disc: after opening a closed one it collapses to a single point."""
    n_sides = defaultdict(int)
    for _, edges in triangles:
        for edge in edges:
            n_sides[edge] += 1
    assert set(n_sides.values()) <= {1, 2}, "three triangles of a link share an edge"
    graph = _collapse_triangles(triangles, n_sides)
    return graph is not None and _is_tree(graph)


def _collapse_triangles(triangles, n_sides):
    """Eat triangles through free edges; return the edges left (edge: its two ends), None if triangles are left."""
    left = dict(enumerate(edges for _, edges in triangles))
    around = defaultdict(set)
    for number, edges in left.items():
        for edge in edges:
            around[edge].add(number)
    graph = {edge: ends for edges in left.values() for edge, ends in edges.items()}
    free = [edge for edge, count in n_sides.items() if count == 1]
    if not free:  # closed: a sphere is what becomes a disc when one triangle is taken out
        free = _take_out(left, around, 0)
    while free:
        edge = free.pop()
        if around[edge]:
            (number,) = around[edge]
            free += [e for e in _take_out(left, around, number) if e != edge]
            del graph[edge]
    return None if left else graph


def _take_out(left, around, number):
    """Take a triangle out and return its edges that are free now."""
    edges = left.pop(number)
    for edge in edges:
        around[edge].discard(number)
    return [edge for edge in edges if len(around[edge]) == 1]


def _is_tree(graph):
    """Tell whether the edges (edge: its two ends) form one tree."""
    ends = set().union(*graph.values())
    forest = Forest(ends)
    for one, other in graph.values():
        if forest.find(one) == forest.find(other):
            return False
        forest.join(one, other)
    return len({forest.find(end) for end in ends}) == 1
