"""What an integrator is: a scheme's name, order, stable step and kernel."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel


class Integrator(NamedTuple):
    """One explicit time-stepping scheme; it moves nodes by the forces it is given and knows no springs."""

    name: str
    """What scenes and `Simulation` call it."""
    order: int
    """The global error shrinks as step**order."""
    n_work: int
    """How many scratch arrays like Nodes.state `advance` needs."""
    stable_step: Callable[[np.ndarray | float, np.ndarray | float], float]
    """stable_step(omega, damping_rate) -> longest step [s] for a body of elements that have these highest frequencies
    [rad/s] and highest damping rates, beta omega^2 + gamma [1/s]; arrays over elements, or one number each."""
    default_share: float
    """The part of the stable step to take where no step is asked for, below 1: near the bound, which is one for small motions,
    violent undamped ones gain energy as stiffness swings. At this share they do not (see tests/stability)."""
    advance: Callable[..., Any]
    """advance(nodes, springs, work, n_nodes, n_springs, step, n_substeps): kernel that takes all substeps in one call.
    work is (n_work, capacity, 8) and step a scalar, both of the dtype of nodes.state."""


@kernel
def hold_pinned(nodes, n_nodes):
    """Stop pinned nodes: without a force that moves them (their inverse mass is 0), they then stay put to the last bit."""
    zero = nodes.state.dtype.type(0)
    for i in range(n_nodes):
        if nodes.is_pinned[i]:
            for axis in range(4, 8):
                nodes.state[i, axis] = zero
