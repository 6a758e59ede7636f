"""The 3-dimensional generalized map of a tetrahedral mesh: darts, involutions, cells' numbers. It knows no physics.

Darts are implicit (see darts.py): dart = 24*tetrahedron + 6*face + k. Of the four involutions only alpha_3 is stored, as one
dart per face, so alpha_0 alpha_3 and alpha_1 alpha_3 are involutions by construction. Source: Lienhardt, "N-dimensional
generalized combinatorial maps", 1994; the implicit layout is ours.
"""

from typing import NamedTuple

import numpy as np

from gmapspring.errors import TopologyError
from gmapspring.jit import part
from gmapspring.topology.darts import ACROSS, ALPHA, DARTS_PER_TETRAHEDRON, FACE_EDGES

N_VERTICES, N_EDGES, N_TETRAHEDRA, N_LABELS, STAMP = range(5)
"""Places in GMap.counts."""
EDGES, FACES, TETRAHEDRA = range(3)
"""Columns of GMap.link."""
VERTEX, EDGE = np.int64(0), np.int64(1)
"""Dimensions of the cells whose numbers are stored; as numpy integers, since numba compiles anew for each plain literal."""
NO_DART = np.int64(2**31 - 1)
"""Above every dart: the lowest dart of a cell that has none."""
TWO, THREE, SIX, TWENTY_FOUR = np.uint64(2), np.uint64(3), np.uint64(6), np.uint64(24)
"""With unsigned numbers, kernels divide and index faster."""


class GMap(NamedTuple):
    """Arrays of the map for n tetrahedra; the tables of vertices and edges have room for 4n and 6n rows, all there can be."""

    image: np.ndarray
    """Dart that alpha_3 gives for the k = 0 dart of each face; that dart itself where the face is free, int32 (n, 4)."""
    vertex_of: np.ndarray
    """Vertex of each corner, -1 where the tetrahedron is removed, int32 (n, 4)."""
    edge_of: np.ndarray
    """Edge of each local edge (01 02 03 12 13 23), -1 where removed, int32 (n, 6)."""
    component_of: np.ndarray
    """Label of the component, -1 where removed: a tetrahedron is alive exactly if this is not negative, int32 (n,)."""
    vertex_dart: np.ndarray
    """Lowest dart of each vertex, int32 (4n,)."""
    edge_dart: np.ndarray
    """Lowest dart of each edge, int32 (6n,)."""
    link: np.ndarray
    """Edges, faces and tetrahedra around each vertex, int32 (4n, 3)."""
    counts: np.ndarray
    """Live vertices, live edges, live tetrahedra, labels given so far, last stamp, int64 (5,)."""
    mark: np.ndarray
    """Scratch: the stamp of the walk that last came by, int32 (n,)."""
    queue: np.ndarray
    """Scratch: the cells that a walk has met, int32 (n,)."""


@part
def neighbour(image, tetrahedron, face):
    """Return the slot 4*tetrahedron + face on the other side of a face; the face's own slot where it is free."""
    # Unsigned numbers are divided, and used as indices, in fewer instructions.
    return np.int64(np.uint64(image[np.uint64(tetrahedron), np.uint64(face)]) // SIX)


@part
def alpha3(image, dart):
    """Return alpha_3 of one dart: the stored image of k = 0, turned on by k."""
    slot = np.uint64(dart) // SIX
    first = np.uint64(image[slot >> TWO, slot & THREE])
    there = first // TWENTY_FOUR
    return np.int64(there * TWENTY_FOUR) + ACROSS[first - there * TWENTY_FOUR, np.uint64(dart) - slot * SIX]


@part
def link_faces(image, dart, other):
    """Link two free faces so that alpha_3 exchanges the two darts: both entries of the map at once."""
    k = dart % 6
    turned = other % 6
    k0 = (turned - k) % 6 if (turned - k) % 2 == 0 else (turned + k) % 6
    slot = dart // 6
    beyond = other // 6
    image[slot >> 2, slot & 3] = 6 * beyond + k0
    # An even k0 turns the face on, hence back on the other side; an odd one turns it over, which is its own inverse.
    image[beyond >> 2, beyond & 3] = 6 * slot + ((6 - k0) % 6 if k0 % 2 == 0 else k0)


@part
def unlink_face(image, slot):
    """Make a face free on both sides and return the slot of the other side."""
    other = np.int64(image[slot >> 2, slot & 3]) // 6
    image[slot >> 2, slot & 3] = 6 * slot
    image[other >> 2, other & 3] = 6 * other
    return other


def check_sewable(gmap: GMap, dart: int, other: int) -> None:
    """Raise TopologyError unless the faces of two darts are free, alive, and not the same."""
    refusal = f"cannot 3-sew darts {dart} and {other}: "
    for each in (dart, other):
        if alpha(gmap, 3, each) != each:
            raise TopologyError(f"{refusal}dart {each} is not 3-free")
        if gmap.component_of[each // 24] < 0:
            raise TopologyError(f"{refusal}tetrahedron {each // 24} is removed")
    if dart // 6 == other // 6:
        raise TopologyError(f"{refusal}they belong to one face")


def alpha(gmap: GMap, i: int, dart):
    """Return alpha_i of one dart or of an array of darts."""
    darts = np.asarray(dart, dtype=np.int64)
    n_darts = DARTS_PER_TETRAHEDRON * len(gmap.image)
    if i not in (0, 1, 2, 3):
        raise TopologyError(f"alpha_{i} does not exist: a 3-g-map has alpha_0 to alpha_3")
    if darts.size and (darts.min() < 0 or darts.max() >= n_darts):
        raise TopologyError(f"dart {darts.max() if darts.max() >= n_darts else darts.min()} is out of range 0..{n_darts - 1}")
    if i < 3:
        image = darts // 24 * 24 + ALPHA[i][darts % 24]
    else:
        k = darts % 6
        first = gmap.image.reshape(-1)[darts // 6].astype(np.int64)
        k0 = first % 6
        image = first // 6 * 6 + np.where(k0 % 2 == 0, k0 + k, k0 - k) % 6
    return int(image) if image.ndim == 0 else image


def orbit(gmap: GMap, dart: int, involutions: tuple[int, ...]) -> np.ndarray:
    """List the darts that the named involutions lead to from one dart, ascending.

    Vertex (1, 2, 3), edge (0, 2, 3), face (0, 1, 3), volume (0, 1, 2), component (0, 1, 2, 3).
    """
    found, waiting = {int(dart)}, [int(dart)]
    while waiting:
        here = waiting.pop()
        reached = {alpha(gmap, i, here) for i in involutions} - found
        found |= reached
        waiting.extend(reached)
    return np.array(sorted(found), dtype=np.int64)


def is_alive(gmap: GMap) -> np.ndarray:
    """Tell which tetrahedra are not removed, bool (n,)."""
    return gmap.component_of >= 0


def is_free(gmap: GMap) -> np.ndarray:
    """Tell which faces have no other side, bool (n, 4); the faces of removed tetrahedra are free too."""
    slots = np.arange(gmap.image.size, dtype=np.int64).reshape(-1, 4)
    return gmap.image // 6 == slots


def face_of(gmap: GMap) -> np.ndarray:
    """Number the faces: the lower of the slots 4*tetrahedron + face of their sides, -1 where removed, int32 (n, 4).

    A number is stable: it changes only if the face is split (its upper side becomes a face of its own) or sewn again.
    """
    slots = np.arange(gmap.image.size, dtype=np.int32).reshape(-1, 4)
    return np.where(is_alive(gmap)[:, None], np.minimum(slots, gmap.image // 6), -1).astype(np.int32)


def boundary_faces(gmap: GMap) -> np.ndarray:
    """List the free faces of live tetrahedra as (tetrahedron, face), int64 (k, 2)."""
    return np.argwhere(is_free(gmap) & is_alive(gmap)[:, None])


def boundary_edges(gmap: GMap) -> np.ndarray:
    """List the edges on the boundary, ascending."""
    faces = boundary_faces(gmap)
    return np.unique(gmap.edge_of[faces[:, :1], FACE_EDGES[faces[:, 1]]])


def boundary_vertices(gmap: GMap) -> np.ndarray:
    """List the vertices on the boundary, ascending; by counting: a closed link has 3 tetrahedra to every 2 faces."""
    link = gmap.link[: gmap.counts[N_VERTICES]]
    return np.flatnonzero(2 * link[:, FACES] > 3 * link[:, TETRAHEDRA])


def link_characteristic(gmap: GMap) -> np.ndarray:
    """Return the Euler characteristic of the link of each vertex: edges - faces + tetrahedra around it, (n_vertices,)."""
    link = gmap.link[: gmap.counts[N_VERTICES]]
    return link[:, EDGES] - link[:, FACES] + link[:, TETRAHEDRA]


def singular_vertices(gmap: GMap) -> np.ndarray:
    """List the vertices whose link is neither a sphere nor a disc: the body is pinched there."""
    expected = np.full(gmap.counts[N_VERTICES], 2)
    expected[boundary_vertices(gmap)] = 1
    return np.flatnonzero(link_characteristic(gmap) != expected)


def components(gmap: GMap) -> np.ndarray:
    """Label the components 0, 1, ... in the order of their lowest tetrahedron, -1 where removed, int32 (n,)."""
    labels = gmap.component_of
    alive = np.flatnonzero(labels >= 0)
    found, first, place = np.unique(labels[alive], return_index=True, return_inverse=True)
    rank = np.empty(len(found), dtype=np.int32)
    rank[np.argsort(first)] = np.arange(len(found), dtype=np.int32)
    result = np.full(len(labels), -1, dtype=np.int32)
    result[alive] = rank[place]
    return result
