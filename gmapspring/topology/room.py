"""Room for the short lists that one change of the map needs: two dozen of them, in one array that is made once.

To make an array in a kernel costs as much as the work on ten tetrahedra. `empty_room` once, `clear` before each change,
`take` for each list; lists that do not fit, of large changes, get arrays of their own.
"""

import numpy as np

from gmapspring.jit import part

SIZE = 2048
"""Whole numbers that there is room for; to split a face takes some 300, to remove a tetrahedron 900."""


def empty_room() -> np.ndarray:
    """Make room, int64 (SIZE,): first how much of it is taken, then what."""
    room = np.zeros(SIZE, dtype=np.int64)
    room[0] = 1
    return room


@part
def clear(room):
    """Forget all lists."""
    room[0] = 1


@part
def take(room, n):
    """Return a list of n whole numbers, not set to anything, int64 (n,)."""
    stop = room[0] + n
    if stop > len(room):
        return np.empty(n, dtype=np.int64)
    room[0] = stop
    return room[stop - n: stop]


@part
def take_lists(room, n_lists, n):
    """Return some lists of n whole numbers each, int64 (n_lists, n): one after the other they would take longer to compile."""
    return take(room, n_lists * n).reshape(n_lists, n)


@part
def take_pairs(room, n):
    """Return a list of n pairs of whole numbers, int64 (n, 2)."""
    return take(room, 2 * n).reshape(n, 2)
