"""Checks of a whole body: every law of the map, every number and every sum, recomputed from the gluings alone."""

import numpy as np

from gmapspring.body import Body
from gmapspring.errors import TopologyError
from gmapspring.topology import gmap as topology
from gmapspring.topology.darts import (
    CORNER_OF_DART,
    EDGE_CORNERS,
    EDGE_OF_DART,
    FACE_CORNERS,
    IS_EVEN,
    LOWEST_DART_OF_CORNER,
    LOWEST_DART_OF_EDGE,
)
from gmapspring.topology.gmap import N_EDGES, N_TETRAHEDRA, N_VERTICES, GMap, alpha


def _require(good: np.ndarray, message: str) -> None:
    """Raise TopologyError with the first place at which something is not good."""
    bad = np.argwhere(~np.asarray(good))
    if len(bad):
        place = bad[0].tolist()
        raise TopologyError(f"invalid map: {message}, first at {place[0] if len(place) == 1 else place}")


def check_gmap(gmap: GMap) -> None:
    """Raise TopologyError, naming the culprit, unless the map is a valid 3-g-map whose numbers are true."""
    check_involutions(gmap)
    alive = topology.is_alive(gmap)
    if alive.sum() != gmap.counts[N_TETRAHEDRA]:
        raise TopologyError(f"invalid map: {alive.sum()} tetrahedra are alive, {gmap.counts[N_TETRAHEDRA]} are counted")
    for dimension, cell_of, dart_of, n_cells in (
        (0, gmap.vertex_of, gmap.vertex_dart, gmap.counts[N_VERTICES]),
        (1, gmap.edge_of, gmap.edge_dart, gmap.counts[N_EDGES]),
    ):
        check_cells(gmap, dimension, cell_of, dart_of[:n_cells])
    labels = _pieces(gmap, np.arange(24 * len(alive)) // 24, len(alive))
    _check_same_partition(np.where(alive, labels, -1), gmap.component_of, "components")
    check_links(gmap)


def check_involutions(gmap: GMap) -> None:
    """Check alpha_0 to alpha_3, that alpha_0 alpha_2, alpha_0 alpha_3 and alpha_1 alpha_3 are involutions, and the gluings."""
    darts = np.arange(24 * len(gmap.image))
    slots = np.arange(gmap.image.size).reshape(-1, 4)
    _require((gmap.image >= 0) & (gmap.image < 24 * len(gmap.image)), "an image is out of range")
    images = [alpha(gmap, i, darts) for i in range(4)]
    for i in range(4):
        _require(images[i][images[i]] == darts, f"alpha_{i} is not an involution")
    for i, j in ((0, 2), (0, 3), (1, 3)):
        both = images[i][images[j]]
        _require(both[both] == darts, f"alpha_{i} alpha_{j} is not an involution")
    free = topology.is_free(gmap)
    beyond = gmap.image // 24
    alive = topology.is_alive(gmap)
    _require(free | (alive[:, None] & alive[beyond]), "a removed tetrahedron is sewn")
    _require(free | (beyond != slots // 4), "a tetrahedron is sewn to itself")
    _require(free | (IS_EVEN[gmap.image % 24] != IS_EVEN[6 * slots % 24]), "a gluing turns a tetrahedron inside out")


def _pieces(gmap: GMap, item_of_dart: np.ndarray, n_items: int) -> np.ndarray:
    """Label the items (corners, local edges, tetrahedra) that alpha_3 joins, (n_items,)."""
    # Imported where it is used, as in `gmapspring.mesh`.
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    darts = np.arange(len(item_of_dart))
    across = item_of_dart[alpha(gmap, 3, darts)]
    graph = coo_array((np.ones(len(darts), bool), (item_of_dart, across)), shape=(n_items, n_items))
    return connected_components(graph, directed=False)[1]


def check_cells(gmap: GMap, dimension: int, cell_of: np.ndarray, dart_of: np.ndarray) -> None:
    """Check that numbers are equal along every orbit, that different orbits have different ones, and that none is unused."""
    name = ("vertex", "edge")[dimension]
    per = cell_of.shape[1]
    local = (CORNER_OF_DART, EDGE_OF_DART)[dimension]
    alive = topology.is_alive(gmap)
    _require((cell_of >= 0) == alive[:, None], f"a {name} number is missing, or left on a removed tetrahedron")
    _require(cell_of < len(dart_of), f"a {name} number is out of range")
    darts = np.arange(24 * len(alive))
    pieces = _pieces(gmap, darts // 24 * per + local[darts % 24], cell_of.size)
    _check_same_partition(np.where(np.repeat(alive, per), pieces, -1), cell_of.ravel(), f"{name} numbers")
    lowest = np.full(len(dart_of), 2**31 - 1)
    own = 24 * np.arange(len(alive))[:, None] + (LOWEST_DART_OF_CORNER, LOWEST_DART_OF_EDGE)[dimension]
    np.minimum.at(lowest, cell_of[alive], own[alive])
    _require(dart_of == lowest, f"the dart of a {name} is not its lowest")


def _check_same_partition(expected: np.ndarray, found: np.ndarray, name: str) -> None:
    """Check that two labelings of the same items are equal up to renumbering; -1 stands for none in both."""
    _require((expected < 0) == (found < 0), f"{name}: an item is in no set, or should not be")
    both = _pairs(expected[expected >= 0], found[expected >= 0])
    for labels, complaint in ((both[0], "one orbit bears two"), (both[1], "two orbits bear one")):
        _require(np.diff(np.sort(labels)) > 0, f"{name}: {complaint}")


def _pairs(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the different pairs among numbers that are not negative, in two arrays that are broadcast, int64 (2, k)."""
    # One number stands for a pair: to sort pairs themselves takes six times as long.
    width = int(second.max(initial=0)) + 1
    return np.stack(np.divmod(np.unique(first.astype(np.int64) * width + second), width))


def check_links(gmap: GMap) -> None:
    """Check the counts of edges, faces and tetrahedra around each vertex against a recount."""
    n_vertices = gmap.counts[N_VERTICES]
    alive = topology.is_alive(gmap)
    vertex_of = gmap.vertex_of[alive]
    n_tetrahedra = np.bincount(vertex_of.ravel(), minlength=n_vertices)
    face_of = topology.face_of(gmap)[alive]
    n_faces = np.bincount(_pairs(face_of[:, :, None], vertex_of[:, FACE_CORNERS])[1], minlength=n_vertices)
    n_edges = np.bincount(_pairs(gmap.edge_of[alive][:, :, None], vertex_of[:, EDGE_CORNERS])[1], minlength=n_vertices)
    _require(gmap.link[:n_vertices] == np.stack([n_edges, n_faces, n_tetrahedra], axis=1),
             "a counter around a vertex differs from a recount (vertex; edges, faces, tetrahedra)")


def check_body(body: Body) -> None:
    """Raise TopologyError unless the map is valid and every sum over a cell equals the sum over its tetrahedra."""
    check_gmap(body.gmap)
    alive = body.is_alive
    nodes, springs, own = body.nodes, body.springs, body.tetrahedra
    corners, edges = body.vertex_of[alive], body.edge_of[alive]

    def close(name: str, found: np.ndarray, values: np.ndarray, cells: np.ndarray, scale=1.0) -> None:
        per = cells.shape[1]
        expected = scale * np.bincount(cells.ravel(), np.repeat(values[alive], per), len(found))
        tolerance = 8 * np.finfo(found.dtype).eps
        _require(np.abs(found - expected) <= tolerance * expected, f"{name} is not the sum over the tetrahedra")

    close("the mass of a node", nodes.mass, own.mass, corners, 0.25)
    _require(nodes.inverse_mass == np.where(nodes.is_pinned, 0.0, 1.0 / nodes.mass).astype(nodes.inverse_mass.dtype),
             "an inverse mass does not fit mass and pinning")
    length_squared = springs.rest_length.astype(np.float64) ** 2
    close("the stiffness of a spring", springs.stiffness, own.modulus, edges, 1.0 / length_squared)
    if len(own.viscosity):
        close("the drag of a node", nodes.viscosity, own.viscosity, corners, 0.25)
    if len(own.damping_modulus):
        close("the damping of a spring", springs.damping, own.damping_modulus, edges, 1.0 / length_squared)
    _require(nodes.point[corners] == body.mesh.tetrahedra[alive], "a node stems from another point than its corners")
    expected = np.sort(corners[:, EDGE_CORNERS], axis=2)
    _require(np.sort(springs.endpoints[edges], axis=2) == expected, "a spring ends at other nodes than its edge")
    points = body.mesh.points[body.mesh.tetrahedra][alive][:, EDGE_CORNERS]
    rest = np.linalg.norm(points[:, :, 0] - points[:, :, 1], axis=2)
    tolerance = 8 * np.finfo(springs.rest_length.dtype).eps
    _require(np.abs(springs.rest_length[edges] - rest) <= tolerance * rest, "a rest length is not that of the mesh")
