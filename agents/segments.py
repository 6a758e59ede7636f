"""Sums, maxima and softmax over segments, rows of which each state owns the next few, and over neighbours; with gradients.

Torch's own reductions by index are slow to differentiate; here the slope of a sum is a spreading and the other way round.
What would take torch many passes over the candidates, each larger than a cache, is one compiled pass here.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import embedding_bag

from gmapspring.jit import kernel

Array = np.ndarray[Any, Any]


class Segments(NamedTuple):
    """Which rows belong to which state; none is without a row."""

    offset: Array
    """Where each state's rows begin, and where the last one's end, int64, shape (n_states + 1,)."""
    first: Tensor
    """The same without the end, int64, shape (n_states,)."""
    length: Tensor
    """Rows of each state, int64, shape (n_states,)."""
    state_of: Tensor
    """State of each row, int64, shape (n_rows,)."""
    row: Tensor
    """0, 1, 2 ..., int64, shape (n_rows,)."""


def segments(offset: Array) -> Segments:
    """Return the segments that begin, and last end, at so many rows; offset: int64, ascending, shape (n_states + 1,)."""
    ends = torch.from_numpy(offset)
    length = ends.diff()
    return Segments(offset, ends[:-1], length, torch.repeat_interleave(length), torch.arange(int(offset[-1])))


def total(rows: Tensor, of: Segments) -> Tensor:
    """Return the sum over each state's rows: (n_rows,) -> (n_states,) or (n_rows, n_lanes) -> (n_states, n_lanes)."""
    return _Total.apply(rows, of)


def spread(states: Tensor, of: Segments) -> Tensor:
    """Give each row what is its state's: (n_states,) -> (n_rows,) or (n_states, n_lanes) -> (n_rows, n_lanes)."""
    return _Spread.apply(states, of)


class _Total(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, rows: Tensor, of: Segments) -> Tensor:
        context.of = of
        # Meant for rows of a table that are looked up; of all rows in order it is the fastest sum that torch has.
        # Detached: else it would also prepare for its own, slower differentiation.
        sums = embedding_bag(of.row, rows.detach().reshape(len(rows), -1), of.first, mode="sum")
        return sums.reshape(-1, *rows.shape[1:])

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor, None]:
        return spread(slope, context.of), None


class _Spread(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, states: Tensor, of: Segments) -> Tensor:
        context.of = of
        return states.index_select(0, of.state_of)

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor, None]:
        return total(slope, context.of), None


def highest(rows: Tensor, of: Segments) -> Tensor:
    """Return which of each state's rows is the highest, the first of equals, lane by lane, int64, shaped as a total is."""
    numbers = np.ascontiguousarray(rows.detach().numpy()).reshape(len(rows), -1)
    found = np.empty((len(of.length), numbers.shape[1]), np.int64)
    # Torch's own maximum by index takes several times as long.
    _find_highest(numbers, of.offset, found)
    return torch.from_numpy(found).reshape(-1, *rows.shape[1:])


@kernel
def _find_highest(numbers, offset, found):
    """Find the highest row of each state, lane by lane."""
    best = np.empty(numbers.shape[1], numbers.dtype)
    for state in range(len(found)):
        for lane in range(len(best)):
            best[lane], found[state, lane] = numbers[offset[state], lane], offset[state]
        for row in range(offset[state] + 1, offset[state + 1]):
            for lane in range(len(best)):
                # A value that is no number must be seen by whoever looks at the result: it counts as the highest.
                if not numbers[row, lane] <= best[lane] and best[lane] == best[lane]:
                    best[lane], found[state, lane] = numbers[row, lane], row


def log_softmax(logit: Tensor, of: Segments) -> Tensor:
    """Return the log-probability of each row among those of its state, lane by lane: as shaped."""
    risen = logit - spread(logit.detach().gather(0, highest(logit, of)), of)
    return risen - spread(total(risen.exp(), of).log(), of)


class Meeting(NamedTuple):
    """Where candidates find what is known of their state and of their two sides."""

    states: Segments
    """Which candidates belong to which state."""
    sides: Tensor
    """The two sides of each, rows of the tetrahedra, int64, shape (2, n_candidates)."""


def meet(own: Tensor, state: Tensor, first: Tensor, second: Tensor, at: Meeting) -> Tensor:
    """Return the positive part of own + that of its state + that of its first side + that of its second, row by row.

    own: overwritten, shape (n_candidates, n_lanes); state: (n_states, n_lanes); first, second: (n_tetrahedra, n_lanes).
    """
    return _Meet.apply(own, state, first, second, at)


class _Meet(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, own: Tensor, state: Tensor, first: Tensor, second: Tensor, at: Meeting) -> Tensor:
        context.at, context.n_tetrahedra = at, len(first)
        _meet(*(part.detach().numpy() for part in (own, state, first, second)), at.states.offset, at.sides.numpy())
        context.mark_dirty(own)
        context.save_for_backward(own)
        return own

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        (met,), at = context.saved_tensors, context.at
        slopes = (
            torch.empty_like(met), met.new_zeros(len(at.states.length), met.shape[1]),
            *(met.new_zeros(context.n_tetrahedra, met.shape[1]) for _ in range(2)),
        )  # fmt: skip
        _hand_on(*(each.numpy() for each in (slope.contiguous(), met, *slopes)), at.states.offset, at.sides.numpy())
        return *slopes, None


@kernel
def _meet(own, of_state, first, second, offset, sides):
    """Add up, and let nothing below zero pass."""
    for state in range(len(of_state)):
        for row in range(offset[state], offset[state + 1]):
            one, two = sides[0, row], sides[1, row]
            for lane in range(own.shape[1]):
                met = own[row, lane] + of_state[state, lane] + first[one, lane] + second[two, lane]
                own[row, lane] = np.float32(0.0) if met <= 0.0 else met


@kernel
def _hand_on(slope, met, own, of_state, first, second, offset, sides):
    """Hand the slope on to all that were added up; of own it is set, of the others added to."""
    for state in range(len(of_state)):
        for row in range(offset[state], offset[state + 1]):
            one, two = sides[0, row], sides[1, row]
            # Loops of few arrays each: LLVM makes vectors of them only where it can tell that they do not overlap.
            for lane in range(own.shape[1]):
                own[row, lane] = np.float32(0.0) if met[row, lane] <= 0.0 else slope[row, lane]
            for lane in range(own.shape[1]):
                of_state[state, lane] += own[row, lane]
            for lane in range(own.shape[1]):
                first[one, lane] += own[row, lane]
            for lane in range(own.shape[1]):
                second[two, lane] += own[row, lane]


class Graph(NamedTuple):
    """Which rows send messages to which: symmetric."""

    neighbours: Tensor
    """The rows next to each row, one after the other, int64, shape (n_links,)."""
    first: Tensor
    """Where each row's begin, int64, shape (n_rows,)."""


def messages(rows: Tensor, graph: Graph) -> Tensor:
    """Return half the sum of what the neighbours of each row say, up to four of them: (n_rows, n_lanes) -> (n_rows, n_lanes)."""
    return _Messages.apply(rows, graph)


class _Messages(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, rows: Tensor, graph: Graph) -> Tensor:
        context.graph = graph
        return 0.5 * embedding_bag(graph.neighbours, rows.detach(), graph.first, mode="sum")

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor, None]:
        # Who sends to whom is symmetric, and so the slope travels the same way.
        return messages(slope.contiguous(), context.graph), None
