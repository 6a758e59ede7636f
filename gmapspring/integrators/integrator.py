"""What an integrator is: a scheme's name, order, stable step and kernel; and what all of them do around their steps."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from gmapspring.forces import sum_forces
from gmapspring.jit import part
from gmapspring.matter import N_NODES, N_SPRINGS
from gmapspring.quad import load, store


class Limits(NamedTuple):
    """What the elements of a body have by themselves, arrays over elements, or one number each."""

    frequency: np.ndarray | float
    """Highest frequency [rad/s]."""
    damping_rate: np.ndarray | float = 0.0
    """Highest damping rate, beta omega^2 + gamma [1/s]."""
    drag: np.ndarray | float = 0.0
    """Lowest damping rate, gamma [1/s]: springs do not damp what moves across them."""


class Integrator(NamedTuple):
    """One time-stepping scheme; it moves nodes by the forces it is given. Explicit ones know no springs."""

    name: str
    """What scenes and `Simulation` call it."""
    order: int
    """The global error shrinks as step**order."""
    n_work: int
    """How many states like Nodes.state it needs room for."""
    stable_step: Callable[[Limits], float]
    """stable_step(limits) -> longest step [s] at which small motions of a body with these limits do not grow."""
    default_step: Callable[[Limits], float]
    """default_step(limits) -> step [s] to take where none is asked for. Below the stable one: near that bound, which is one for
    small motions, violent ones gain energy as stiffness swings. At this step they do not, unless springs keep passing through
    length zero without any damping: the symplectic schemes may then gain a few times their energy. See docs/stability.md."""
    advance: Callable[..., Any]
    """advance(table, rows, real, steps, n_substeps, tolerances, taken): kernel that takes all substeps of all rows in one call.

    table, real: where the matter of each row lies, and in which precision; see addresses.py.
    rows: the rows of the table to advance, int64 (k,). steps [s] (k,), n_substeps, int64 (k,): how far.
    tolerances [m] (k,): a row ends early where it can move no further than this in what is left of its time; negative: never.
    taken: out, how many substeps each row took, -1 where its state stopped being finite: it is then as it was, int64 (k,).
    Every scheme writes out the same loop over rows: a kernel that is given another as an argument is not kept in the cache."""
    n_sweeps: int = 1
    """About how often a substep goes over all springs: how long one takes, for who must not wait for too many."""


N_BETWEEN = np.int64(16)
"""Substeps between two looks at whether a row has come to rest."""


@part
def begin(matter):
    """Stop pinned nodes, and keep the state to go back to. Without a force that moves them, pinned nodes then stay put."""
    nodes, n_nodes = matter.nodes, matter.counts[N_NODES]
    state, zero = nodes.state, nodes.state.dtype.type(0)
    before = matter.work[matter.work.shape[0] - n_nodes:]
    for i in range(n_nodes):
        if nodes.is_pinned[i]:
            for axis in range(4, 8):
                state[i, axis] = zero
        store(before, i, 0, load(state, i, 0))
        store(before, i, 4, load(state, i, 4))


@part
def next_substeps(matter, n_taken, n_substeps, step, tolerance):
    """Return how many substeps to take before asking again, 0 where the row is done."""
    if tolerance < 0.0:
        return n_substeps - n_taken
    if n_taken > 0 and motion_ahead(matter, (n_substeps - n_taken) * step) <= tolerance:
        return np.int64(0)
    return min(N_BETWEEN, n_substeps - n_taken)


@part
def motion_ahead(matter, seconds):
    """Return how far the fastest node can come in so many seconds at its velocity and its acceleration [m]."""
    nodes = matter.nodes
    # The forces that a scheme leaves need not be those of the state.
    sum_forces(nodes, matter.springs, matter.counts[N_NODES], matter.counts[N_SPRINGS], nodes.state, nodes.force)
    farthest = 0.0
    for i in range(matter.counts[N_NODES]):
        velocity, acceleration = 0.0, 0.0
        for axis in range(3):
            velocity += np.float64(nodes.state[i, 4 + axis]) ** 2
            acceleration += np.float64(nodes.inverse_mass[i] * nodes.force[i, axis]) ** 2
        farthest = max(farthest, np.sqrt(velocity) * seconds + 0.5 * np.sqrt(acceleration) * seconds * seconds)
    return farthest


@part
def end(matter, n_taken):
    """Return n_taken; or, where the state is not finite, put the old one back and return -1."""
    n_nodes = matter.counts[N_NODES]
    state = matter.nodes.state
    total = state.dtype.type(0)
    for i in range(n_nodes):
        for axis in range(8):
            total += state[i, axis] - state[i, axis]  # 0, or not a number
    if total == state.dtype.type(0):
        return n_taken
    before = matter.work[matter.work.shape[0] - n_nodes:]
    for i in range(n_nodes):
        store(state, i, 0, load(before, i, 0))
        store(state, i, 4, load(before, i, 4))
    return np.int64(-1)
