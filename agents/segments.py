"""Sums, maxima and softmax over segments, rows of which each state owns the next few; with gradients.

Torch's own reductions by index are slow to differentiate; here the slope of a sum is a spreading and the other way round.
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
