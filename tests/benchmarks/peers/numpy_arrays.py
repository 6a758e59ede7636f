"""NumPy: gather, compute, sum by bincount."""

import numpy as np

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.peers.runge_kutta import step_arrays
from tests.benchmarks.timing import Stepper


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in NumPy, float64."""
    first, second = model.endpoints.astype(np.int64).T
    ends, n = np.concatenate([first, second]), len(model.position)
    tension, inverse_mass = model.stiffness * model.rest_length, model.inverse_mass[:, None]
    state = [model.position, np.zeros_like(model.position)]

    def slope(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        d, dv = position[second] - position[first], velocity[second] - velocity[first]
        square = np.einsum("ij,ij->i", d, d)
        pull = model.stiffness - tension / np.sqrt(square) + model.damping * np.einsum("ij,ij->i", d, dv) / square
        pulls = pull[:, None] * d
        both = np.concatenate([pulls, -pulls])
        force = np.stack([np.bincount(ends, both[:, axis], n) for axis in range(3)], axis=1)
        return inverse_mass * force + model.gravity - model.drag * velocity

    def restart() -> None:
        state[:] = model.position, np.zeros_like(model.position)

    def advance(n_steps: int) -> None:
        for _ in range(n_steps):
            state[:] = step_arrays(*state, case.step, slope)

    return Stepper(restart, advance, lambda: state[0])
