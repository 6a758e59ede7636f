"""Linear isotropic elasticity by finite elements: the continuum that springs stand for, assembled by scikit-fem."""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree
from skfem import Basis, BilinearForm, ElementTetP1, ElementTetP2, ElementVector, FacetBasis, LinearForm, MeshTet
from skfem.helpers import ddot, div, dot, mul, sym_grad

from gmapspring import Mesh
from gmapspring.mesh_checks import signed_volumes
from tests.benchmarks.studies.statics import Problem, factorised

MIDDLE_RATIO = 0.35
"""Poisson ratio whose stiffness matrix is factorised: in the middle as the energies of the others are concerned."""
TOLERANCE = 1e-6
"""Relative residual of the other solutions, far below their differences."""
ELEMENTS = {1: ElementTetP1, 2: ElementTetP2}
"""Elements by the degree of their polynomials."""


@BilinearForm
def volume_change(u, v, w):
    """Energy of the first Lame constant."""
    return div(u) * div(v)


@BilinearForm
def distortion(u, v, w):
    """Energy of the second Lame constant."""
    return 2.0 * ddot(sym_grad(u), sym_grad(v))


@LinearForm
def work_of_weight(v, w):
    """Work of a force on the inside."""
    return dot(w.weight, v)


@LinearForm
def work_of_stress(v, w):
    """Work of a force on the boundary."""
    return dot(mul(w.stress, w.n), v)


class Continuum:
    """A problem in finite elements of a degree, assembled once for all Poisson ratios; Young's modulus is 1 Pa."""

    def __init__(self, problem: Problem, degree: int):
        """Assemble."""
        mesh = _mesh_of(problem)
        # Gradients are of degree - 1, and squared; a weight is multiplied by functions of degree.
        basis = Basis(mesh, ElementVector(ELEMENTS[degree]()), intorder=max(2 * (degree - 1), degree))
        self.volume_change, self.distortion = volume_change.assemble(basis), distortion.assemble(basis)
        self.force = work_of_weight.assemble(basis, weight=_constant(np.array(problem.weight)))
        if len(problem.is_loaded):
            facets = FacetBasis(mesh, basis.elem, facets=mesh.boundaries["loaded"], intorder=degree)
            self.force += work_of_stress.assemble(facets, stress=_constant(problem.stress))
        self.is_free = np.ones(basis.N, bool)
        self.is_free[basis.get_dofs("clamped").all()] = False
        self._unknowns = np.stack([np.concatenate(_unknowns(basis, axis)) for axis in range(3)], axis=1)
        self._nodes = cKDTree(basis.doflocs[:, self._unknowns[:, 0]].T)
        middle = self.stiffness(MIDDLE_RATIO)[self.is_free][:, self.is_free].tocsc()
        self._inverse = LinearOperator(middle.shape, factorised(middle).solve, dtype=np.float64)
        self._solutions: dict[float, np.ndarray] = {}

    def displacement(self, poisson_ratio: float, points: np.ndarray) -> np.ndarray:
        """Return the displacement [m] of points that are nodes of the elements, (n_points, 3)."""
        if poisson_ratio not in self._solutions:
            self._solutions[poisson_ratio] = self._solve(poisson_ratio)
        distance, node = self._nodes.query(points)
        assert distance.max() < 1e-9 * np.ptp(points), "not all points are nodes of the elements"
        return self._solutions[poisson_ratio][self._unknowns[node]]

    def _solve(self, poisson_ratio: float) -> np.ndarray:
        """Return all unknowns: by conjugate gradients on one factorisation, which is so near that a dozen steps do."""
        matrix, free = self.stiffness(poisson_ratio)[self.is_free][:, self.is_free], self.force[self.is_free]
        solution = np.zeros(len(self.force))
        solution[self.is_free], failure = cg(matrix, free, rtol=TOLERANCE, M=self._inverse)
        assert not failure, f"no solution for a Poisson ratio of {poisson_ratio}"
        return solution

    def stiffness(self, poisson_ratio: float) -> sparse.csc_array:
        """Return the stiffness matrix [N/m]."""
        first = poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
        second = 0.5 / (1.0 + poisson_ratio)
        return sparse.csc_array(first * self.volume_change + second * self.distortion)


def refined(problem: Problem) -> Problem:
    """Return a problem with each tetrahedron cut into eight."""
    coarse = _plain(problem.mesh)
    fine = coarse.refined()
    points, corners = fine.p.T, fine.t.T.copy()
    assert np.allclose(points[problem.mesh.n_points :], coarse.p[:, coarse.edges].mean(axis=1).T), "new points must halve edges"
    is_negative = signed_volumes(points, corners) < 0.0
    corners[is_negative, 2:] = corners[is_negative][:, [3, 2]]
    is_loaded = _with_edges(coarse, problem.is_loaded) if len(problem.is_loaded) else problem.is_loaded
    return problem._replace(mesh=Mesh(points, corners), is_clamped=_with_edges(coarse, problem.is_clamped), is_loaded=is_loaded)


def _with_edges(mesh: MeshTet, mask: np.ndarray) -> np.ndarray:
    """Return a mask of points, continued to the middles of edges: those of boundary faces that lie between points of the mask."""
    faces = mesh.facets[:, _faces_between(mesh, mask)]
    pairs = np.sort(np.hstack([faces[[0, 1]], faces[[0, 2]], faces[[1, 2]]]), axis=0)
    is_between = np.isin(np.sort(mesh.edges, axis=0).T @ [len(mask), 1], pairs.T @ [len(mask), 1])
    return np.concatenate([mask, is_between])


def _faces_between(mesh: MeshTet, mask: np.ndarray) -> np.ndarray:
    """Return the boundary faces whose corners are all in a mask of points."""
    outside = mesh.boundary_facets()
    return outside[mask[mesh.facets[:, outside]].all(axis=0)]


def _plain(mesh: Mesh) -> MeshTet:
    """Return a mesh as scikit-fem has it."""
    return MeshTet(mesh.points.T.copy(), np.ascontiguousarray(mesh.tetrahedra.T, np.int64))


def _mesh_of(problem: Problem) -> MeshTet:
    """Return scikit-fem's mesh, its clamped and loaded faces named."""
    mesh = _plain(problem.mesh)
    clamped = _faces_between(mesh, problem.is_clamped)
    assert set(np.flatnonzero(problem.is_clamped)) == set(mesh.facets[:, clamped].flat), "clamped points must span faces"
    loaded = _faces_between(mesh, problem.is_loaded) if len(problem.is_loaded) else np.zeros(0, np.int64)
    return mesh.with_boundaries({"clamped": clamped, "loaded": loaded})


def _constant(value: np.ndarray) -> np.ndarray:
    """Return a constant tensor that broadcasts over elements and their integration points."""
    return value[..., None, None]


def _unknowns(basis: Basis, axis: int) -> list[np.ndarray]:
    """Return the unknowns that are displacements along an axis: at corners, and for quadratic elements at edges."""
    return [basis.nodal_dofs[axis], *([basis.edge_dofs[axis]] if len(basis.edge_dofs) else [])]
