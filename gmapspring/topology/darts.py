"""The 24 darts of one tetrahedron as constant tables: what never changes about a 3-g-map of tetrahedra.

A dart is an ordering (p0, p1, p2, p3) of the four corners: vertex p0, edge p0 p1, face p0 p1 p2 (opposite p3). Inside a
tetrahedron alpha_i exchanges p_i and p_(i+1), so alpha_0, alpha_1 and alpha_2 are tables; only alpha_3 is data.
Numbering: local dart = 6*face + k; for the corners a < b < c of a face, k counts abc, bac, bca, cba, cab, acb.
"""

import numpy as np

DARTS_PER_FACE = 6
DARTS_PER_TETRAHEDRON = 24
EDGE_CORNERS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)], dtype=np.int32)
"""The two corners of each edge, in the order used throughout, shape (6, 2)."""
FACE_CORNERS = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)], dtype=np.int32)
"""The three corners of each face, ascending; face f is opposite corner f, shape (4, 3)."""
OUTWARD_FACE_CORNERS = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)], dtype=np.int32)
"""The same corners, counter-clockwise as seen from outside a positively oriented tetrahedron, shape (4, 3)."""


def _orderings() -> list[tuple[int, int, int, int]]:
    """List the corner ordering of each of the 24 local darts."""
    turns = ((0, 1, 2), (1, 0, 2), (1, 2, 0), (2, 1, 0), (2, 0, 1), (0, 2, 1))
    return [(c[i], c[j], c[k], f) for f, c in enumerate(FACE_CORNERS.tolist()) for i, j, k in turns]


ORDERINGS = np.array(_orderings(), dtype=np.int32)
"""Corners (p0, p1, p2, p3) of each local dart, shape (24, 4)."""
_LOCAL_DART = {tuple(p): d for d, p in enumerate(ORDERINGS.tolist())}


def _exchange(i: int) -> np.ndarray:
    """Tabulate alpha_i: the dart whose ordering has p_i and p_(i+1) exchanged."""
    swapped = ORDERINGS.copy()
    swapped[:, [i, i + 1]] = swapped[:, [i + 1, i]]
    return np.array([_LOCAL_DART[tuple(p)] for p in swapped.tolist()], dtype=np.int32)


ALPHA = np.stack([_exchange(0), _exchange(1), _exchange(2)])
"""alpha_0, alpha_1, alpha_2 of each local dart, shape (3, 24)."""
ALPHA2 = ALPHA[2].copy()
CORNER_OF_DART = ORDERINGS[:, 0].copy()
"""The corner p0 that each local dart starts from, shape (24,)."""

_EDGE_OF_CORNERS = np.full((4, 4), -1, dtype=np.int32)
for _e, (_i, _j) in enumerate(EDGE_CORNERS.tolist()):
    _EDGE_OF_CORNERS[_i, _j] = _EDGE_OF_CORNERS[_j, _i] = _e

EDGE_OF_DART = _EDGE_OF_CORNERS[ORDERINGS[:, 0], ORDERINGS[:, 1]]
"""The edge p0 p1 of each local dart, shape (24,)."""
FACE_EDGES = np.array([[_EDGE_OF_CORNERS[c[0], c[1]], _EDGE_OF_CORNERS[c[0], c[2]], _EDGE_OF_CORNERS[c[1], c[2]]]
                       for c in FACE_CORNERS.tolist()], dtype=np.int32)
"""The three edges of each face, shape (4, 3)."""
CORNER_EDGES = np.array([[_EDGE_OF_CORNERS[c, o] for o in range(4) if o != c] for c in range(4)], dtype=np.int32)
"""The three edges at each corner, shape (4, 3)."""
CORNER_FACES = FACE_CORNERS.copy()
"""The three faces at each corner (all but the one opposite to it), shape (4, 3)."""
DART_AT_CORNER = np.array([[next((d for d in range(6 * f, 6 * f + 6) if CORNER_OF_DART[d] == c), -1)
                            for f in range(4)] for c in range(4)], dtype=np.int32)
"""The lowest local dart of face f that starts from corner c, -1 where c is not on f, shape (4 corners, 4 faces)."""
DARTS_AT_EDGE = np.array([[d for d in range(24) if EDGE_OF_DART[d] == e and CORNER_OF_DART[d] == EDGE_CORNERS[e, 0]]
                          for e in range(6)], dtype=np.int32)
"""The two local darts, one a face, that run along edge e from its lower corner; alpha_2 exchanges them, shape (6, 2)."""
LOWEST_DART_OF_CORNER = np.array([np.flatnonzero(CORNER_OF_DART == c)[0] for c in range(4)], dtype=np.int32)
LOWEST_DART_OF_EDGE = np.array([np.flatnonzero(EDGE_OF_DART == e)[0] for e in range(6)], dtype=np.int32)
IS_EVEN = np.array([np.linalg.det(np.eye(4)[p]) > 0 for p in ORDERINGS])
"""Which orderings are even permutations: sewing even to odd keeps tetrahedra the same way round, shape (24,)."""


def _turned(first: int, k: int) -> int:
    """Return the local dart that alpha_3 gives for dart k of a face, from the one for dart 0: turned on, or turned over."""
    face, k0 = divmod(first, DARTS_PER_FACE)
    return DARTS_PER_FACE * face + (k0 + k if k0 % 2 == 0 else k0 - k) % DARTS_PER_FACE


ACROSS = np.array([[_turned(first, k) for k in range(DARTS_PER_FACE)] for first in range(DARTS_PER_TETRAHEDRON)])
"""The local dart that alpha_3 gives for dart k of a face, from the local dart that it gives for k = 0, int64 (24, 6)."""
CORNER_ACROSS = CORNER_OF_DART[ACROSS].astype(np.int64)
"""The corner that it starts from, int64 (24, 6)."""
K_AT_CORNER = np.where(DART_AT_CORNER < 0, 0, DART_AT_CORNER % DARTS_PER_FACE).astype(np.int64)
"""The k of DART_AT_CORNER, int64 (4 corners, 4 faces)."""
