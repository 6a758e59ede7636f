"""The spring kernel: the pull of many springs at once, 8 (float64) or 16 (float32) side by side.

Two passes over a block of springs. The first gives every spring one coefficient g, so that end i is pulled with g (x_j - x_i):

    g = (stiffness (length - rest_length) + damping (d . dv) / length) / length,    d = x_j - x_i, dv = v_j - v_i

A row of the state holds position and velocity side by side, so one subtraction gives d and dv of a spring, and one
multiplication all terms of d . d and d . dv; they are summed by exchanging lanes between springs, which leaves
the sums of all springs in one vector, with one vector square root and one division for them all. The second pass takes
the difference again and adds g d to both ends. In one pass each spring would wait for the last one's sums and square root.

Springs that stand next to each other mostly share a node, and whoever adds to a node waits for what was added last. So the
second pass deals the springs of a block to hands, STRIDE to each, and takes one from each hand in turn. However cuts have
shuffled the springs, those that follow one another come from different parts of the block; their order in memory is the mesh's
own, and the few nodes of a block stay at hand. A last block has fewer hands, and where there is but one, nothing is dealt.

`set_coefficients` is its own readable twin: where numba is switched off, it is the function below as it stands. The vector
code is written for no processor in particular; every lane is rounded by itself in IEEE arithmetic, so the bits are the same
for all, and the same as the twin's. What limits it: docs/speed.md.
"""

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import lower_builtin, type_callable

from gmapspring.jit import part
from gmapspring.matter import BLOCK

HANDS = 16
"""What a whole block is dealt to."""
STRIDE = BLOCK // HANDS
"""How far springs that are added to their nodes one after the other lie apart."""
WIDE, NARROW = ir.IntType(64), ir.IntType(32)


@part
def add_spring_forces(springs, n_springs, state, force):
    """Add the pull of each spring to its two ends: force (capacity, 4) [N] from state (capacity, 8)."""
    coefficient = springs.coefficient
    for start in range(0, n_springs, BLOCK):
        stop = min(start + BLOCK, n_springs)
        set_coefficients(springs.endpoints, springs.rest_length, springs.stiffness, springs.damping, state,
                         start, stop, coefficient)
        add_pulls(springs.endpoints, coefficient, state, start, stop, force)


def set_coefficients(endpoints, rest_length, stiffness, damping, state, start, stop, coefficient):
    """Set coefficient[s - start] [N/m] of springs start <= s < stop; damping may have no rows.

    May also write those that complete the last GROUP: all arrays have room for it.
    """
    for s in range(start, stop):
        i, j = endpoints[s]
        x, y, z, _, u, v, w, _ = state[j] - state[i]
        square = (x * x + y * y) + z * z
        # A spring of length zero has no direction to pull along: without the guard, 0 / 0 would spread through the body.
        coefficient[s - start] = 0.0
        if square > 0.0:
            length = np.sqrt(square)
            inverse = state.dtype.type(1.0) / length
            pull = stiffness[s] * (length - rest_length[s])
            if len(damping):
                pull += damping[s] * ((x * u + y * v) + z * w) * inverse
            coefficient[s - start] = pull * inverse


def add_pulls(endpoints, coefficient, state, start, stop, force):
    """Add coefficient[s - start] (x_j - x_i) [N] to end i of springs start <= s < stop, and take it from end j."""
    for first in range(start, min(start + STRIDE, stop)):
        for s in range(first, stop, STRIDE):
            i, j = endpoints[s]
            pull = coefficient[s - start] * (state[j, :4] - state[i, :4])
            force[i] += pull
            force[j] -= pull


# The same in vectors ----------------------------------------------------------------------------------------------


@type_callable(set_coefficients)
def _type_set_coefficients(context):
    def typer(endpoints, rest_length, stiffness, damping, state, start, stop, coefficient):
        return types.none
    return typer


@lower_builtin(set_coefficients, *[types.Array] * 5, types.Integer, types.Integer, types.Array)
def _lower_set_coefficients(context, builder, sig, args):
    """Emit a loop over groups for springs with damping and one for springs without: which one runs is decided once a call."""
    endpoints, rest_length, stiffness, damping, state, coefficient = _arrays(context, builder, sig, args, (0, 1, 2, 3, 4, 7))
    start, stop = (context.cast(builder, args[i], sig.args[i], types.intp) for i in (5, 6))
    emit = _Emitter(builder, state.data, endpoints.data)
    has_damping = builder.icmp_signed(">", builder.extract_value(damping.shape, 0), start.type(0))
    with builder.if_else(has_damping) as (damped, elastic):
        for branch, n_lanes in ((damped, 8), (elastic, 4)):
            with branch, cgutils.for_range_slice(builder, start, stop, start.type(emit.width)) as (first, _):
                pulls = emit.coefficients(first, n_lanes, stiffness.data, rest_length.data, damping.data)
                emit.store(coefficient.data, builder.sub(first, start), pulls)
    return context.get_dummy_value()


@type_callable(add_pulls)
def _type_add_pulls(context):
    def typer(endpoints, coefficient, state, start, stop, force):
        return types.none
    return typer


@lower_builtin(add_pulls, *[types.Array] * 3, types.Integer, types.Integer, types.Array)
def _lower_add_pulls(context, builder, sig, args):
    """Emit a loop for whole blocks, where the hands lie at constants from the first, and one for the last block."""
    endpoints, coefficient, state, force = _arrays(context, builder, sig, args, (0, 1, 2, 5))
    start, stop = (context.cast(builder, args[i], sig.args[i], types.intp) for i in (3, 4))
    emit = _Emitter(builder, state.data, endpoints.data)
    one, stride = start.type(1), start.type(STRIDE)
    is_whole = builder.icmp_signed("==", builder.sub(stop, start), start.type(BLOCK))
    end_of_hand = builder.add(start, stride)
    end_of_firsts = builder.select(builder.icmp_signed("<", end_of_hand, stop), end_of_hand, stop)
    with builder.if_else(is_whole) as (whole, last):
        with whole, cgutils.for_range_slice(builder, start, end_of_hand, one) as (first, _):
            for hand in range(HANDS):
                emit.add_pull(builder.add(first, start.type(hand * STRIDE)), start, coefficient.data, force.data)
        with (last, cgutils.for_range_slice(builder, start, end_of_firsts, one) as (first, _),
              cgutils.for_range_slice(builder, first, stop, stride) as (spring, _)):
            emit.add_pull(spring, start, coefficient.data, force.data)
    return context.get_dummy_value()


def _arrays(context, builder, sig, args, places):
    """Return some of the arguments as array structures."""
    return (context.make_array(sig.args[i])(context, builder, args[i]) for i in places)


class _Emitter:
    """Emits code for springs side by side: rows of 4 lanes are positions alone, rows of 8 hold velocities too."""

    def __init__(self, builder, state, endpoints):
        self.builder, self.state, self.endpoints = builder, state, endpoints
        self.real = state.type.pointee
        self.size = 8 if isinstance(self.real, ir.DoubleType) else 4
        self.width = 64 // self.size

    def coefficients(self, first, n_lanes, stiffness, rest_length, damping):
        """Return the coefficients of the springs from number `first` on; see set_coefficients."""
        b = self.builder
        squares, products = self.sums(first, n_lanes)
        length = self.square_root(squares)
        inverse = b.fdiv(self.constant(1.0), length)
        excess = b.fsub(length, self.load(rest_length, first, self.width))
        pull = b.fmul(self.load(stiffness, first, self.width), excess)
        if n_lanes == 8:
            pull = b.fadd(pull, b.fmul(b.fmul(self.load(damping, first, self.width), products), inverse))
        is_long = b.fcmp_ordered(">", squares, self.constant(0.0))
        return b.select(is_long, b.fmul(pull, inverse), self.constant(0.0))

    def sums(self, first, n_lanes):
        """Return d . d of each spring and, from rows of 8 lanes, d . dv."""
        n_rows = self.width // n_lanes
        # Vector k of four holds rows k, k + 4, ...: then the four sums of each place stand side by side, in order.
        fours = [[[4 * (n_rows * part + row) + k for row in range(n_rows)] for k in range(4)] for part in range(n_lanes // 4)]
        sums = [self.transposed_sum([self.terms(first, springs, n_lanes) for springs in four]) for four in fours]
        if n_lanes == 4:
            return sums[0], None
        lanes = [8 * row + k for row in range(self.width // 4) for k in range(4)]
        return self.shuffle(*sums, lanes), self.shuffle(*sums, [lane + 4 for lane in lanes])

    def terms(self, first, springs, n_lanes):
        """Return [xx yy zz 0] of each of some springs and, from rows of 8 lanes, [xu yv zw 0] after it."""
        b = self.builder
        rows = [self.difference(*self.ends(b.add(first, WIDE(spring))), n_lanes) for spring in springs]
        while len(rows) > 1:
            lanes = range(2 * rows[0].type.count)
            rows = [self.shuffle(*pair, lanes) for pair in zip(rows[::2], rows[1::2], strict=True)]
        positions = [lane - lane % n_lanes + lane % 4 for lane in range(self.width)]
        return b.fmul(rows[0], self.shuffle(rows[0], rows[0], positions))

    def add_pull(self, spring, start, coefficient, force):
        """Add the pull of one spring to its two ends, four lanes at a time."""
        b, (i, j) = self.builder, self.ends(spring)
        number = self.load(coefficient, b.sub(spring, start), 1)
        pull = b.fmul(self.shuffle(number, number, [0] * 4), self.difference(i, j, 4))
        # Rows of forces are half as long as those of the state: the same number leads to them in steps of half a number's size.
        halves = b.bitcast(force, ir.IntType(4 * self.size).as_pointer())
        for end, add in ((i, b.fadd), (j, b.fsub)):
            row = b.bitcast(b.gep(halves, [end]), pull.type.as_pointer())
            self._aligned(b.store(add(self._aligned(b.load(row)), pull), row))

    def ends(self, spring):
        """Return where the rows of a spring's two nodes begin in the state.

        Both ends are fetched as one number, the first being its lower half, as on all machines that numba compiles for; and they
        are shifted in 32 bits (there is room: darts are int32). Of longer numbers the compiler makes a shift for each use, where
        the machine scales addresses by itself. Together that took a sixth off the second pass, on a Zen 4.
        """
        b = self.builder
        pair = b.load(b.gep(b.bitcast(self.endpoints, WIDE.as_pointer()), [spring]))
        pair.align = 4
        return [b.zext(b.shl(b.trunc(end, NARROW), NARROW(3)), WIDE) for end in (pair, b.lshr(pair, WIDE(32)))]

    def difference(self, i, j, n_lanes):
        """Return the row of the state that begins at j minus the one at i."""
        first, second = (self.load(self.state, row, n_lanes) for row in (i, j))
        return self.builder.fsub(second, first)

    def transposed_sum(self, four):
        """Return, for each place of four lanes, the sums of those four lanes in the four vectors, side by side."""
        even, odd = (0, 4, 2, 6), (1, 5, 3, 7)  # of a pair of vectors, lanes 4 to 7 being those of the second
        halves = [self.added(four[0], four[1], even, odd), self.added(four[2], four[3], even, odd)]
        return self.added(*halves, (0, 1, 4, 5), (2, 3, 6, 7))

    def added(self, first, second, lanes, others):
        """Return lanes plus others of a pair of vectors, for each place of four lanes."""
        places = range(0, self.width, 4)
        chosen = ([place + (lane if lane < 4 else self.width + lane - 4) for place in places for lane in each]
                  for each in (lanes, others))
        return self.builder.fadd(*(self.shuffle(first, second, each) for each in chosen))

    def shuffle(self, first, second, lanes):
        """Return lanes of two vectors, those of the second numbered after those of the first."""
        lane = ir.IntType(32)
        chosen = ir.Constant(ir.VectorType(lane, len(lanes)), [lane(number) for number in lanes])
        return self.builder.shuffle_vector(first, second, chosen)

    def square_root(self, vector):
        """Return the square root of each lane."""
        name = f"llvm.sqrt.v{self.width}f{8 * self.size}"
        root = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(vector.type, [vector.type]), name)
        return self.builder.call(root, [vector])

    def constant(self, value):
        """Return a vector of equal lanes."""
        return ir.Constant(ir.VectorType(self.real, self.width), [self.real(value)] * self.width)

    def load(self, array, offset, n_lanes):
        """Return n_lanes numbers of an array as a vector."""
        return self._aligned(self.builder.load(self._place(array, offset, n_lanes)))

    def store(self, array, offset, vector):
        """Write a vector into an array."""
        self._aligned(self.builder.store(vector, self._place(array, offset, vector.type.count)))

    def _place(self, array, offset, n_lanes):
        vector = ir.VectorType(self.real, n_lanes)
        return self.builder.bitcast(self.builder.gep(array, [offset]), vector.as_pointer())

    def _aligned(self, instruction):
        """Promise no more than that numbers lie on multiples of their size."""
        instruction.align = self.size
        return instruction
