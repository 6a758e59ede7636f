"""How stiff springs are in each direction: by the theory of lattices, and measured on a cube."""

import numpy as np

from gmapspring import Mesh
from tests.benchmarks.studies.statics import Problem, body_of, point_forces, solve, spring_stiffness

DIRECTIONS = {
    "edge of the cubes (1, 0, 0)": (1, 0, 0),
    "face diagonal with springs (1, 1, 0)": (1, 1, 0),
    "face diagonal without (1, -1, 0)": (1, -1, 0),
    "space diagonal with springs (1, 1, 1)": (1, 1, 1),
    "space diagonal without (1, 1, -1)": (1, 1, -1),
}
"""Kuhn's cubes have springs along one of two diagonals of a face, and along one of four diagonals of the cube."""
_HALF = np.sqrt(0.5)
STRAINS = np.array([
    np.diag([1.0, 0.0, 0.0]), np.diag([0.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0]),
    [[0.0, 0.0, 0.0], [0.0, 0.0, _HALF], [0.0, _HALF, 0.0]],
    [[0.0, 0.0, _HALF], [0.0, 0.0, 0.0], [_HALF, 0.0, 0.0]],
    [[0.0, _HALF, 0.0], [_HALF, 0.0, 0.0], [0.0, 0.0, 0.0]],
])  # fmt: skip
"""An orthonormal basis of symmetric tensors, (6, 3, 3)."""


def unit(direction: tuple[int, int, int]) -> np.ndarray:
    """Return a direction as a unit vector."""
    return np.array(direction) / np.linalg.norm(direction)


def directional_modulus(elasticity: np.ndarray, direction: np.ndarray) -> float:
    """Return Young's modulus of an elasticity tensor [Pa] along a unit vector: 1 / n n S n n with its inverse S."""
    matrix = np.einsum("aij,ijkl,bkl->ab", STRAINS, elasticity, STRAINS)
    pull = np.einsum("aij,i,j->a", STRAINS, direction, direction)
    return float(1.0 / (pull @ np.linalg.solve(matrix, pull)))


def closest_isotropic(elasticity: np.ndarray) -> tuple[float, float]:
    """Return Young's modulus [Pa] and Poisson ratio of the isotropic material closest to an elasticity tensor.

    The two invariants C_iijj and C_ijij are kept, which leaves the least square difference.
    """
    first, second = np.einsum("iijj", elasticity), np.einsum("ijij", elasticity)
    volumetric, shear = (2.0 * first - second) / 15.0, (3.0 * second - first) / 30.0
    return float(shear * (3.0 * volumetric + 2.0 * shear) / (volumetric + shear)), float(volumetric / (volumetric + shear) / 2.0)


def measured_modulus(mesh: Mesh, direction: np.ndarray) -> float:
    """Return Young's modulus [Pa] that a box shows when all its boundary is pulled at by a stress of 1 Pa along a unit vector.

    In an isotropic continuum the strain is then even, and the load does the work volume / modulus.
    """
    everywhere = np.ones(mesh.n_points, bool)
    pulled = Problem("pulled", mesh, ~everywhere, stress=np.outer(direction, direction), is_loaded=everywhere)
    body = body_of(mesh)
    force = point_forces(pulled, body).ravel()
    displacement = solve(spring_stiffness(body), force, ~rigidly_held(mesh))
    return float(np.sum(mesh.volumes) / (force @ displacement))


def rigidly_held(mesh: Mesh) -> np.ndarray:
    """Return the six coordinates that stop rigid motion of a box and nothing else, bool (3 n_points,)."""
    size = mesh.points.max(axis=0)
    held = np.zeros((mesh.n_points, 3), bool)
    for corner, axes in (((0, 0, 0), (0, 1, 2)), ((1, 0, 0), (1, 2)), ((0, 1, 0), (2,))):
        held[np.argmin(np.linalg.norm(mesh.points - size * corner, axis=1)), list(axes)] = True
    return held.ravel()
