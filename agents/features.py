"""What the candidate policy knows of each legal cut: gathered by index from the observation, in any numbering.

A candidate is a legal action. A face has two sides, its two tetrahedra; a tetrahedron counts as both of its sides.
The higher side comes first (target before healthy, then anchor, then the more strained, and so on through what a
side shows), so a candidate reads the same however the mesh is numbered. The gathering is one compiled pass: in torch
it would cost as much as the network.
"""

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
    "target", "anchor", "strain", "volume ratio", "stiffness", "volume", "free faces", "cut faces",
    "target neighbours", "healthy neighbours", "node mass",
)  # fmt: skip
"""What a candidate shows of each of its two sides; the first eight are columns of the observation's tetrahedra."""
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
    """The legal actions of a batch of observations, padded to the longest row."""

    n_legal: Array
    """Legal actions per row, int64, shape (batch,)."""
    action: Array
    """Action id, int64, shape (batch, n_candidates); where padded, the row's first again, or 0."""
    features: Array
    """float32, shape (batch, n_candidates, N_FEATURES); where padded, those of the row's first, or 0."""


# Columns of the observation, as numbers: a kernel that looked them up would keep old ones in its cache. A test compares.
POSITION, DISPLACEMENT, NODE_MASS = 1, 4, 11
AREA, CENTROID = 1, 2
ATTACHED, IS_TARGET = 1, 2
LOAD_DIRECTION = 0
_COPIED = 8
_TARGET, _ANCHOR, _STRAIN = (SIDE_FEATURES.index(name) for name in ("target", "anchor", "strain"))
_TARGETS_BESIDE, _HEALTHY_BESIDE, _MASS = _COPIED, _COPIED + 1, _COPIED + 2


def gather_candidates(observed: Observed, mask: Array) -> Candidates:
    """Gather the features of every legal action; mask: (batch, n_actions), non-zero where legal."""
    is_legal = mask.astype(np.bool_, copy=False)
    n_legal = np.count_nonzero(is_legal, axis=1)
    width = max(int(n_legal.max()), 1)
    action = np.zeros((len(mask), width), np.int64)
    features = np.zeros((len(mask), width, N_FEATURES), np.float32)
    _gather(observed, is_legal, action, features)
    return Candidates(n_legal, action, features)


@kernel
def _gather(observed, is_legal, action, features):
    """Fill action and features, row by row."""
    n_tets, n_faces = observed.tetrahedra.shape[1], observed.faces.shape[1]
    sides = np.empty((n_tets, N_SIDE), np.float32)
    centres = np.empty((n_tets, 3), np.float32)
    middle = np.empty(3, np.float32)
    for row in range(is_legal.shape[0]):
        _fill_sides(observed, row, sides, centres, middle)
        place = 0
        for candidate in range(is_legal.shape[1]):
            if not is_legal[row, candidate]:
                continue
            action[row, place] = candidate
            one = two = candidate - n_faces
            if candidate < n_faces:
                one = int(observed.face_tetrahedra[row, candidate, 0])
                two = int(observed.face_tetrahedra[row, candidate, 1])
                features[row, place, 0] = 1.0
                features[row, place, 1] = observed.faces[row, candidate, AREA]
            _relate(features, row, place, sides, one, two)
            square, along = np.float32(0.0), np.float32(0.0)
            for axis in range(3):
                offset = centres[one, axis]
                if candidate < n_faces:
                    offset = observed.faces[row, candidate, CENTROID + axis]
                offset = (offset - middle[axis]) * np.float32(OFFSET_SCALE)
                features[row, place, 6 + axis] = offset
                square += offset * offset
                along += offset * observed.globals[row, LOAD_DIRECTION + axis]
            features[row, place, 9] = np.sqrt(square)
            features[row, place, 10] = along
            place += 1
        for padded in range(place, action.shape[1]):
            action[row, padded] = action[row, 0]
            for column in range(N_FEATURES):
                features[row, padded, column] = features[row, 0, column]


@kernel
def _fill_sides(observed, row, sides, centres, middle):
    """Fill what every tetrahedron shows as a side, its rest centroid [h], and the centre of the live target [h]."""
    middle[:] = 0.0
    n_target = 0
    quarter = np.float32(0.25)
    for tet in range(sides.shape[0]):
        sides[tet, _COPIED:] = 0.0
        centres[tet] = 0.0
        for column in range(_COPIED):
            sides[tet, column] = observed.tetrahedra[row, tet, IS_TARGET + column]
        if observed.tetrahedra[row, tet, ATTACHED] == 0.0:
            continue
        for corner in range(4):
            neighbour = int(observed.tetrahedron_neighbours[row, tet, corner])
            if neighbour >= 0:
                is_target = observed.tetrahedra[row, neighbour, IS_TARGET] > 0.0
                sides[tet, _TARGETS_BESIDE if is_target else _HEALTHY_BESIDE] += quarter
            node = int(observed.tetrahedron_nodes[row, tet, corner])
            sides[tet, _MASS] += quarter * observed.nodes[row, node, NODE_MASS]
            for axis in range(3):
                moved = observed.nodes[row, node, DISPLACEMENT + axis]
                centres[tet, axis] += quarter * (observed.nodes[row, node, POSITION + axis] - moved)
        if sides[tet, _TARGET] > 0.0:
            n_target += 1
            for axis in range(3):
                middle[axis] += centres[tet, axis]
    middle /= np.float32(max(n_target, 1))


@kernel
def _relate(features, row, place, sides, one, two):
    """Write both sides, the higher row first, and what follows from the two together."""
    for column in range(N_SIDE):
        rise = sides[two, column] - sides[one, column]
        if rise > 0.0:
            one, two = two, one
        if rise != 0.0:
            break
    for column in range(N_SIDE):
        features[row, place, N_OWN + column] = sides[one, column]
        features[row, place, N_OWN + N_SIDE + column] = sides[two, column]
    first, second = sides[one, _TARGET], sides[two, _TARGET]
    features[row, place, 2] = first * second
    features[row, place, 3] = abs(first - second)
    features[row, place, 4] = max(sides[one, _ANCHOR], sides[two, _ANCHOR])
    healthy = max(sides[one, _STRAIN] * (1 - first), sides[two, _STRAIN] * (1 - second))
    features[row, place, 5] = healthy
