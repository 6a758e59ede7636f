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

import numpy as np

from gmapspring.body import Body, read_body
from gmapspring.embedding import embed, merge_nodes
from gmapspring.errors import TopologyError
from gmapspring.jit import inlined_part, kernel, part
from gmapspring.snapshot import load_arrays, save_arrays
from gmapspring.topology.gmap import check_sewable, neighbour
from gmapspring.topology.guard import check_sewing_stays_manifold, check_stays_manifold, excess_holes, vertices_more_pinched
from gmapspring.topology.sewing import face_gluing, sew_faces, unsew_faces
from gmapspring.topology.walks import ascending

NONE = np.zeros(0, dtype=np.int64)
NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
LARGEST = 2**62
"""No body has so many tetrahedra, and kernels can still count as far."""


class CutReport:
    """What one operation changed. Numbers are those after it, except the first of each move.

    To follow with arrays of your own over nodes: apply the moves (to <- from) all at once, as rows[to] = rows[from] does in
    NumPy, then copy each kept row to its new one.
    """

    __slots__ = ("_journal", "removed_tetrahedra")

    def __init__(self, journal: np.ndarray, removed: np.ndarray):
        self._journal = journal
        self.removed_tetrahedra = removed
        """Tetrahedra that are gone, ascending, (k,)."""

    @property
    def n_removed_nodes(self) -> int:
        """How many nodes are gone; on a suture, those that were merged into others."""
        return int(self._journal[0])

    @property
    def n_removed_springs(self) -> int:
        """How many springs are gone."""
        return int(self._journal[1])

    @property
    def new_nodes(self) -> np.ndarray:
        """(kept, new): nodes that a vertex split made, and the nodes they stem from, (k, 2)."""
        return self._part(0).reshape(-1, 2)

    @property
    def new_springs(self) -> np.ndarray:
        """(kept, new): the same for springs, (k, 2)."""
        return self._part(1).reshape(-1, 2)

    @property
    def moved_nodes(self) -> np.ndarray:
        """(from, to): nodes that were there before and got another number, (k, 2)."""
        return self._part(2).reshape(-1, 2)

    @property
    def moved_springs(self) -> np.ndarray:
        """(from, to): the same for springs, (k, 2)."""
        return self._part(3).reshape(-1, 2)

    @property
    def boundary_faces(self) -> np.ndarray:
        """(tetrahedron, face) of faces of live tetrahedra that became free, (k, 2)."""
        opened = self._part(4)
        return np.stack((opened >> 2, opened & 3), axis=1)

    @property
    def new_components(self) -> np.ndarray:
        """Labels in body.gmap.component_of of the pieces that came off, (k,); `components` numbers pieces anew."""
        return self._part(5)

    def _part(self, number: int) -> np.ndarray:
        """Return one of the parts that write_journal put one after the other."""
        start = 8 + int(self._journal[2: 2 + number].sum())
        return self._journal[start: start + int(self._journal[2 + number])]

    def __repr__(self) -> str:
        names = ("new_nodes", "new_springs", "boundary_faces", "removed_tetrahedra", "new_components")
        counts = [f"{len(getattr(self, name))} {name}" for name in names]
        counts += [f"{self.n_removed_nodes} removed nodes", f"{self.n_removed_springs} removed springs"]
        counts += [f"{len(moved)} moved {what}" for what, moved in (("nodes", self.moved_nodes), ("springs", self.moved_springs))
                   if len(moved)]  # fmt: skip
        return f"CutReport({', '.join(counts)})"


def split_face(body: Body, tet_a: int, tet_b: int, keep_manifold: bool = False) -> CutReport:
    """Cut the face between two tetrahedra; raise TopologyError, with nothing changed, where they share none."""
    if keep_manifold:
        return cut(body, [(tet_a, tet_b)], (), keep_manifold)
    return _cut(body, np.array([[_whole(tet_a), _whole(tet_b)]]), NONE)


def remove_tetrahedron(body: Body, tetrahedron: int, keep_manifold: bool = False) -> CutReport:
    """Isolate a tetrahedron by cutting its faces, then delete it."""
    if keep_manifold:
        return cut(body, (), [tetrahedron], keep_manifold)
    return _cut(body, NO_PAIRS, np.array([_whole(tetrahedron)]))


def cut(body: Body, faces: Iterable = (), tetrahedra: Iterable = (), keep_manifold: bool = False) -> CutReport:
    """Cut a set of faces, given as (k, 2) pairs of tetrahedra, and remove a set of tetrahedra, at once.

    Everything is unlinked first and the splits are settled once, so the result depends on the set alone, not on its order.
    Raises TopologyError, naming the culprit and with nothing changed, for a face or tetrahedron that is not there to cut
    or, with keep_manifold, where they would leave the body pinched where it was not, or more than it was.
    """
    pairs, removed = _pairs(faces), _numbers(tetrahedra)
    return (_cut_within_manifolds if keep_manifold else _cut)(body, pairs, removed)


def _cut(body: Body, pairs: np.ndarray, tetrahedra: np.ndarray) -> CutReport:
    """Cut, or raise with the first that is not there to cut."""
    journal = cut_kernel(body.table, 0, body.real, pairs, tetrahedra)
    if len(journal) == 1:
        for tet_a, tet_b in pairs.tolist():
            face_slot(body, tet_a, tet_b)
        for tetrahedron in tetrahedra.tolist():
            live_tetrahedron(body, tetrahedron)
    return CutReport(journal, tetrahedra if len(tetrahedra) < 2 else np.unique(tetrahedra))


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
    return CutReport(sew_kernel(body.table, 0, body.real, dart_a, dart_b), NONE)


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
    tetrahedron = _whole(tetrahedron)
    size = len(body.gmap.component_of)
    if not 0 <= tetrahedron < size:
        raise TopologyError(f"tetrahedron {tetrahedron} is out of range: the mesh has tetrahedra 0 to {size - 1}")
    if body.gmap.component_of.item(tetrahedron) < 0:
        raise TopologyError(f"tetrahedron {tetrahedron} is removed already; body.is_alive tells which are left")
    return tetrahedron


def _pairs(faces: Iterable) -> np.ndarray:
    """Return pairs of tetrahedra as int64 (k, 2)."""
    if isinstance(faces, np.ndarray) and faces.dtype.kind in "iu" and faces.shape[1:] == (2,):
        return np.ascontiguousarray(faces, dtype=np.int64)
    pairs = _listed(faces, "faces")
    for pair in pairs:
        if not isinstance(pair, list | tuple | np.ndarray) or len(pair) != 2:
            raise TopologyError(f"faces must be pairs of tetrahedra, shape (k, 2); {pair!r} is not a pair")
    return np.array([[_whole(a), _whole(b)] for a, b in pairs], dtype=np.int64).reshape(-1, 2)


def _numbers(tetrahedra: Iterable) -> np.ndarray:
    """Return numbers of tetrahedra as int64 (k,)."""
    if isinstance(tetrahedra, np.ndarray) and tetrahedra.dtype.kind in "iu" and tetrahedra.ndim == 1:
        return np.ascontiguousarray(tetrahedra, dtype=np.int64)
    return np.array([_whole(each) for each in _listed(tetrahedra, "tetrahedra")], dtype=np.int64)


def _whole(number: object) -> int:
    """Return a whole number; raise TopologyError for anything else."""
    if isinstance(number, bool) or not isinstance(number, int | np.integer):
        raise TopologyError(f"a tetrahedron is named by a whole number, not by {number!r}")
    if not -LARGEST <= number <= LARGEST:
        raise TopologyError(f"tetrahedron {number} is out of range")
    return int(number)


def _listed(values: Iterable, name: str) -> list:
    """Return what an array or any iterable holds, as a list."""
    if isinstance(values, np.ndarray):
        values = values.tolist()
    if not isinstance(values, Iterable):
        raise TopologyError(f"{name} must be a list or an array, not {values!r}")
    return list(values)


def _cut_within_manifolds(body: Body, pairs: np.ndarray, removed: np.ndarray) -> CutReport:
    """Cut; or undo all, and raise, where a vertex has been pinched that was not, or more than it was."""
    slots = {face_slot(body, tet_a, tet_b) for tet_a, tet_b in pairs.tolist()}
    if len(slots) + len(removed) == 1:  # what one cut would do can be told beforehand: no copy of the body is needed
        for tetrahedron in removed.tolist():
            check_stays_manifold(body.gmap, live_tetrahedron(body, tetrahedron), -1)
        for slot in slots:
            check_stays_manifold(body.gmap, slot // 4, slot % 4)
        return _cut(body, pairs, removed)
    before, vertex_of, holes = save_arrays(body), body.gmap.vertex_of.copy(), excess_holes(body.gmap)
    try:
        report = _cut(body, pairs, removed)
        more_pinched = vertices_more_pinched(body.gmap, vertex_of, holes)
        if len(more_pinched):
            raise TopologyError(
                f"{len(slots)} faces and {len(report.removed_tetrahedra)} tetrahedra cut at once would pinch the body at node "
                f"{more_pinched[0]}: cut an edge of it open to the surface too, or allow singular nodes with keep_manifold=False"
            )
    except BaseException:
        load_arrays(body, before)
        raise
    return report


@kernel
def cut_kernel(table, row, real, pairs, tetrahedra):
    """Cut faces, given as pairs of tetrahedra, and remove tetrahedra, in the time of the stars touched; return the journal.

    Where one of them is not there to cut, nothing is done, and the journal is but one number.
    """
    body = read_body(table, row, real)
    gmap = body.gmap
    n_tets = len(gmap.component_of)
    slots = np.empty(len(pairs), dtype=np.int64)
    is_there = True
    for i in range(len(pairs)):
        slots[i] = slot_between(gmap, pairs[i, 0], pairs[i, 1])
        is_there = is_there and slots[i] >= 0
    for tetrahedron in tetrahedra:
        is_there = is_there and is_live(gmap, tetrahedron)
    if not is_there:
        return np.empty(1, dtype=np.int64)
    return write_journal(cut_part(body, ascending(slots, 4 * n_tets), ascending(tetrahedra, n_tets)))


@inlined_part
def cut_part(body, slots, removed):
    """Cut the map, then bring the mechanics in line; slots 4*tetrahedron + face and tetrahedra are ascending, each once."""
    change = unsew_faces(body.gmap, body.room, slots, removed)
    embed(body.gmap, body.matter, change.vertices, change.edges)
    return change


@part
def is_live(gmap, tetrahedron):
    """Tell whether a number is that of a tetrahedron that is not removed."""
    return 0 <= tetrahedron < len(gmap.component_of) and gmap.component_of[tetrahedron] >= 0


@part
def slot_between(gmap, tet_a, tet_b):
    """Return the lower slot 4*tetrahedron + face of the face between two tetrahedra, -1 where they share none."""
    if is_live(gmap, tet_a) and is_live(gmap, tet_b) and tet_a != tet_b:
        for face in range(4):
            beyond = neighbour(gmap.image, tet_a, face)
            if beyond >> 2 == tet_b:
                return min(4 * tet_a + face, beyond)
    return np.int64(-1)


@kernel
def sew_kernel(table, row, real, dart_a, dart_b):
    """Sew the map, merge the nodes that became one, then bring the mechanics in line."""
    body = read_body(table, row, real)
    matter, gmap = body.matter, body.gmap
    change, merged = sew_faces(gmap, body.room, dart_a, dart_b)
    for i in range(len(merged)):
        merge_nodes(matter.nodes, merged[i, 0], merged[i, 1])
    embed(gmap, matter, change.vertices, change.edges)
    return write_journal(change)


@inlined_part
def write_journal(change):
    """Write a change into one array, since each array that a kernel returns costs microseconds: sizes first, then all parts."""
    vertices, edges = change.vertices, change.edges
    n_new_nodes, n_new_springs = 2 * len(vertices.final_copied), 2 * len(edges.final_copied)
    n_moved_nodes, n_moved_springs = 2 * len(vertices.final_moved), 2 * len(edges.final_moved)
    n_opened, n_labels = len(change.opened), len(change.labels)
    journal = np.empty(8 + n_new_nodes + n_new_springs + n_moved_nodes + n_moved_springs + n_opened + n_labels, dtype=np.int64)
    journal[0] = vertices.n_dead
    journal[1] = edges.n_dead
    journal[2] = n_new_nodes
    journal[3] = n_new_springs
    journal[4] = n_moved_nodes
    journal[5] = n_moved_springs
    journal[6] = n_opened
    journal[7] = n_labels
    end = write_pairs(journal, 8, vertices.final_copied)
    end = write_pairs(journal, end, edges.final_copied)
    end = write_pairs(journal, end, vertices.final_moved)
    end = write_pairs(journal, end, edges.final_moved)
    for slot in change.opened:
        journal[end] = slot
        end += 1
    for label in change.labels:
        journal[end] = label
        end += 1
    return journal


@part
def write_pairs(journal, start, pairs):
    """Write pairs from a place on; return where they end."""
    for i in range(len(pairs)):
        journal[start + 2 * i] = pairs[i, 0]
        journal[start + 2 * i + 1] = pairs[i, 1]
    return start + 2 * len(pairs)
