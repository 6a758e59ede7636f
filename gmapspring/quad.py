"""Four numbers side by side, as the rows of states and forces hold them: one vector operation each, in kernels.

    velocity = load(state, i, 4)                     # state[i, 4:8]
    store(state, i, 0, load(state, i, 0) + step * velocity)

A quad is added, subtracted and scaled like a number. Every lane is rounded by itself, in IEEE arithmetic and without fused
operations, so the bits do not depend on the instruction set: the compiler is handed vectors, and picks instructions for them.
The functions are their own readable twins: where numba is switched off, a quad is a numpy array.
"""

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import lower_builtin, models, register_model, type_callable

LANES = 4


class QuadType(types.Type):
    """Four float64 or float32, as numba sees them."""

    def __init__(self, real: types.Float):
        super().__init__(name=f"Quad({real})")
        self.real = real


QUADS = {real: QuadType(real) for real in (types.float64, types.float32)}


@register_model(QuadType)
class _QuadModel(models.PrimitiveModel):
    """A quad is a vector of the compiler's."""

    def __init__(self, manager, quad):
        super().__init__(manager, quad, ir.VectorType(manager[quad.real].get_value_type(), LANES))


def load(array: np.ndarray, i: int, start: int) -> np.ndarray:
    """Return array[i, start : start + 4]."""
    return array[i, start: start + LANES].copy()


def store(array: np.ndarray, i: int, start: int, quad: np.ndarray) -> None:
    """Set array[i, start : start + 4]."""
    array[i, start: start + LANES] = quad


def dot(first: np.ndarray, second: np.ndarray) -> float:
    """Return the scalar product of two vectors: of the first three lanes."""
    product = first * second
    return (product[0] + product[1]) + product[2]


def fourth(quad: np.ndarray) -> float:
    """Return the last lane."""
    return quad[3]


@type_callable(load)
def _type_load(context):
    def typer(array, i, start):
        return QUADS.get(array.dtype) if isinstance(array, types.Array) and array.layout == "C" else None
    return typer


@type_callable(store)
def _type_store(context):
    def typer(array, i, start, quad):
        return types.none if isinstance(quad, QuadType) and array.dtype == quad.real and array.layout == "C" else None
    return typer


def place(context, builder, array_type, array, i, start):
    """Return a pointer to the quad at array[i, start]."""
    view = context.make_array(array_type)(context, builder, array)
    # Offsets by constants where the width of a row is one: see addresses.py.
    width = builder.extract_value(view.shape, 1)
    offset = builder.add(builder.mul(i, width), start)
    vector = ir.VectorType(context.get_value_type(array_type.dtype), LANES)
    return builder.bitcast(builder.gep(view.data, [offset]), vector.as_pointer())


@lower_builtin(load, types.Array, types.Integer, types.Integer)
def _lower_load(context, builder, sig, args):
    array, i, start = _with_wide_indices(context, builder, sig, args)
    quad = builder.load(place(context, builder, sig.args[0], array, i, start))
    quad.align = _size(sig.args[0].dtype)  # rows lie on multiples of their size, but nothing here promises it
    return quad


@lower_builtin(store, types.Array, types.Integer, types.Integer, QuadType)
def _lower_store(context, builder, sig, args):
    array, i, start = _with_wide_indices(context, builder, sig, args[:3])
    stored = builder.store(args[3], place(context, builder, sig.args[0], array, i, start))
    stored.align = _size(sig.args[0].dtype)
    return context.get_dummy_value()


def _with_wide_indices(context, builder, sig, args):
    """Return (array, i, start) with both indices as 64-bit integers."""
    return args[0], *(context.cast(builder, value, ty, types.int64) for value, ty in zip(args[1:], sig.args[1:3], strict=True))


def _size(real) -> int:
    """Return the size of a number [bytes]."""
    return real.bitwidth // 8


@type_callable(dot)
def _type_dot(context):
    def typer(first, second):
        return first.real if isinstance(first, QuadType) and first == second else None
    return typer


@type_callable(fourth)
def _type_fourth(context):
    def typer(quad):
        return quad.real if isinstance(quad, QuadType) else None
    return typer


@lower_builtin(dot, QuadType, QuadType)
def _lower_dot(context, builder, sig, args):
    product = builder.fmul(*args)
    x, y, z = (builder.extract_element(product, ir.IntType(32)(lane)) for lane in range(3))
    return builder.fadd(builder.fadd(x, y), z)


@lower_builtin(fourth, QuadType)
def _lower_fourth(context, builder, sig, args):
    return builder.extract_element(args[0], ir.IntType(32)(3))


@infer_global(operator.add)
class _TypeAdd(ConcreteTemplate):
    cases = [signature(quad, quad, quad) for quad in QUADS.values()]


@infer_global(operator.sub)
class _TypeSubtract(ConcreteTemplate):
    cases = [signature(quad, quad, quad) for quad in QUADS.values()]


@infer_global(operator.mul)
class _TypeScale(ConcreteTemplate):
    cases = [signature(quad, real, quad) for real, quad in QUADS.items()]


@lower_builtin(operator.add, QuadType, QuadType)
def _lower_add(context, builder, sig, args):
    return builder.fadd(*args)


@lower_builtin(operator.sub, QuadType, QuadType)
def _lower_subtract(context, builder, sig, args):
    return builder.fsub(*args)


@lower_builtin(operator.mul, types.Float, QuadType)
def _lower_scale(context, builder, sig, args):
    number, quad = args
    lane = ir.IntType(32)
    first = builder.insert_element(ir.Constant(quad.type, ir.Undefined), number, lane(0))
    return builder.fmul(builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(lane, LANES), [lane(0)] * LANES)), quad)
