"""Where a body comes to rest under small loads: problems, and our springs linearised about rest.

A tetrahedron whose displacement is linear has one strain tensor e, which strains a spring of direction n by n*e*n. So its six
springs of stiffness E V / l^2 store V / 2 * E * sum (n*e*n)^2, just as a linear element (P1) of the elasticity tensor

    C = E * sum over the six edges of n n n n

does. Linearised springs are therefore P1 elements of that material. It is positive definite, since six edges determine a
strain: only rigid motions cost no energy, and a body that cannot move rigidly has a regular stiffness matrix.
"""

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from gmapspring import Material, Mesh, Simulation
from gmapspring.body import Body

NO_STRESS = np.zeros((3, 3))


class Problem(NamedTuple):
    """A body of isotropic material that is clamped somewhere and loaded."""

    name: str
    mesh: Mesh
    is_clamped: np.ndarray
    """Points that are held, bool (n_points,)."""
    weight: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Force on the inside [N/m^3]."""
    stress: np.ndarray = NO_STRESS
    """What pulls at the loaded part of the boundary: the force per area there is stress * outward normal [Pa], (3, 3)."""
    is_loaded: np.ndarray = np.zeros(0, bool)
    """Points between which the boundary is loaded, bool (n_points,) or, where nothing is, (0,)."""


def body_of(mesh: Mesh) -> Body:
    """Return the body of a mesh, of unit Young's modulus [Pa] and density [kg/m^3]: all that is measured is linear in both."""
    return Simulation(mesh, Material(young_modulus=1.0, density=1.0)).body


def spring_stiffness(body: Body) -> sparse.csc_array:
    """Return the stiffness matrix of the springs about rest: k n n^T for each, over coordinates of mesh points [N/m]."""
    ends = body.nodes.point[body.springs.endpoints].astype(np.int64)
    direction = directions(body)
    blocks = body.springs.stiffness[:, None, None] * direction[:, :, None] * direction[:, None, :]
    axes = np.arange(3)
    rows, columns, values = [], [], []
    for a, b, sign in ((0, 0, 1.0), (1, 1, 1.0), (0, 1, -1.0), (1, 0, -1.0)):
        rows.append(np.broadcast_to(3 * ends[:, a, None, None] + axes[:, None], blocks.shape))
        columns.append(np.broadcast_to(3 * ends[:, b, None, None] + axes, blocks.shape))
        values.append(sign * blocks)
    entries = (np.ravel(values), (np.ravel(rows), np.ravel(columns)))
    return sparse.coo_array(entries, shape=(3 * body.mesh.n_points,) * 2).tocsc()


def directions(body: Body) -> np.ndarray:
    """Return the unit vector along each spring at rest, (n_springs, 3)."""
    ends = body.mesh.points[body.nodes.point[body.springs.endpoints]]
    return (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)[:, None]


def mean_elasticity(body: Body) -> np.ndarray:
    """Return the elasticity tensor of the springs if all tetrahedra were strained alike [Pa], (3, 3, 3, 3).

    Exact for a large piece of a lattice with one node in each cell, as Kuhn boxes are; elsewhere an upper bound.
    """
    n = directions(body)
    energy = body.springs.stiffness * body.springs.rest_length**2
    return np.einsum("s,si,sj,sk,sl->ijkl", energy, n, n, n, n) / np.sum(body.mesh.volumes)


def point_volumes(mesh: Mesh) -> np.ndarray:
    """Return a quarter of the volume of all tetrahedra round each point [m^3], (n_points,)."""
    return np.bincount(mesh.tetrahedra.ravel(), np.repeat(mesh.volumes / 4.0, 4), mesh.n_points)


def point_forces(problem: Problem, body: Body) -> np.ndarray:
    """Return the load on each point [N], (n_points, 3): what it would be for linear elements."""
    points = problem.mesh.points
    forces = point_volumes(problem.mesh)[:, None] * np.array(problem.weight)
    triangles = body.nodes.point[body.surface()]
    if len(problem.is_loaded):
        triangles = triangles[problem.is_loaded[triangles].all(axis=1)]
        a, b, c = (points[triangles[:, i]] for i in range(3))
        area = np.cross(b - a, c - a) / 2.0
        np.add.at(forces, triangles, (area @ problem.stress.T / 3.0)[:, None])
    return forces


def solve(stiffness: sparse.csc_array, force: np.ndarray, is_free: np.ndarray) -> np.ndarray:
    """Return the solution of a symmetric system whose unknowns that are not free are zero; all but the matrix are (n,)."""
    result = np.zeros(len(force))
    result[is_free] = factorised(stiffness[is_free][:, is_free].tocsc()).solve(force[is_free])
    return result


def factorised(matrix: sparse.csc_array) -> SuperLU:
    """Factorise a positive definite matrix: ordered symmetrically, without pivots, several times faster than by default."""
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def spring_displacement(problem: Problem) -> np.ndarray:
    """Return where the springs of unit Young's modulus come to rest, by linear theory [m], (n_points, 3)."""
    body = body_of(problem.mesh)
    is_free = np.repeat(~problem.is_clamped, 3)
    return solve(spring_stiffness(body), point_forces(problem, body).ravel(), is_free).reshape(-1, 3)
