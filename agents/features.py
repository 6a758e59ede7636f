"""What the candidate policy knows: of each legal cut, and of the tetrahedra around it, by index from the observation.

A candidate is a legal action. A face has two sides, its two tetrahedra; a tetrahedron counts as both of its sides.
Of the tetrahedra only those are shown: where a mask keeps to what lies about the target, so does the policy, and a state looks
the same, and is as much work for the network, in a body of any size.
The higher side comes first (target before healthy, then anchor, then the stiffer, and so on through what a side shows),
so a candidate reads the same however the mesh is numbered. The gathering is one compiled pass: in torch it would cost as
much as the network.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel, part

Array = np.ndarray[Any, Any]

OWN_FEATURES = (
    "is a face", "area", "both sides target", "one side target", "an anchor", "highest healthy strain",
    "distance", "distance along the load", "distance towards the anchors", "offset x", "offset y", "offset z",
)  # fmt: skip
"""What a candidate shows of itself; it is seen from the centre of the target."""
SIDE_FEATURES = (
    "target", "anchor", "strain", "volume ratio", "stiffness", "volume", "free faces", "cut faces", "vessel",
    "target neighbours", "healthy neighbours", "node mass",
    "distance", "distance along the load", "distance towards the anchors", "offset x", "offset y", "offset z",
)  # fmt: skip
"""What a tetrahedron shows; the first nine are columns of the observation's tetrahedra."""
N_OWN, N_SIDE = len(OWN_FEATURES), len(SIDE_FEATURES)
OFFSET_SCALE = 0.5
"""What turns distances, in h, into features of the order of one."""


class Observed(NamedTuple):
    """The parts of a batch of observations that the features are made of, with the batch in front."""

    nodes: Array
    faces: Array
    face_tetrahedra: Array
    tetrahedra: Array
    tetrahedron_nodes: Array
    tetrahedron_neighbours: Array
    globals: Array


class Candidates(NamedTuple):
    """The legal actions of some states, one state after the other; of a state without any, action 0 and no features."""

    offset: Array
    """Where each state's begin, and where the last one's end, int64, shape (n_states + 1,)."""
    action: Array
    """Action id, int32, shape (n_candidates,), ascending for each state."""
    features: Array
    """float32, shape (n_candidates, N_OWN)."""
    sides: Array
    """The two sides of each, as rows of its state's own tetrahedra, int32, shape (n_candidates, 2)."""
    tetrahedron_offset: Array
    """Where each state's tetrahedra begin, and where the last one's end, int64, shape (n_states + 1,)."""
    tetrahedra: Array
    """What each tetrahedron shows that is a side of a candidate, float32, shape (n_tetrahedra, N_SIDE)."""
    neighbours: Array
    """Rows of its state's own tetrahedra that each is sewn to, -1 for none, int32, shape (n_tetrahedra, 4)."""
    of_state: Array
    """Globals of the states, float32, shape (n_states, n_globals)."""

    def split(self) -> "list[Candidates]":
        """Return each state alone, as views."""
        parts = []
        ends, tet_ends = self.offset.tolist(), self.tetrahedron_offset.tolist()
        for state in range(len(self.of_state)):
            first, last, start, stop = ends[state], ends[state + 1], tet_ends[state], tet_ends[state + 1]
            parts.append(Candidates(
                np.array([0, last - first]), self.action[first:last], self.features[first:last], self.sides[first:last],
                np.array([0, stop - start]), self.tetrahedra[start:stop], self.neighbours[start:stop],
                self.of_state[state : state + 1],
            ))  # fmt: skip
        return parts


def join(states: Sequence[Candidates]) -> Candidates:
    """Return single states as one batch."""
    joined = Candidates(*map(np.concatenate, zip(*states, strict=True)))
    return joined._replace(
        offset=_ends([len(state.action) for state in states]),
        tetrahedron_offset=_ends([len(state.tetrahedra) for state in states]),
    )


def _ends(lengths: Any) -> Array:
    """Return where parts of so many rows begin, and where the last one ends, int64."""
    return np.append(0, np.cumsum(lengths, dtype=np.int64))


# Columns of the observation, as numbers: a kernel that looked them up would keep old ones in its cache. A test compares.
POSITION, DISPLACEMENT, NODE_MASS = 1, 4, 11
AREA, CENTROID = 1, 2
ATTACHED, IS_TARGET, IS_ANCHOR = 1, 2, 3
LOAD_DIRECTION = 0
_COPIED = 9
_QUARTER, _OFFSET_SCALE = np.float32(0.25), np.float32(OFFSET_SCALE)
_MIDDLE, _LOAD, _ANCHORS = range(3)
"""Rows of a frame, (3, 3): the target's centre [h], and the directions of the load and of the anchors seen from it."""
_TARGET, _ANCHOR, _STRAIN = (SIDE_FEATURES.index(name) for name in ("target", "anchor", "strain"))
# Strains come last, or the order of the sides would tell them to a network that is to be blind to them.
_COMPARED = tuple(sorted(range(N_SIDE), key=lambda column: SIDE_FEATURES[column] in ("strain", "volume ratio")))
_TARGETS_BESIDE, _HEALTHY_BESIDE, _MASS, _SIDE_PLACE = (_COPIED + place for place in (0, 1, 2, 3))
_OWN_PLACE = OWN_FEATURES.index("distance")


def gather_candidates(observed: Observed, mask: Array) -> Candidates:
    """Gather every legal action and its sides, and copy the globals: the environments may overwrite what they showed.

    Args:
        observed: what is seen.
        mask: shape (batch, n_actions), non-zero where legal.
    """
    is_legal = mask.astype(np.bool_, copy=False)
    n_shown = np.empty(len(is_legal), np.int64)
    _count_shown(observed.face_tetrahedra, is_legal, n_shown)
    # A state without a legal action has a candidate all the same: a mean of nothing would be no number.
    offset = _ends(np.maximum(np.count_nonzero(is_legal, axis=1), 1))
    tetrahedron_offset = _ends(np.maximum(n_shown, 1))
    n_candidates, n_tets = offset[-1], tetrahedron_offset[-1]
    found = Candidates(
        offset, np.empty(n_candidates, np.int32), np.empty((n_candidates, N_OWN), np.float32),
        np.empty((n_candidates, 2), np.int32), tetrahedron_offset, np.empty((n_tets, N_SIDE), np.float32),
        np.empty((n_tets, 4), np.int32), observed.globals.copy(),
    )  # fmt: skip
    _gather(observed, is_legal, found)
    return found


@kernel
def _count_shown(face_tetrahedra, is_legal, n_shown):
    """Count the tetrahedra that each observation shows."""
    place_of = np.empty(is_legal.shape[1] - face_tetrahedra.shape[1], np.int32)
    for row in range(len(n_shown)):
        n_shown[row] = _place_shown(face_tetrahedra[row], is_legal[row], place_of)


@kernel
def _gather(observed, is_legal, out):
    """Fill all but the offsets and the globals, one observation after the other."""
    n_tets = observed.tetrahedra.shape[1]
    centres, frame = np.empty((n_tets, 3), np.float32), np.empty((3, 3), np.float32)
    place_of = np.empty(n_tets, np.int32)
    for row in range(is_legal.shape[0]):
        if _place_shown(observed.face_tetrahedra[row], is_legal[row], place_of) == 0:
            _show_nothing(out, row)
            continue
        _find_centres(observed, row, centres, frame)
        _find_ways(observed, row, centres, frame)
        _fill_sides(observed, row, place_of, out)
        for tet in range(n_tets):
            if place_of[tet] >= 0:
                _locate(out.tetrahedra, out.tetrahedron_offset[row] + place_of[tet], _SIDE_PLACE, centres, tet, frame)
        _fill_candidates(observed, row, is_legal[row], place_of, out)
        own, face_centres = out.features, observed.faces[row, :, CENTROID:]
        for candidate in range(out.offset[row], out.offset[row + 1]):
            action = out.action[candidate]
            if action < len(face_centres):
                _locate(own, candidate, _OWN_PLACE, face_centres, action, frame)
            else:
                _locate(own, candidate, _OWN_PLACE, centres, action - len(face_centres), frame)


@part
def _place_shown(face_tetrahedra, is_legal, place_of):
    """Number the tetrahedra that are sides of legal actions, ascending, and all others -1; return how many there are."""
    n_faces, n_shown = len(face_tetrahedra), 0
    for tet in range(len(place_of)):
        place_of[tet] = 0 if is_legal[n_faces + tet] else -1
    for face in range(n_faces):
        if is_legal[face]:
            for side in range(2):
                place_of[int(face_tetrahedra[face, side])] = 0
    for tet in range(len(place_of)):
        if place_of[tet] == 0:
            place_of[tet] = n_shown
            n_shown += 1
    return n_shown


@part
def _find_centres(observed, row, centres, frame):
    """Find the rest centroids of all attached tetrahedra, and the target's centre, the mean of its own [h]."""
    nodes, tetrahedra, corners = observed.nodes, observed.tetrahedra, observed.tetrahedron_nodes
    n_target = 0
    for axis in range(3):
        frame[_MIDDLE, axis] = 0.0
    for tet in range(len(centres)):
        if tetrahedra[row, tet, ATTACHED] == 0.0:
            continue
        for axis in range(3):
            centres[tet, axis] = 0.0
        for corner in range(4):
            node = int(corners[row, tet, corner])
            for axis in range(3):
                centres[tet, axis] += _QUARTER * (nodes[row, node, POSITION + axis] - nodes[row, node, DISPLACEMENT + axis])
        if tetrahedra[row, tet, IS_TARGET] > 0.0:
            n_target += 1
            for axis in range(3):
                frame[_MIDDLE, axis] += centres[tet, axis]
    for axis in range(3):
        frame[_MIDDLE, axis] /= np.float32(max(n_target, 1))


@part
def _find_ways(observed, row, centres, frame):
    """Find the directions of the load and of the anchors' centre seen from the target's, each 0 where there is none."""
    tetrahedra = observed.tetrahedra
    for axis in range(3):
        frame[_LOAD, axis], frame[_ANCHORS, axis] = observed.globals[row, LOAD_DIRECTION + axis], 0.0
    for tet in range(len(centres)):
        if tetrahedra[row, tet, ATTACHED] > 0.0 and tetrahedra[row, tet, IS_ANCHOR] > 0.0:
            for axis in range(3):
                frame[_ANCHORS, axis] += centres[tet, axis] - frame[_MIDDLE, axis]
    square = np.float32(0.0)
    for axis in range(3):
        square += frame[_ANCHORS, axis] * frame[_ANCHORS, axis]
    if square > 0.0:
        for axis in range(3):
            frame[_ANCHORS, axis] /= np.sqrt(square)


@part
def _locate(rows, place, column, centres, number, frame):
    """Write where something lies, seen from the middle of the target: to six columns of a row, given its centre by number."""
    square, along_load, to_anchors = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for axis in range(3):
        offset = (centres[number, axis] - frame[_MIDDLE, axis]) * _OFFSET_SCALE
        rows[place, column + 3 + axis] = offset
        square += offset * offset
        along_load += offset * frame[_LOAD, axis]
        to_anchors += offset * frame[_ANCHORS, axis]
    rows[place, column], rows[place, column + 1], rows[place, column + 2] = np.sqrt(square), along_load, to_anchors


@part
def _fill_sides(observed, row, place_of, out):
    """Fill what the tetrahedra show, but for where they lie, and which of those that are shown each is sewn to."""
    # Taken out of their tuples once: for every tetrahedron anew it would take longer than all the rest.
    tetrahedra, nodes, tetrahedron_nodes = observed.tetrahedra[row], observed.nodes[row], observed.tetrahedron_nodes[row]
    across, neighbours, shown = observed.tetrahedron_neighbours[row], out.neighbours, out.tetrahedra
    for tet in range(len(place_of)):
        if place_of[tet] < 0:
            continue
        place = out.tetrahedron_offset[row] + place_of[tet]
        for column in range(_COPIED):
            shown[place, column] = tetrahedra[tet, IS_TARGET + column]
        targets, healthy, mass = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for corner in range(4):
            neighbour = int(across[tet, corner])
            neighbours[place, corner] = -1
            if neighbour >= 0:
                neighbours[place, corner] = place_of[neighbour]
                is_target = tetrahedra[neighbour, IS_TARGET] > 0.0
                targets += _QUARTER * is_target
                healthy += _QUARTER * (not is_target)
            mass += _QUARTER * nodes[int(tetrahedron_nodes[tet, corner]), NODE_MASS]
        shown[place, _TARGETS_BESIDE], shown[place, _HEALTHY_BESIDE], shown[place, _MASS] = targets, healthy, mass


@part
def _fill_candidates(observed, row, is_legal, place_of, out):
    """Fill what the legal actions of an observation are and show, but for where they lie."""
    faces, face_tetrahedra = observed.faces[row], observed.face_tetrahedra[row]
    actions, own, sides, shown = out.action, out.features, out.sides, out.tetrahedra[out.tetrahedron_offset[row] :]
    n_faces, candidate = len(faces), out.offset[row]
    for action in range(n_faces):
        if is_legal[action]:
            one, two = place_of[int(face_tetrahedra[action, 0])], place_of[int(face_tetrahedra[action, 1])]
            if _is_higher(shown, two, one):
                one, two = two, one
            actions[candidate], sides[candidate, 0], sides[candidate, 1] = action, one, two
            own[candidate, 0], own[candidate, 1] = 1.0, faces[action, AREA]
            _relate(own, candidate, shown, one, two)
            candidate += 1
    for tet in range(len(place_of)):
        if is_legal[n_faces + tet]:
            place = place_of[tet]
            actions[candidate], sides[candidate, 0], sides[candidate, 1] = n_faces + tet, place, place
            own[candidate, 0], own[candidate, 1] = 0.0, 0.0
            _relate(own, candidate, shown, place, place)
            candidate += 1


@part
def _is_higher(shown, one, other):
    """Return whether one side is shown before another: by the first column in which they differ."""
    for column in _COMPARED:
        if shown[one, column] != shown[other, column]:
            return shown[one, column] > shown[other, column]
    return False


@part
def _relate(own, candidate, shown, one, two):
    """Write what follows from the two sides of a candidate together."""
    first, second = shown[one, _TARGET], shown[two, _TARGET]
    own[candidate, 2] = first * second
    own[candidate, 3] = abs(first - second)
    own[candidate, 4] = max(shown[one, _ANCHOR], shown[two, _ANCHOR])
    own[candidate, 5] = max(shown[one, _STRAIN] * (1 - first), shown[two, _STRAIN] * (1 - second))


@part
def _show_nothing(out, row):
    """Fill a state without a legal action: one candidate all the same, action 0, of one tetrahedron."""
    candidate, place = out.offset[row], out.tetrahedron_offset[row]
    out.action[candidate], out.sides[candidate, 0], out.sides[candidate, 1] = 0, 0, 0
    # Column by column: to assign to a slice takes seconds to compile.
    for column in range(N_OWN):
        out.features[candidate, column] = 0.0
    for column in range(N_SIDE):
        out.tetrahedra[place, column] = 0.0
    for corner in range(4):
        out.neighbours[place, corner] = -1
