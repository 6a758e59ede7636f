"""SciPy: gather and scatter as products with a sparse incidence matrix."""

import numpy as np
from scipy import sparse

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.peers.runge_kutta import step_arrays
from tests.benchmarks.timing import Stepper


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in SciPy, float64; row s of the incidence matrix is -1 at the spring's first node, 1 at its second."""
    m, n = len(model.endpoints), len(model.position)
    rows, columns = np.repeat(np.arange(m), 2), model.endpoints.ravel().astype(np.int64)
    incidence = sparse.csr_array((np.tile([-1.0, 1.0], m), (rows, columns)), shape=(m, n))
    to_nodes = sparse.csr_array(-incidence.T)
    tension, inverse_mass = model.stiffness * model.rest_length, model.inverse_mass[:, None]
    state = [model.position, np.zeros_like(model.position)]

    def slope(position: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        both = incidence @ np.hstack([position, velocity])
        d, dv = both[:, :3], both[:, 3:]
        square = np.einsum("ij,ij->i", d, d)
        pull = model.stiffness - tension / np.sqrt(square) + model.damping * np.einsum("ij,ij->i", d, dv) / square
        return inverse_mass * (to_nodes @ (pull[:, None] * d)) + model.gravity - model.drag * velocity

    def restart() -> None:
        state[:] = model.position, np.zeros_like(model.position)

    def advance(n_steps: int) -> None:
        for _ in range(n_steps):
            state[:] = step_arrays(*state, case.step, slope)

    return Stepper(restart, advance, lambda: state[0])
