"""Building the map of a tetrahedral mesh: glue the faces, then number vertices, edges and components."""

import numpy as np

from gmapspring.addresses import address_row, struct_reader
from gmapspring.jit import kernel, part
from gmapspring.topology.cells import recount_link
from gmapspring.topology.darts import CORNER_OF_DART, FACE_CORNERS
from gmapspring.topology.gmap import EDGE, N_EDGES, N_LABELS, N_TETRAHEDRA, N_VERTICES, NO_DART, VERTEX, GMap, link_faces
from gmapspring.topology.walks import lowest_dart, walk_component, walk_edge, walk_vertex


def empty_gmap(n_tetrahedra: int) -> GMap:
    """Make the arrays of a map, every face free and no cell numbered; untouched rows cost no memory until used."""
    n = n_tetrahedra
    slots = np.arange(4 * n, dtype=np.int32).reshape(n, 4)
    return GMap(
        image=6 * slots,
        vertex_of=np.full((n, 4), -1, dtype=np.int32),
        edge_of=np.full((n, 6), -1, dtype=np.int32),
        component_of=np.full(n, -1, dtype=np.int32),
        vertex_dart=np.zeros(4 * n, dtype=np.int32),
        edge_dart=np.zeros(6 * n, dtype=np.int32),
        link=np.zeros((4 * n, 3), dtype=np.int32),
        counts=np.zeros(5, dtype=np.int64),
        mark=np.zeros(n, dtype=np.int32),
        queue=np.zeros(n, dtype=np.int32),
    )


def build_gmap(tetrahedra: np.ndarray, n_points: int) -> GMap:
    """Build the map of positively oriented tetrahedra, int (n, 4), gluing those that share three points.

    Vertex numbers are the points' own; where the tetrahedra at a point are not connected through faces, the point becomes several
    vertices, the further ones numbered from n_points on. Edges are numbered as tetrahedra meet them.
    """
    gmap = empty_gmap(len(tetrahedra))
    corners = np.ascontiguousarray(tetrahedra, dtype=np.int64)
    glue_faces(gmap.image, corners, n_points)
    number_cells(address_row(gmap)[None], 0, ANY, corners, n_points)
    return gmap


read_gmap = struct_reader(lambda dtype: empty_gmap(0))
"""read_gmap(table, row, real) -> GMap, for kernels; see addresses.py."""
ANY = np.float64(0)
"""A map holds whole numbers: it is read in whatever precision."""


@kernel
def glue_faces(image, corners, n_points):
    """Link every pair of faces on the same three points; faces are sorted into buckets by the rarest of their points.

    Any of the three would do, but thousands of tetrahedra may meet at a point, and the faces of a bucket are compared in pairs.
    """
    n_slots = 4 * len(corners)
    degree = np.zeros(n_points, dtype=np.int64)
    for tetrahedron in range(len(corners)):
        for corner in range(4):
            degree[corners[tetrahedron, corner]] += 1
    start = np.zeros(n_points + 1, dtype=np.int64)
    rarest = np.empty(n_slots, dtype=np.int64)
    for slot in range(n_slots):
        rarest[slot] = rarest_point(corners, slot, degree)
        start[rarest[slot] + 1] += 1
    fill = np.zeros(n_points, dtype=np.int64)
    for point in range(n_points):
        fill[point] = start[point]
        start[point + 1] += start[point]
    bucket = np.empty(n_slots, dtype=np.int64)
    for slot in range(n_slots):
        bucket[fill[rarest[slot]]] = slot
        fill[rarest[slot]] += 1
    for point in range(n_points):
        for i in range(start[point], start[point + 1]):
            for j in range(i + 1, start[point + 1]):
                if glue_if_same(image, corners, bucket[i], bucket[j]):
                    break


@part
def rarest_point(corners, slot, degree):
    """Return the point of a face at which the fewest tetrahedra meet; the lowest of several."""
    rarest = corners[slot >> 2, FACE_CORNERS[slot & 3, 0]]
    for i in range(1, 3):
        point = corners[slot >> 2, FACE_CORNERS[slot & 3, i]]
        if degree[point] < degree[rarest] or (degree[point] == degree[rarest] and point < rarest):
            rarest = point
    return rarest


@part
def glue_if_same(image, corners, slot, other):
    """Link two faces if they lie on the same three points; tell whether they do."""
    face = FACE_CORNERS[slot & 3]
    a = corners[slot >> 2, face[0]]
    b = corners[slot >> 2, face[1]]
    c = corners[slot >> 2, face[2]]
    for corner in FACE_CORNERS[other & 3]:
        point = corners[other >> 2, corner]
        if point != a and point != b and point != c:
            return False
    for k in range(6):
        # alpha_0 exchanges k and k^1: the two ends of the first edge.
        start = corners[other >> 2, CORNER_OF_DART[6 * (other & 3) + k]]
        end = corners[other >> 2, CORNER_OF_DART[6 * (other & 3) + (k ^ 1)]]
        if start == a and end == b:
            link_faces(image, 6 * slot, 6 * other + k)
    return True


@kernel
def number_cells(table, row, real, corners, n_points):
    """Number vertices, edges and components and count the links, from the gluings alone."""
    gmap = read_gmap(table, row, real)
    gmap.vertex_dart[:n_points] = NO_DART
    gmap.counts[N_VERTICES] = n_points
    gmap.counts[N_TETRAHEDRA] = len(corners)
    for tetrahedron in range(len(corners)):
        for edge in range(6):
            if gmap.edge_of[tetrahedron, edge] < 0:
                number_edge(gmap, 6 * tetrahedron + edge)
        if gmap.component_of[tetrahedron] < 0:
            for member in gmap.queue[: walk_component(gmap, tetrahedron, gmap.queue)]:
                gmap.component_of[member] = gmap.counts[N_LABELS]
            gmap.counts[N_LABELS] += 1
    for tetrahedron in range(len(corners)):
        for corner in range(4):
            if gmap.vertex_of[tetrahedron, corner] < 0:
                number_vertex(gmap, 4 * tetrahedron + corner, corners[tetrahedron, corner])


@part
def number_edge(gmap, code):
    """Give the next number to the edge that begins at a code 6*tetrahedron + edge."""
    number = gmap.counts[N_EDGES]
    gmap.counts[N_EDGES] += 1
    gmap.edge_dart[number] = lowest_dart(EDGE, code)
    for member in gmap.queue[: walk_edge(gmap, code // 6, code % 6, gmap.queue)]:
        gmap.edge_of[member // 6, member % 6] = number


@part
def number_vertex(gmap, code, point):
    """Give the vertex that begins at a code 4*tetrahedron + corner the number of its point, or the next one if that is taken."""
    number = point
    if gmap.vertex_dart[number] != NO_DART:
        number = gmap.counts[N_VERTICES]
        gmap.counts[N_VERTICES] += 1
    gmap.vertex_dart[number] = lowest_dart(VERTEX, code)
    n_members = walk_vertex(gmap, code >> 2, code & 3, gmap.queue)
    for member in gmap.queue[:n_members]:
        gmap.vertex_of[member >> 2, member & 3] = number
    recount_link(gmap, number, gmap.queue, np.int64(0), n_members)
