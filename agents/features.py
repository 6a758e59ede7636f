"""What the candidate policy knows of each legal cut: gathered by index from the observation, in any numbering.

A candidate is a legal action. A face has two sides, its two tetrahedra; a tetrahedron counts as both of its sides.
The higher side comes first (target before healthy, then anchor, then the more strained, and so on through what a
side shows), so a candidate reads the same however the mesh is numbered. The gathering is one compiled pass: in torch
it would cost as much as the network.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel

Array = np.ndarray[Any, Any]

OWN_FEATURES = (
    "is a face", "area", "both sides target", "one side target", "an anchor", "highest healthy strain",
    "offset x", "offset y", "offset z", "distance", "distance along the load",
)  # fmt: skip
"""What a candidate shows of itself; its offset is seen from the centre of the target."""
SIDE_FEATURES = (
    "target", "anchor", "strain", "volume ratio", "stiffness", "volume", "free faces", "cut faces", "vessel",
    "target neighbours", "healthy neighbours", "node mass",
)  # fmt: skip
"""What a candidate shows of each of its two sides; the first nine are columns of the observation's tetrahedra."""
N_OWN, N_SIDE = len(OWN_FEATURES), len(SIDE_FEATURES)
N_FEATURES = N_OWN + 2 * N_SIDE
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
    """float32, shape (n_candidates, N_FEATURES)."""
    of_state: Array
    """Globals of the states, float32, shape (n_states, n_globals)."""

    def split(self) -> "list[Candidates]":
        """Return each state alone, as views."""
        ends, parts = self.offset.tolist(), []
        for state, (first, last) in enumerate(zip(ends[:-1], ends[1:], strict=True)):
            own = self.action[first:last], self.features[first:last], self.of_state[state : state + 1]
            parts.append(Candidates(np.array([0, last - first]), *own))
        return parts


def join(states: Sequence[Candidates]) -> Candidates:
    """Return single states as one batch."""
    _, action, features, of_state = map(np.concatenate, zip(*states, strict=True))
    return Candidates(np.append(0, np.cumsum([len(state.action) for state in states])), action, features, of_state)


# Columns of the observation, as numbers: a kernel that looked them up would keep old ones in its cache. A test compares.
POSITION, DISPLACEMENT, NODE_MASS = 1, 4, 11
AREA, CENTROID = 1, 2
ATTACHED, IS_TARGET = 1, 2
LOAD_DIRECTION = 0
_COPIED = 9
_QUARTER = np.float32(0.25)
_TARGET, _ANCHOR, _STRAIN = (SIDE_FEATURES.index(name) for name in ("target", "anchor", "strain"))
_TARGETS_BESIDE, _HEALTHY_BESIDE, _MASS = _COPIED, _COPIED + 1, _COPIED + 2


def gather_candidates(observed: Observed, mask: Array) -> Candidates:
    """Gather the features of every legal action, and copy the globals: the environments may overwrite what they showed.

    Args:
        observed: what is seen.
        mask: shape (batch, n_actions), non-zero where legal.
    """
    is_legal = mask.astype(np.bool_, copy=False)
    offset = np.zeros(len(mask) + 1, np.int64)
    # A state without a legal action has a candidate all the same: a mean of nothing would be no number.
    np.cumsum(np.maximum(np.count_nonzero(is_legal, axis=1), 1), out=offset[1:])
    action, features = np.empty(offset[-1], np.int32), np.empty((offset[-1], N_FEATURES), np.float32)
    _gather(observed, is_legal, offset, action, features)
    return Candidates(offset, action, features, observed.globals.copy())


@kernel
def _gather(observed, is_legal, offset, action, features):
    """Fill action and features, one observation after the other."""
    n_tets, n_faces = observed.tetrahedra.shape[1], observed.faces.shape[1]
    sides = np.empty((n_tets, N_SIDE), np.float32)
    centres = np.empty((n_tets, 3), np.float32)
    middle = np.empty(3, np.float32)
    for row in range(is_legal.shape[0]):
        _fill_sides(observed, row, sides, centres, middle)
        faces, face_tetrahedra, load = observed.faces[row], observed.face_tetrahedra[row], observed.globals[row]
        place = offset[row]
        for candidate in range(is_legal.shape[1]):
            if not is_legal[row, candidate]:
                continue
            action[place] = candidate
            own = features[place]
            if candidate < n_faces:
                one, two = int(face_tetrahedra[candidate, 0]), int(face_tetrahedra[candidate, 1])
                _relate(own, sides, one, two)
                own[0], own[1] = 1.0, faces[candidate, AREA]
                _locate(own, faces[candidate, CENTROID:], middle, load)
            else:
                one = candidate - n_faces
                _relate(own, sides, one, one)
                own[0], own[1] = 0.0, 0.0
                _locate(own, centres[one], middle, load)
            place += 1
        if place == offset[row]:
            action[place], features[place] = 0, 0.0


@kernel
def _locate(own, centre, middle, load):
    """Write where a candidate lies, seen from the middle of the target."""
    square, along = np.float32(0.0), np.float32(0.0)
    for axis in range(3):
        offset = (centre[axis] - middle[axis]) * np.float32(OFFSET_SCALE)
        own[6 + axis] = offset
        square += offset * offset
        along += offset * load[LOAD_DIRECTION + axis]
    own[9], own[10] = np.sqrt(square), along


@kernel
def _fill_sides(observed, row, sides, centres, middle):
    """Fill what every tetrahedron shows as a side, its rest centroid [h], and the centre of the live target [h]."""
    tetrahedra, neighbours = observed.tetrahedra[row], observed.tetrahedron_neighbours[row]
    middle[:] = 0.0
    n_target = 0
    for tet in range(sides.shape[0]):
        side, centre = sides[tet], centres[tet]
        side[_COPIED:] = 0.0
        centre[:] = 0.0
        for column in range(_COPIED):
            side[column] = tetrahedra[tet, IS_TARGET + column]
        if tetrahedra[tet, ATTACHED] == 0.0:
            continue
        for corner in range(4):
            neighbour = int(neighbours[tet, corner])
            if neighbour >= 0:
                is_target = tetrahedra[neighbour, IS_TARGET] > 0.0
                side[_TARGETS_BESIDE if is_target else _HEALTHY_BESIDE] += _QUARTER
            _add_node(observed.nodes[row], int(observed.tetrahedron_nodes[row, tet, corner]), side, centre)
        if side[_TARGET] > 0.0:
            n_target += 1
            for axis in range(3):
                middle[axis] += centre[axis]
    middle /= np.float32(max(n_target, 1))


@kernel
def _add_node(nodes, node, side, centre):
    """Add a corner's share of mass and of the rest centroid."""
    side[_MASS] += _QUARTER * nodes[node, NODE_MASS]
    for axis in range(3):
        centre[axis] += _QUARTER * (nodes[node, POSITION + axis] - nodes[node, DISPLACEMENT + axis])


@kernel
def _relate(own, sides, one, two):
    """Write both sides, the higher row first, and what follows from the two together."""
    for column in range(N_SIDE if one != two else 0):
        rise = sides[two, column] - sides[one, column]
        if rise > 0.0:
            one, two = two, one
        if rise != 0.0:
            break
    for column in range(N_SIDE):
        own[N_OWN + column] = sides[one, column]
        own[N_OWN + N_SIDE + column] = sides[two, column]
    first, second = sides[one, _TARGET], sides[two, _TARGET]
    own[2] = first * second
    own[3] = abs(first - second)
    own[4] = max(sides[one, _ANCHOR], sides[two, _ANCHOR])
    own[5] = max(sides[one, _STRAIN] * (1 - first), sides[two, _STRAIN] * (1 - second))
