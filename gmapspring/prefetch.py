"""Prefetching: a kernel names a row that it will read soon, and the processor fetches it from memory in the meantime.

    prefetch(array, i)                       # the start of row i

A cut reads dozens of rows at random places. In a large body each comes from memory, which takes as long as hundreds of
operations, and where the place of one row is read from another they would come one after the other; rows that are named in
advance come side by side. It is a hint that changes no result, and any number will do for a row.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

READ, KEEP, DATA = (ir.IntType(32)(value) for value in (0, 3, 1))
"""What llvm.prefetch is told: to be read rather than written, into the nearest cache, and not to be executed."""


def prefetch(array: np.ndarray, i: int) -> None:
    """Fetch the start of row i, without waiting for it; where numba is switched off, do nothing."""


@type_callable(prefetch)
def _type_prefetch(context):
    def typer(array, i):
        return types.none if isinstance(array, types.Array) else None
    return typer


@lower_builtin(prefetch, types.Array, types.Integer)
def _lower_prefetch(context, builder, sig, args):
    view = context.make_array(sig.args[0])(context, builder, args[0])
    row = context.cast(builder, args[1], sig.args[1], types.intp)
    offset = builder.mul(row, builder.extract_value(view.strides, 0))
    address = cgutils.pointer_add(builder, view.data, offset, cgutils.voidptr_t)
    ty = ir.FunctionType(ir.VoidType(), [cgutils.voidptr_t, READ.type, KEEP.type, DATA.type])
    hint = cgutils.get_or_insert_function(builder.module, ty, "llvm.prefetch.p0i8")
    builder.call(hint, [address, READ, KEEP, DATA])
    return context.get_dummy_value()
