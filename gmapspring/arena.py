"""Rows of arrays: what many bodies change lies side by side in one block for each array, and rows are copied in a microsecond.

A structure of arrays (see addresses.py) has a twin of numbers, its *extents*, which say of each array what a row of it is:

    PER_NODE, PER_SPRING    changes, and is as long as the body has live nodes or springs
    WHOLE                   changes, all of it
    COUNTS                  the counts themselves, wherever they stand; the last of them, a walk's stamp, is a row's own
    SCRATCH                 a row's own, of no meaning between two calls
    SHARED                  never changes: all rows on the same body point to the same array
"""

import ctypes
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

from gmapspring.addresses import PER_ARRAY, leaves
from gmapspring.jit import kernel
from gmapspring.matter import CACHE_LINE, N_NODES, N_SPRINGS, aligned_zeros

PER_NODE: Any = N_NODES
PER_SPRING: Any = N_SPRINGS
WHOLE: Any = 2
COUNTS: Any = 3
SCRATCH: Any = 4
SHARED: Any = 5
"""Extents; the first two are places in the counts, and all up to COUNTS are of what changes."""
N_COPIED = 4
"""Counts that belong to a state: all but the stamp. Stamps only grow: an old one put back would make old marks look fresh."""


class Layout(NamedTuple):
    """What the arrays of a structure are, one entry for each array."""

    extents: np.ndarray
    """int64 (n,)."""
    widths: np.ndarray
    """Bytes of an entry, int64 (n,)."""

    @property
    def counts(self) -> int:
        """Place of the counts among the arrays."""
        return int(np.argmax(self.extents == COUNTS))

    @property
    def n_columns(self) -> int:
        """Entries of a row of addresses."""
        return PER_ARRAY * len(self.extents)


def layout_of(structure: Any, extents: Any) -> Layout:
    """Return the layout of structures like one, given its twin of extents."""
    widths = [array.itemsize * int(np.prod(array.shape[1:])) for array in leaves(structure)]
    return Layout(np.array(list(_numbers(extents)), np.int64), np.array(widths, np.int64))


def _numbers(extents: Any) -> Iterator[int]:
    """Yield the extents, nested ones in their place."""
    for member in extents:
        if isinstance(member, int):
            yield member
        else:
            yield from _numbers(member)


class SavedRow:
    """A copy of all that a row can change, live entries only; `table` (1, n) finds it, and leads nowhere else."""

    __slots__ = ("__weakref__", "_buffer", "_is_copied", "table")

    def __init__(self, layout: Layout, table: np.ndarray, row: int, counts: np.ndarray):
        """Copy a row; counts: those of the row."""
        extents, lengths = layout.extents, table[row, 1::PER_ARRAY]
        self._is_copied = extents <= COUNTS
        live = np.where(extents < WHOLE, np.minimum(counts[np.minimum(extents, N_SPRINGS)], lengths), lengths)
        sizes = np.where(self._is_copied, -(-live * layout.widths // CACHE_LINE) * CACHE_LINE, 0)
        ends = np.cumsum(sizes)
        self._buffer = np.empty(int(ends[-1]), np.uint8)
        self.table = np.zeros((1, layout.n_columns), np.int64)
        self.table[0, 0::PER_ARRAY] = ends - sizes
        self.table[0, 1::PER_ARRAY] = np.where(self._is_copied, live, 0)
        self._move(self._buffer.ctypes.data)
        copy_live(table, row, self.table, 0, *layout, layout.counts)

    def _move(self, distance: int) -> None:
        """Add to all addresses."""
        self.table[0, 0::PER_ARRAY] += np.where(self._is_copied, distance, 0)

    def __getstate__(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return what a copy is made from, with places in the buffer for addresses."""
        table = self.table.copy()
        table[0, 0::PER_ARRAY] -= np.where(self._is_copied, self._buffer.ctypes.data, 0)
        return self._buffer, self._is_copied, table

    def __setstate__(self, state: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
        """Take over a copy, which lies elsewhere."""
        self._buffer, self._is_copied, self.table = state
        self._move(self._buffer.ctypes.data)


class Tenancy(NamedTuple):
    """What a structure brings along to any row of an arena that stands for it."""

    shared: np.ndarray
    """Addresses of shared arrays, 0 for others, (n,)."""
    lengths: np.ndarray
    """Lengths of all arrays, (n,)."""
    owner: Any
    """What keeps the shared arrays alive."""


class Arena:
    """Rows of structures in one block for each array: `arrays` has the rows in front, and `table` finds them."""

    def __init__(self, example: Any, extents: Any, n_rows: int):
        """Make room for rows as long as those of an example; they are empty until they are put."""
        self.layout = layout_of(example, extents)
        self.arrays = _stacked(example, extents, n_rows)
        """Structure of arrays (n_rows, capacity, ...); those that are shared have no capacity."""
        stacks = list(leaves(self.arrays))
        strides = np.array([0 if stack.shape[1] == 0 else stack.strides[0] for stack in stacks])
        self._counts = first = self.layout.counts
        places = [first if extent == COUNTS else place for place, extent in enumerate(self.layout.extents.tolist())]
        starts = np.array([stack.ctypes.data for stack in stacks])
        own = np.where(self.layout.extents == SHARED, 0, starts)
        self._addresses = (own + strides * np.arange(n_rows)[:, None])[:, places]
        self._capacities = np.array([stack.shape[1] for stack in stacks])
        self.table = np.zeros((n_rows, self.layout.n_columns), np.int64)
        """Where kernels find the arrays, int64 (n_rows, n_columns)."""
        self.owners: list[Any] = [None] * n_rows
        """What keeps the shared arrays of each row alive."""

    def __reduce__(self) -> Any:
        raise TypeError("an arena is found by its addresses, which a copy would not have: build another one")

    def tenancy(self, entries: np.ndarray, owner: Any) -> Tenancy:
        """Return what a structure, for which there must be room, brings along to any row.

        entries: its addresses and lengths, (n_columns,). owner: what keeps the arrays alive that all rows on it share.
        """
        extents, lengths = self.layout.extents, entries[1::PER_ARRAY]
        # Room for nodes and springs is kept whole, but an array that no term needs has no rows here either.
        kept = np.where((extents < WHOLE) & (lengths > 0), self._capacities, lengths)
        return Tenancy(np.where(extents == SHARED, entries[0::PER_ARRAY], 0), kept, owner)

    def put(self, row: int, tenant: Tenancy, table: np.ndarray, source: int) -> None:
        """Let a row stand for another structure; table, source: the row that has its values, of itself or saved from it."""
        target = self.table[row]
        np.add(self._addresses[row], tenant.shared, out=target[0::PER_ARRAY])
        target[1::PER_ARRAY] = tenant.lengths
        self.owners[row] = tenant.owner
        copy_live(table, source, self.table, row, *self.layout, self._counts)

    def view(self, row: int, like: Any) -> Any:
        """Return a row as a structure of views; like: the structure that it stands for, for the shared arrays."""
        lengths = iter(self.table[row, 1::PER_ARRAY].tolist())
        extents = iter(self.layout.extents.tolist())
        counts: list[np.ndarray] = []

        def viewed(stacks: Any, shared: Any) -> Any:
            members = []
            for stack, other in zip(stacks, shared, strict=True):
                if not isinstance(stack, np.ndarray):
                    members.append(viewed(stack, other))
                    continue
                length, extent = next(lengths), next(extents)
                members.append(other if extent == SHARED else stack[row, :length])
                if extent == COUNTS:
                    counts.append(members[-1])
                    members[-1] = counts[0]  # one array, wherever it stands
            return type(stacks)(*members)

        return viewed(self.arrays, like)


def shared_part(structure: Any, extents: Any) -> Any:
    """Return a structure with its shared arrays alone; None stands for all others."""
    pairs = zip(structure, extents, strict=True)
    return type(structure)(*(
        shared_part(member, extent) if not isinstance(member, np.ndarray) else member if extent == SHARED else None
        for member, extent in pairs
    ))  # fmt: skip


def _stacked(example: Any, extents: Any, n_rows: int) -> Any:
    """Return a structure of arrays with rows in front, in which each row starts on a cache line; all lie in one block.

    Of a large block the system makes large pages, and rows lie in so many arrays that small ones would cost a fifth of the time.
    """
    shapes: list[tuple[int, ...]] = []
    for array, extent in zip(leaves(example), _numbers(extents), strict=True):
        length = 0 if extent == SHARED else len(array)
        whole = CACHE_LINE // math.gcd(array.itemsize * math.prod(array.shape[1:]), CACHE_LINE)
        shapes.append((n_rows, -(-length // whole) * whole, *array.shape[1:]))
    sizes = [math.prod(shape) * array.itemsize for shape, array in zip(shapes, leaves(example), strict=True)]
    block = aligned_zeros((sum(sizes),), np.uint8)
    parts = iter(np.split(block, np.cumsum(sizes)[:-1]))
    shaped = iter([next(parts).view(array.dtype).reshape(shape) for array, shape in zip(leaves(example), shapes, strict=True)])

    def stacked(structure: Any) -> Any:
        return type(structure)(*(next(shaped) if isinstance(each, np.ndarray) else stacked(each) for each in structure))

    return stacked(example)


@kernel
def copy_live(source, source_row, target, target_row, extents, widths, counts_place):
    """Copy all that changes and is live from a row of one table to a row of another."""
    counts = np.zeros(N_COPIED, dtype=np.int64)
    copy_bytes(counts.ctypes.data, source[source_row, PER_ARRAY * counts_place], N_COPIED * 8)
    for array in range(len(extents)):
        extent = extents[array]
        n = source[source_row, PER_ARRAY * array + 1]
        if extent == COUNTS:
            n = min(n, np.int64(N_COPIED))
        elif extent < WHOLE:
            n = min(n, counts[extent])
        elif extent > COUNTS:
            n = np.int64(0)
        if n > 0:
            copy_bytes(target[target_row, PER_ARRAY * array], source[source_row, PER_ARRAY * array], n * widths[array])


def copy_bytes(target: int, source: int, size: int) -> None:
    """Copy bytes from one address to another."""
    ctypes.memmove(target, source, size)


@type_callable(copy_bytes)
def _type_copy_bytes(context):
    def typer(target, source, size):
        return types.none
    return typer


@lower_builtin(copy_bytes, types.Integer, types.Integer, types.Integer)
def _lower_copy_bytes(context, builder, sig, args):
    byte = ir.IntType(8).as_pointer()
    target, source, size = (context.cast(builder, value, ty, types.intp) for value, ty in zip(args, sig.args, strict=True))
    cgutils.raw_memcpy(builder, builder.inttoptr(target, byte), builder.inttoptr(source, byte), size, 1)
    return context.get_dummy_value()
