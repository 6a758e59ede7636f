"""What theory says of small motions: the modes of a body, and by how much a scheme lets their energy swing.

Where damping is beta K + gamma M, each mode of M x'' + C x' + K x = 0 steps by itself, by a 2 x 2 matrix G, written here for
(omega x, v), so that the square of the length is the energy. After n steps the energy is at most that at the start times the
largest |G^n|^2 of all modes. Undamped, that is 1 for RK4 and backward Euler, (1 + a) / (1 - a) for symplectic Euler and
1 / (1 - a^2) for velocity Verlet, with a = h omega / 2.
"""

import numpy as np

from gmapspring import measure
from gmapspring.integrators import INTEGRATORS, Limits
from tests.unit.test_stability import ONE_STEP


def needs_drag(scheme: str) -> bool:
    """Tell whether a scheme has no stable step for a body that swings undamped."""
    return INTEGRATORS[scheme].stable_step(Limits(1.0)) == 0.0


def is_implicit(scheme: str) -> bool:
    """Tell whether a scheme is stable at any step."""
    return bool(np.isinf(INTEGRATORS[scheme].stable_step(Limits(1.0))))


def laplacian(body, weight) -> np.ndarray:
    """Return the assembled Laplacian (n, n) of the springs with a weight each."""
    matrix = np.zeros((body.n_nodes, body.n_nodes))
    i, j = body.springs.endpoints.T
    np.add.at(matrix, (i, i), weight)
    np.add.at(matrix, (j, j), weight)
    np.add.at(matrix, (i, j), -weight)
    np.add.at(matrix, (j, i), -weight)
    return matrix


def modes(body) -> np.ndarray:
    """Return the frequencies [rad/s] of small motions about rest, from the true stiffness matrix, k n n^T for each spring."""
    nodes, springs, n = body.nodes, body.springs, body.n_nodes
    i, j = springs.endpoints.T.astype(int)
    rest = body.mesh.points[nodes.point]
    direction = (rest[j] - rest[i]) / np.linalg.norm(rest[j] - rest[i], axis=1)[:, None]
    block = springs.stiffness.astype(float)[:, None, None] * direction[:, :, None] * direction[:, None, :]
    matrix = np.zeros((n, n, 3, 3))
    for first, second, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
        np.add.at(matrix, (first, second), sign * block)
    scale = np.repeat(1.0 / np.sqrt(nodes.mass), 3)
    matrix = scale[:, None] * matrix.transpose(0, 2, 1, 3).reshape(3 * n, 3 * n) * scale
    is_free = np.repeat(~nodes.is_pinned, 3)
    return np.sqrt(np.maximum(np.linalg.eigvalsh(matrix[is_free][:, is_free]), 0.0))


def mode_matrices(scheme: str, step: float, frequency, damping_rate) -> np.ndarray:
    """Return the matrices (n, 2, 2) of one step for (omega x, v) of modes with frequencies [rad/s] and damping rates [1/s]."""
    # At a frequency of 0 the elastic energy is 0 whatever x is; a tiny one saves the division.
    turns = np.maximum(step * np.asarray(frequency, float), 1e-12)
    rates = np.broadcast_to(step * np.asarray(damping_rate, float), turns.shape)
    matrices = np.array([ONE_STEP[scheme](turn**2, rate) for turn, rate in zip(turns, rates, strict=True)])
    matrices[:, 0, 1] *= turns
    matrices[:, 1, 0] /= turns
    return matrices


def growth(scheme: str, step: float, frequency, damping_rate=0.0) -> float:
    """Return by which factor a step multiplies the fastest growing mode."""
    return float(np.abs(np.linalg.eigvals(mode_matrices(scheme, step, frequency, damping_rate))).max())


def swing(scheme: str, step: float, frequency, damping_rate=0.0, n_steps: int = 500) -> float:
    """Return the largest factor by which up to n_steps can multiply the energy of a linear body that has such modes.

    Raises ValueError where one of them grows without end: no energy would then be too high.
    """
    fastest = growth(scheme, step, frequency, damping_rate)
    if not fastest <= 1.0 + 1e-9:
        raise ValueError(f"a step of {step:.6g} s lets a mode grow by {fastest:.6g} each time")
    matrices = mode_matrices(scheme, step, frequency, damping_rate)
    power, largest = matrices, 1.0
    for _ in range(n_steps):
        a, b, c, d = np.moveaxis(power.reshape(-1, 4), 1, 0)
        # The larger singular value of a 2 x 2 matrix.
        norm = 0.5 * (np.hypot(a + d, b - c) + np.hypot(a - d, b + c))
        largest = max(largest, float(np.max(norm)) ** 2)
        power = power @ matrices
    return largest


def round_off(sim, n_steps: int, energy: float) -> float:
    """Return by which factor round-off may raise an energy [J] in n steps.

    A step rounds positions by up to eps |x|, which is an energy of k (eps |x|)^2 / 2 in every spring, and velocities by eps |v|.
    Such pushes add up as a random walk; three standard deviations are granted.
    """
    body, eps = sim.body, float(np.finfo(sim.body.real.dtype).eps)
    reach = float(np.linalg.norm(body.nodes.position.astype(float), axis=1).max())
    share = eps**2 * (1.0 + 0.5 * float(np.sum(body.springs.stiffness.astype(float))) * reach**2 / energy)
    return float((1.0 + 3.0 * np.sqrt(n_steps * share)) ** 2)


def total_energy(sim) -> float:
    """Return kinetic plus elastic energy [J]."""
    return measure.kinetic_energy(sim.body) + measure.elastic_energy(sim.body)
