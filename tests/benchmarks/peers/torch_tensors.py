"""PyTorch on one thread: index_select and index_add."""

import numpy as np
import torch

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.peers.runge_kutta import step_arrays
from tests.benchmarks.timing import Stepper


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in PyTorch, float64, without gradients."""
    torch.set_num_threads(1)
    first, second = (torch.from_numpy(end.astype(np.int64)) for end in model.endpoints.T)
    start, stiffness, damping, gravity = (
        torch.from_numpy(np.ascontiguousarray(array, dtype=np.float64))
        for array in (model.position, model.stiffness, model.damping, model.gravity)
    )
    tension = stiffness * torch.from_numpy(model.rest_length)
    inverse_mass = torch.from_numpy(model.inverse_mass)[:, None]
    state = [start, torch.zeros_like(start)]

    def slope(position: torch.Tensor, velocity: torch.Tensor) -> torch.Tensor:
        d = position.index_select(0, second) - position.index_select(0, first)
        dv = velocity.index_select(0, second) - velocity.index_select(0, first)
        square = (d * d).sum(1)
        pull = stiffness - tension * torch.rsqrt(square) + damping * (d * dv).sum(1) / square
        pulls = pull[:, None] * d
        force = torch.zeros_like(position).index_add_(0, first, pulls).index_add_(0, second, pulls, alpha=-1)
        return inverse_mass * force + gravity - model.drag * velocity

    def restart() -> None:
        state[:] = start, torch.zeros_like(start)

    def advance(n_steps: int) -> None:
        with torch.inference_mode():
            for _ in range(n_steps):
                state[:] = step_arrays(*state, case.step, slope)

    return Stepper(restart, advance, lambda: state[0].numpy())
