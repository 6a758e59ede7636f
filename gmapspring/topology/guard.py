"""The optional guard that keeps a manifold body manifold: it refuses a cut that would pinch a vertex.

A corner on the boundary must have a boundary edge among the edges of the cut there; without one, the cut would open a second
hole in the corner's link, a disc would become an annulus, and the body would hang together at a point. A suture is judged by
the counts it would leave: edges - faces + tetrahedra around a vertex is 1 for a disc, 2 for a sphere. Of many cuts at once none
can be judged beforehand: what they left is compared with what was.
"""

import numpy as np

from gmapspring.errors import TopologyError
from gmapspring.jit import kernel, part
from gmapspring.topology.darts import CORNER_EDGES, CORNER_OF_DART, DARTS_AT_EDGE, EDGE_CORNERS
from gmapspring.topology.gmap import (
    EDGE,
    EDGES,
    FACES,
    N_VERTICES,
    TETRAHEDRA,
    VERTEX,
    GMap,
    alpha3,
    link_characteristic,
    link_faces,
    neighbour,
    singular_vertices,
    unlink_face,
)  # fmt: skip
from gmapspring.topology.walks import code_of_dart, walk_edge


@part
def is_boundary_edge(gmap, tetrahedron, edge):
    """Tell whether an edge is on the boundary: the walk round it meets a free face."""
    for member in gmap.queue[: walk_edge(gmap, tetrahedron, edge, gmap.queue)]:
        here = member // 6
        for way in range(2):
            slot = 4 * here + DARTS_AT_EDGE[member % 6, way] // 6
            if neighbour(gmap.image, slot >> 2, slot & 3) == slot:
                return True
    return False


@kernel
def pinched_corner(gmap, tetrahedron, face):
    """Return the corner that cutting a face (or removing the tetrahedron, face -1) would pinch, -1 for none."""
    for corner in range(4):
        vertex = gmap.vertex_of[tetrahedron, corner]
        if corner == face or 2 * gmap.link[vertex, FACES] <= 3 * gmap.link[vertex, TETRAHEDRA]:
            continue
        is_held = True
        for edge in CORNER_EDGES[corner]:
            if face != EDGE_CORNERS[edge, 0] and face != EDGE_CORNERS[edge, 1] and is_boundary_edge(gmap, tetrahedron, edge):
                is_held = False
        if is_held:
            return corner
    return -1


def check_stays_manifold(gmap: GMap, tetrahedron: int, face: int) -> None:
    """Raise TopologyError if cutting a face (or removing the tetrahedron, face -1) would pinch the body."""
    corner = pinched_corner(gmap, tetrahedron, face)
    if corner >= 0:
        what = f"removing tetrahedron {tetrahedron}" if face < 0 else f"cutting face {face} of tetrahedron {tetrahedron}"
        raise TopologyError(
            f"{what} would pinch the body at node {gmap.vertex_of[tetrahedron, corner]}: "
            "cut an edge of it open to the surface first, or allow singular nodes with keep_manifold=False"
        )


def excess_holes(gmap: GMap) -> np.ndarray:
    """Return how many holes the link of each vertex has that a sphere or a disc has not, int64 (n_vertices,)."""
    excess = np.zeros(gmap.counts[N_VERTICES], dtype=np.int64)
    singular = singular_vertices(gmap)
    excess[singular] = 1 - link_characteristic(gmap)[singular]
    return excess


def vertices_more_pinched(gmap: GMap, vertex_of: np.ndarray, holes: np.ndarray) -> np.ndarray:
    """List the vertices of before a cut of which all that stems from them has more excess holes than they had, (k,).

    vertex_of (n_tets, 4) and holes (n,): what they were before.
    """
    tetrahedra, local_darts = np.divmod(gmap.vertex_dart[: gmap.counts[N_VERTICES]], 24)
    stems_from = vertex_of[tetrahedra, CORNER_OF_DART[local_darts]]
    return np.flatnonzero(np.bincount(stems_from, excess_holes(gmap), len(holes)) > holes)


@kernel
def vertex_pinched_by_sewing(gmap, dart, other):
    """Return the vertex that sewing two faces would make singular, -1 for none: the counts around it are known beforehand."""
    link_faces(gmap.image, dart, other)
    pinched = np.int64(-1)
    for k in range(0, 6, 2):
        here = dart // 6 * 6 + k
        across = alpha3(gmap.image, here)
        vertex, beyond = cell_of_dart(gmap, VERTEX, here), cell_of_dart(gmap, VERTEX, across)
        n_edges, n_faces, n_tetrahedra = gmap.link[vertex, EDGES], gmap.link[vertex, FACES] - 1, gmap.link[vertex, TETRAHEDRA]
        if vertex != beyond:
            n_edges += gmap.link[beyond, EDGES]
            n_faces += gmap.link[beyond, FACES]
            n_tetrahedra += gmap.link[beyond, TETRAHEDRA]
        # The two edges of the face at this corner: those of the dart and of alpha_1 of it.
        for along in (here, dart // 6 * 6 + (k + 5) % 6):
            if cell_of_dart(gmap, EDGE, along) != cell_of_dart(gmap, EDGE, alpha3(gmap.image, along)):
                n_edges -= 1
        expected = 1 if 2 * n_faces > 3 * n_tetrahedra else 2
        if n_edges - n_faces + n_tetrahedra != expected:
            pinched = vertex
    unlink_face(gmap.image, dart // 6)
    return pinched


@part
def cell_of_dart(gmap, dimension, dart):
    """Return the number of the vertex (dimension 0) or edge (1) of a dart."""
    code = code_of_dart(dimension, dart)
    if dimension == VERTEX:
        return np.int64(gmap.vertex_of[code >> 2, code & 3])
    return np.int64(gmap.edge_of[code // 6, code % 6])


def check_sewing_stays_manifold(gmap: GMap, dart: int, other: int) -> None:
    """Raise TopologyError if sewing the free faces of two darts would pinch the body."""
    vertex = vertex_pinched_by_sewing(gmap, dart, other)
    if vertex >= 0:
        raise TopologyError(
            f"sewing tetrahedra {dart // 24} and {other // 24} would pinch the body at node {vertex}: "
            "sew a face beside it first, or allow singular nodes with keep_manifold=False"
        )
