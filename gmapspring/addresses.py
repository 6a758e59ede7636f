"""Structures of arrays as rows of addresses: what a kernel takes instead of dozens of arrays, for one body or for many.

To hand a NamedTuple of n arrays to a compiled function costs some microseconds, as much as a cut. A row of a table of addresses
costs as little as one number, and a table has room for many rows, each with arrays of its own:

    row = address_row(structure)               # int64: for each array its address and length
    read = struct_reader(example)              # for kernels: read(table, row, real) -> the structure

`example(dtype)` returns a structure like those to be read, of arrays of any length, for np.float64 or np.float32; only the first
dimension of an array may differ from the example's. Inside kernels the structure is one pointer, which makes calls cheap too, and
its fields are found when they are used. A row does not keep its arrays alive: their owner does.
"""

import ctypes
import hashlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numba import typeof, types
from numba.core import typing
from numba.extending import infer_getattr, lower_builtin, lower_getattr_generic, models, register_model, type_callable
from numba.np.arrayobj import populate_array

PER_ARRAY = 2
"""Entries of a row for each array: address and length."""


def leaves(structure: Any) -> Iterator[np.ndarray]:
    """Yield the arrays of a structure, nested ones in their place."""
    for member in structure:
        if isinstance(member, np.ndarray):
            yield member
        else:
            yield from leaves(member)


def address_row(structure: Any) -> np.ndarray:
    """Return the address and length of every array of a structure, int64 (2 * n_arrays,)."""
    entries = []
    for array in leaves(structure):
        if not array.flags.c_contiguous:
            raise ValueError(f"an array of shape {array.shape} is not contiguous: kernels cannot reach it by its address")
        entries += [array.ctypes.data, len(array)]
    return np.array(entries, dtype=np.int64)


def struct_reader(example: Callable[[Any], Any]) -> Callable[[np.ndarray, int, Any], Any]:
    """Return a function read(table, row, real) for kernels; real is any number of the precision wanted."""

    def read(table: np.ndarray, row: int, real: Any) -> Any:
        return _filled(example(type(real)), iter(table[row].tolist()))

    @type_callable(read)
    def _type_read(context):
        def typer(table, row, real):
            return StructType(example(np.dtype(real.name).type))
        return typer

    @lower_builtin(read, types.Array, types.Integer, types.Float)
    def _lower_read(context, builder, sig, args):
        table = context.make_array(sig.args[0])(context, builder, args[0])
        row = context.cast(builder, args[1], sig.args[1], types.intp)
        return builder.gep(table.data, [builder.mul(row, builder.extract_value(table.shape, 1))])

    return read


def _filled(example: Any, entries: Iterator[int]) -> Any:
    """Return a structure like the example, of the arrays at the next addresses: what kernels do, without a compiler."""
    members = []
    for member in example:
        if isinstance(member, np.ndarray):
            address, length = next(entries), next(entries)
            shape = (length, *member.shape[1:])
            size = member.itemsize * int(np.prod(shape))
            memory: Any = (ctypes.c_byte * size).from_address(address) if size else b""
            members.append(np.frombuffer(memory, member.dtype).reshape(shape))
        else:
            members.append(_filled(member, entries))
    return type(example)(*members)


# The same for the compiler ----------------------------------------------------------------------------------------


class StructType(types.Type):
    """A row of addresses, as numba sees it: the fields of a structure like the example, at their places in the row."""

    def __init__(self, example: Any):
        self.fields: dict[str, tuple[int, Any, tuple[int, ...]]] = {}
        place = 0
        for name, member in zip(example._fields, example, strict=True):
            is_array = isinstance(member, np.ndarray)
            self.fields[name] = place, typeof(member) if is_array else StructType(member), member.shape[1:] if is_array else ()
            place += PER_ARRAY * (1 if is_array else sum(1 for _ in leaves(member)))
        # Short, since the name of every function that takes it holds its name too.
        digest = hashlib.sha256(repr(self.fields).encode()).hexdigest()[:8]
        super().__init__(name=f"{type(example).__name__}_{digest}")


@register_model(StructType)
class _StructModel(models.PrimitiveModel):
    """A structure is a pointer to its row of addresses."""

    def __init__(self, manager, struct):
        super().__init__(manager, struct, manager[types.int64].get_value_type().as_pointer())


@infer_getattr
class _StructAttributes(typing.templates.AttributeTemplate):
    key = StructType

    def generic_resolve(self, struct, name):
        return struct.fields[name][1] if name in struct.fields else None


@lower_getattr_generic(StructType)
def _lower_field(context, builder, struct, row, name):
    """Emit a nested structure, or the array at an address; widths of rows are constants, which makes indexing cheap."""
    place, ty, widths = struct.fields[name]
    intp = context.get_value_type(types.intp)
    entry = builder.gep(row, [intp(place)])
    if isinstance(ty, StructType):
        return entry
    size = context.get_abi_sizeof(context.get_data_type(ty.dtype))
    shape = [_constant(builder, builder.gep(entry, [intp(1)])), *(intp(width) for width in widths)]
    strides = [intp(size * int(np.prod(widths[axis:]))) for axis in range(len(widths) + 1)]
    array = context.make_array(ty)(context, builder)
    data = builder.inttoptr(_constant(builder, entry), context.get_data_type(ty.dtype).as_pointer())
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=intp(size), meminfo=None)
    return array._getvalue()


def _constant(builder, pointer):
    """Load what no kernel ever changes: the compiler may do so once, and early."""
    value = builder.load(pointer)
    value.set_metadata("invariant.load", builder.module.add_metadata([]))
    return value
