r"""Cutting and sewing: the operations that change map and mechanics together.

    split_face(a, b)                          remove_tetrahedron(a)

       /|\              /|  |\                   /|\                 |\
      / | \            / |  | \                 / | \                | \
     /a | b\    ->    /a |  | b\               /a | b\      ->       | b\
     \  |  /          \  |  |  /               \  |  /               |  /
      \ | /            \ |  | /                 \ | /                | /
       \|/              \|  |/                   \|/                 |/

sew_face(a, b) goes from right to left, for a face that the mesh had: a suture, or an undo.

A face is unlinked (3-unsewn); its edges and corners split where nothing else holds them together, and masses, drag and stiffness
are shared anew. Source of the operations: Meseure, Darles, Skapin, "A Topology-Based Mass/Spring System", CASA 2010.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from gmapspring.body import Body
from gmapspring.embedding import embed, merge_nodes
from gmapspring.errors import TopologyError
from gmapspring.jit import kernel
from gmapspring.snapshot import load_arrays, save_arrays
from gmapspring.topology.gmap import check_sewable
from gmapspring.topology.guard import check_sewing_stays_manifold, check_stays_manifold
from gmapspring.topology.sewing import face_gluing, sew_faces, unsew_faces

NONE = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class CutReport:
    """What one operation changed. Numbers are those after it, except the first of each move.

    To follow with arrays of your own over nodes: apply the moves (to <- from), then copy each kept row to its new one.
    """

    new_nodes: np.ndarray
    """(kept, new): nodes that a vertex split made, and the nodes they stem from, (k, 2)."""
    new_springs: np.ndarray
    """(kept, new): the same for springs, (k, 2)."""
    boundary_faces: np.ndarray
    """(tetrahedron, face) of faces of live tetrahedra that became free, (k, 2)."""
    removed_tetrahedra: np.ndarray
    """Tetrahedra that are gone, (k,)."""
    n_removed_nodes: int
    """How many nodes are gone; on a suture, those that were merged into others."""
    n_removed_springs: int
    """How many springs are gone."""
    moved_nodes: np.ndarray
    """(from, to): nodes that were there before and got another number, (k, 2)."""
    moved_springs: np.ndarray
    """(from, to): the same for springs, (k, 2)."""
    new_components: np.ndarray
    """Labels of the pieces that came off, (k,)."""


def split_face(body: Body, tet_a: int, tet_b: int, keep_manifold: bool = False) -> CutReport:
    """Cut the face between two tetrahedra; raise TopologyError, with nothing changed, where they share none."""
    slot = face_slot(body, tet_a, tet_b)
    if keep_manifold:
        check_stays_manifold(body.gmap, slot // 4, slot % 4)
    return _report(NONE, cut_kernel(body.gmap, body.matter, np.array([slot]), NONE))


def remove_tetrahedron(body: Body, tetrahedron: int, keep_manifold: bool = False) -> CutReport:
    """Isolate a tetrahedron by cutting its faces, then delete it."""
    tetrahedron = live_tetrahedron(body, tetrahedron)
    if keep_manifold:
        check_stays_manifold(body.gmap, tetrahedron, -1)
    removed = np.array([tetrahedron])
    return _report(removed, cut_kernel(body.gmap, body.matter, NONE, removed))


def cut(body: Body, faces: Iterable = (), tetrahedra: Iterable = (), keep_manifold: bool = False) -> CutReport:
    """Cut a set of faces, given as (k, 2) pairs of tetrahedra, and remove a set of tetrahedra, at once.

    Everything is unlinked first and the splits are settled once, so the result depends on the set alone, not on its order.
    Raises TopologyError, naming the culprit and with nothing changed, for a face or tetrahedron that is not there to cut
    or, with keep_manifold, that would pinch the body.
    """
    slots = face_slots(body, faces)
    removed = live_tetrahedra(body, tetrahedra)
    if keep_manifold:
        return _cut_one_by_one(body, slots, removed)
    return _report(removed, cut_kernel(body.gmap, body.matter, slots, removed))


def sew_face(body: Body, tet_a: int, tet_b: int, keep_manifold: bool = False) -> CutReport:
    """Sew the face that two tetrahedra shared in the uncut mesh: the suture, or the undoing, of split_face.

    Nodes that become one take the mean of position and velocity, weighted by mass, so momentum is conserved; one that is
    pinned holds the other. Raises TopologyError, with nothing changed, where there is no such face to sew or, with
    keep_manifold, where that would pinch the body.
    """
    tet_a, tet_b = live_tetrahedron(body, tet_a), live_tetrahedron(body, tet_b)
    dart_a, dart_b = face_gluing(body.mesh.tetrahedra, tet_a, tet_b)
    check_sewable(body.gmap, dart_a, dart_b)
    if keep_manifold:
        check_sewing_stays_manifold(body.gmap, dart_a, dart_b)
    return _report(NONE, sew_kernel(body.gmap, body.matter, dart_a, dart_b))


def face_slot(body: Body, tet_a: int, tet_b: int) -> int:
    """Return the lower slot 4*tetrahedron + face of the face between two tetrahedra; raise TopologyError where there is none."""
    tet_a, tet_b = live_tetrahedron(body, tet_a), live_tetrahedron(body, tet_b)
    for slot in range(4 * tet_a, 4 * tet_a + 4):
        beyond = body.gmap.image.item(slot) // 6
        if beyond >> 2 == tet_b and tet_a != tet_b:
            return min(slot, beyond)
    face_gluing(body.mesh.tetrahedra, tet_a, tet_b)
    raise TopologyError(f"the face between tetrahedra {tet_a} and {tet_b} is cut already; sew_face would sew it again")


def live_tetrahedron(body: Body, tetrahedron: int) -> int:
    """Return a tetrahedron's number; raise TopologyError for what is not a whole number, out of range, or removed."""
    if isinstance(tetrahedron, bool) or not isinstance(tetrahedron, int | np.integer):
        raise TopologyError(f"a tetrahedron is named by a whole number, not by {tetrahedron!r}")
    size = len(body.gmap.component_of)
    if not 0 <= tetrahedron < size:
        raise TopologyError(f"tetrahedron {tetrahedron} is out of range: the mesh has tetrahedra 0 to {size - 1}")
    if body.gmap.component_of.item(tetrahedron) < 0:
        raise TopologyError(f"tetrahedron {tetrahedron} is removed already; body.is_alive tells which are left")
    return int(tetrahedron)


def face_slots(body: Body, faces: Iterable) -> np.ndarray:
    """Return the slots of faces given as pairs of tetrahedra, ascending and each once; see face_slot."""
    pairs = _listed(faces, "faces")
    for pair in pairs:
        if not isinstance(pair, list | tuple | np.ndarray) or len(pair) != 2:
            raise TopologyError(f"faces must be pairs of tetrahedra, shape (k, 2); {pair!r} is not a pair")
    return np.array(sorted({face_slot(body, a, b) for a, b in pairs}), dtype=np.int64)


def live_tetrahedra(body: Body, tetrahedra: Iterable) -> np.ndarray:
    """Return numbers of live tetrahedra, ascending and each once; see live_tetrahedron."""
    return np.array(sorted({live_tetrahedron(body, each) for each in _listed(tetrahedra, "tetrahedra")}), dtype=np.int64)


def _listed(values: Iterable, name: str) -> list:
    """Return what an array or any iterable holds, as a list."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, Iterable):
        raise TopologyError(f"{name} must be a list or an array, not {values!r}")
    return list(values)


def _cut_one_by_one(body: Body, slots: np.ndarray, removed: np.ndarray) -> CutReport:
    """Cut in ascending order, checking each time that the body stays manifold; undo all if it would not."""
    before = save_arrays(body)
    try:
        for slot in slots:
            check_stays_manifold(body.gmap, slot // 4, slot % 4)
            cut_kernel(body.gmap, body.matter, np.array([slot]), removed[:0])
        for tetrahedron in removed:
            check_stays_manifold(body.gmap, tetrahedron, -1)
            cut_kernel(body.gmap, body.matter, slots[:0], np.array([tetrahedron]))
    finally:
        load_arrays(body, before)
    return _report(removed, cut_kernel(body.gmap, body.matter, slots, removed))


def _report(removed: np.ndarray, journal: np.ndarray) -> CutReport:
    """Read what a kernel wrote down."""
    n_removed_nodes, n_removed_springs, *sizes = journal[:8].tolist()
    ends = list(accumulate(sizes, initial=8))
    parts = [journal[start:end] for start, end in pairwise(ends)]
    opened = parts[4]
    return CutReport(
        new_nodes=parts[0].reshape(-1, 2),
        new_springs=parts[1].reshape(-1, 2),
        boundary_faces=np.stack((opened >> 2, opened & 3), axis=1),
        removed_tetrahedra=removed,
        n_removed_nodes=n_removed_nodes,
        n_removed_springs=n_removed_springs,
        moved_nodes=parts[2].reshape(-1, 2),
        moved_springs=parts[3].reshape(-1, 2),
        new_components=parts[5],
    )


@kernel
def cut_kernel(gmap, matter, slots, removed):
    """Cut the map, then bring the mechanics in line; in the time of the stars touched, whatever the body's size."""
    change = unsew_faces(gmap, slots, removed)
    embed(gmap, matter, change.vertices, change.edges)
    return write_journal(change)


@kernel
def sew_kernel(gmap, matter, dart_a, dart_b):
    """Sew the map, merge the nodes that became one, then bring the mechanics in line."""
    change, merged = sew_faces(gmap, dart_a, dart_b)
    for i in range(len(merged)):
        merge_nodes(matter.nodes, merged[i, 0], merged[i, 1])
    embed(gmap, matter, change.vertices, change.edges)
    return write_journal(change)


@kernel
def write_journal(change):
    """Write a change into one array, since each array that a kernel returns costs microseconds: sizes first, then all parts."""
    vertices, edges = change.vertices, change.edges
    parts = (
        vertices.final_copied.reshape(-1), edges.final_copied.reshape(-1),
        vertices.final_moved.reshape(-1), edges.final_moved.reshape(-1),
        change.opened, change.labels,
    )  # fmt: skip
    size = 8
    for part in parts:
        size += len(part)
    journal = np.empty(size, dtype=np.int64)
    journal[0] = vertices.n_dead
    journal[1] = edges.n_dead
    end = 8
    for i in range(6):
        journal[2 + i] = len(parts[i])
        for value in parts[i]:
            journal[end] = value
            end += 1
    return journal
