"""Layers of the candidate network that torch would need many passes for, each over more than a cache holds: one pass each here.

Products with weights are left to torch. What comes out of one is overwritten by the layer that takes it: its slope does not
depend on it, and new memory takes as long to get as the layer to compute.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from agents.segments import Segments
from gmapspring.jit import kernel, part

ZERO, HALF = np.float32(0.0), np.float32(0.5)
"""As float32, for to compare with what is written as 0.0 would take float64.

What either side of a choice takes from an array is taken before it: LLVM makes vectors of a loop only where it need not
ask whether to read.
"""


class Graph(NamedTuple):
    """Which rows send messages to which: symmetric, and up to four to each."""

    neighbours: Tensor
    """The rows next to each row, one after the other, int64, shape (n_links,)."""
    offset: Tensor
    """Where each row's begin, and where the last one's end, int64, shape (n_rows + 1,)."""


def exchange(known: Tensor, told: Tensor, bias: Tensor, graph: Graph) -> Tensor:
    """Add to what each row knows the positive part of: what it told itself + bias + half of all that its neighbours told it.

    known: (n_rows, n_lanes); told: to itself and to neighbours, overwritten, (n_rows, 2 * n_lanes); bias: (n_lanes,).
    """
    return _Exchange.apply(known, told, bias, graph)


class _Exchange(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, known: Tensor, told: Tensor, bias: Tensor, graph: Graph) -> Tensor:
        context.graph = graph
        # A view that autograd does not watch, for nothing else reads what was told.
        told = told.detach()
        context.save_for_backward(told)
        learnt = torch.empty_like(known)
        _exchange(*_arrays(known, told, bias, *graph, learnt))
        return learnt

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        (told,) = context.saved_tensors
        rise, of_bias = torch.empty_like(told), told.new_zeros(slope.shape[1])
        _exchange_back(*_arrays(slope.contiguous(), told, *context.graph, rise, of_bias))
        return slope, rise, of_bias, None


@kernel
def _exchange(known, told, bias, neighbours, offset, learnt):
    """Fill what is learnt; what each row told itself becomes what it has added."""
    n_lanes = known.shape[1]
    heard = np.empty(n_lanes, known.dtype)
    for row in range(len(known)):
        for lane in range(n_lanes):
            heard[lane] = 0.0
        for link in range(offset[row], offset[row + 1]):
            other = told[neighbours[link], n_lanes:]
            for lane in range(n_lanes):
                heard[lane] += other[lane]
        mine, before, after = told[row], known[row], learnt[row]
        for lane in range(n_lanes):
            added = mine[lane] + bias[lane] + HALF * heard[lane]
            mine[lane] = ZERO if added <= ZERO else added
        for lane in range(n_lanes):
            after[lane] = before[lane] + mine[lane]


@kernel
def _exchange_back(slope, added, neighbours, offset, rise, of_bias):
    """Fill the slope of what was told. Who sends to whom is symmetric, and so it travels the same way."""
    n_lanes = slope.shape[1]
    for row in range(len(slope)):
        for lane in range(n_lanes):
            handed = slope[row, lane]
            rise[row, lane] = ZERO if added[row, lane] <= ZERO else handed
        for lane in range(n_lanes):
            of_bias[lane] += rise[row, lane]
    heard = np.empty(n_lanes, slope.dtype)
    for row in range(len(slope)):
        for lane in range(n_lanes):
            heard[lane] = 0.0
        for link in range(offset[row], offset[row + 1]):
            other = neighbours[link]
            for lane in range(n_lanes):
                heard[lane] += rise[other, lane]
        for lane in range(n_lanes):
            rise[row, n_lanes + lane] = HALF * heard[lane]


class Meeting(NamedTuple):
    """Where candidates find what is known of their state and of their two sides, and where they lie."""

    states: Segments
    """Which candidates belong to which state."""
    sides: Tensor
    """The two sides of each, rows of the tetrahedra, int64, shape (2, n_candidates)."""
    places: Tensor
    """Where each lies, shape (n_candidates, 3); not differentiated."""


class Company(NamedTuple):
    """What candidates meet."""

    state: Tensor
    """What is known of each state, (n_states, n_lanes)."""
    sides: Tensor
    """What each tetrahedron is as a first side and as a second, (n_tetrahedra, 2 * n_lanes)."""
    centres: Tensor
    """Places of each state to which the distance counts, one after the other, (n_states, n_centres * 3)."""
    distant: Tensor
    """What the square of the distance to each of these is worth, (n_centres, n_lanes)."""


def meet(own: Tensor, company: Company, at: Meeting) -> Tensor:
    """Return the positive part of own + all that is met: state, first side, second side, squared distances times their worth.

    own: what each candidate is by itself, overwritten, (n_candidates, n_lanes).
    """
    return _Meet.apply(own, *company, at)


class _Meet(torch.autograd.Function):
    @staticmethod
    def forward(
        context: Any, own: Tensor, state: Tensor, sides: Tensor, centres: Tensor, distant: Tensor, at: Meeting
    ) -> Tensor:
        context.at, context.n_tetrahedra = at, len(sides)
        _meet(*_arrays(own, state, sides, centres, distant, at.places), at.states.offset, at.sides.numpy())
        context.mark_dirty(own)
        context.save_for_backward(own, centres, distant)
        return own

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor | None, ...]:
        (own, centres, distant), at, n_lanes = context.saved_tensors, context.at, slope.shape[1]
        rise, of_sides = torch.empty_like(own), own.new_zeros(context.n_tetrahedra, 2 * n_lanes)
        of_state, of_centres = own.new_zeros(len(centres), n_lanes), torch.zeros_like(centres)
        of_distant, offset = torch.zeros_like(distant), at.states.offset
        _meet_back(*_arrays(slope.contiguous(), own, rise, of_state, of_sides), offset, at.sides.numpy())
        _distances_back(*_arrays(rise, rise @ distant.t(), centres, at.places, of_centres, of_distant), offset)
        return rise, of_state, of_sides, of_centres, of_distant, None


@kernel
def _meet(own, of_state, of_sides, centres, distant, places, offset, sides):
    """Add up, and let nothing below zero pass."""
    n_lanes = own.shape[1]
    for state in range(len(of_state)):
        its_state = of_state[state]
        for row in range(offset[state], offset[state + 1]):
            # Each is a short array of its own: to ask whether these overlap is quick.
            mine, first, second = own[row], of_sides[sides[0, row]], of_sides[sides[1, row], n_lanes:]
            for centre in range(len(distant)):
                square, worth = _square(places, row, centres, state, centre), distant[centre]
                for lane in range(n_lanes):
                    mine[lane] += square * worth[lane]
            for lane in range(n_lanes):
                met = mine[lane] + its_state[lane] + first[lane] + second[lane]
                mine[lane] = ZERO if met <= ZERO else met


@part
def _square(places, row, centres, state, centre):
    """Return the square of a distance."""
    x = places[row, 0] - centres[state, 3 * centre]
    y = places[row, 1] - centres[state, 3 * centre + 1]
    z = places[row, 2] - centres[state, 3 * centre + 2]
    return x * x + y * y + z * z


@kernel
def _meet_back(slope, met, rise, of_state, of_sides, offset, sides):
    """Hand the slope on to all that were added up; of own it is set, of the others added to."""
    n_lanes = slope.shape[1]
    for state in range(len(of_state)):
        for row in range(offset[state], offset[state + 1]):
            one, two = sides[0, row], sides[1, row]
            # Loops of few arrays each: LLVM makes vectors of them only where it can tell that they do not overlap.
            for lane in range(n_lanes):
                handed = slope[row, lane]
                rise[row, lane] = ZERO if met[row, lane] <= ZERO else handed
            for lane in range(n_lanes):
                of_state[state, lane] += rise[row, lane]
            for lane in range(n_lanes):
                of_sides[one, lane] += rise[row, lane]
            for lane in range(n_lanes):
                of_sides[two, n_lanes + lane] += rise[row, lane]


@kernel
def _distances_back(rise, of_squares, centres, places, of_centres, of_distant, offset):
    """Hand the slope on to what distances are worth and to the centres, given that of the squared distances."""
    for state in range(len(centres)):
        for row in range(offset[state], offset[state + 1]):
            for centre in range(len(of_distant)):
                square, worth = _square(places, row, centres, state, centre), of_distant[centre]
                for lane in range(len(worth)):
                    worth[lane] += square * rise[row, lane]
                for axis in range(3):
                    away = places[row, axis] - centres[state, 3 * centre + axis]
                    of_centres[state, 3 * centre + axis] -= (away + away) * of_squares[row, centre]


def score(rows: Tensor, bias: Tensor, weight: Tensor) -> Tensor:
    """Return the product of the positive part of rows + bias with a weight: (n_rows,).

    rows: overwritten, (n_rows, n_lanes); bias, weight: (n_lanes,).
    """
    return _Score.apply(rows, bias, weight)


class _Score(torch.autograd.Function):
    @staticmethod
    def forward(context: Any, rows: Tensor, bias: Tensor, weight: Tensor) -> Tensor:
        rows = rows.detach()
        context.save_for_backward(rows, weight)
        _rectify(*_arrays(rows, bias))
        return rows @ weight

    @staticmethod
    def backward(context: Any, slope: Tensor) -> tuple[Tensor, ...]:
        rows, weight = context.saved_tensors
        rise, of_bias, of_weight = torch.empty_like(rows), torch.zeros_like(weight), torch.zeros_like(weight)
        _score_back(*_arrays(slope, rows, weight, rise, of_bias, of_weight))
        return rise, of_bias, of_weight


@kernel
def _rectify(rows, bias):
    """Add the bias, and let nothing below zero pass."""
    for row in range(len(rows)):
        for lane in range(len(bias)):
            value = rows[row, lane] + bias[lane]
            rows[row, lane] = ZERO if value <= ZERO else value


@kernel
def _score_back(slope, rows, weight, rise, of_bias, of_weight):
    """Fill the slope of the rows, and add up those of bias and weight."""
    for row in range(len(rows)):
        for lane in range(len(weight)):
            handed = slope[row] * weight[lane]
            rise[row, lane] = ZERO if rows[row, lane] <= ZERO else handed
        for lane in range(len(weight)):
            of_bias[lane] += rise[row, lane]
        for lane in range(len(weight)):
            of_weight[lane] += slope[row] * rows[row, lane]


def _arrays(*parts: Tensor) -> list[Any]:
    """Return tensors as arrays that share their memory."""
    return [part.detach().numpy() for part in parts]
