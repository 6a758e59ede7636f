"""The stable step: a bound from single tetrahedra, which no cut can break.

Assembled from its tetrahedra, a body has no frequency above the highest that one tetrahedron has alone, with its own share of
stiffness and mass (Irons and Treharne, "A bound theorem in eigenvalues and its practical applications", 1971): for every x,

    x*Kx / x*Mx = sum_e x*K_e x / sum_e x*M_e x <= max_e of x*K_e x / x*M_e x.

A cut puts the same tetrahedra together in another way, and removing one takes its term from both sums: the bound stays. Pinning
only narrows the choice of x. The same holds for damping, C_e = beta_e K_e + gamma_e M_e, and any combination
of K and C. A spring's stiffness matrix is at most k times the identity at any stretch, so K_e here is the Laplacian of the
tetrahedron's six springs, once for each axis: a bound at large deformation too.

What it says: small motions about any state, however deformed, do not grow by the scheme's doing. What it does not say: that
energy stays bounded in violent motion, where stiffness and the directions of damping change by much within a few steps; hence
Integrator.default_step.
"""

import math

import numpy as np

from gmapspring.body import Body
from gmapspring.errors import StabilityError
from gmapspring.integrators import Integrator, Limits
from gmapspring.jit import kernel, part
from gmapspring.matter import Tetrahedra
from gmapspring.mesh import Mesh

N_SWEEPS = 12
"""More than enough: each sweep squares the error, and most tetrahedra need five."""
DENSE_LIMIT = 500
"""Up to this many nodes a dense eigenvalue solver is as fast as a sparse one, and exact."""


def element_frequencies(mesh: Mesh, tetrahedra: Tetrahedra) -> np.ndarray:
    """Return the highest frequency of each tetrahedron of a mesh by itself [rad/s], (n_tets,)."""
    frequencies = np.empty(mesh.n_tetrahedra)
    fill_frequencies(mesh.points, mesh.tetrahedra, tetrahedra.modulus, tetrahedra.mass, frequencies)
    return frequencies


@kernel
def fill_frequencies(points, tetrahedra, modulus, mass, frequencies):
    """Set the highest frequency of each tetrahedron.

    Not by LAPACK: its last bits depend on the processor, and the step, hence the replay of a run, must not.
    """
    matrix = np.empty((4, 4))
    for tetrahedron in range(len(tetrahedra)):
        set_laplacian(points, tetrahedra[tetrahedron], modulus[tetrahedron], matrix)
        # Round-off may leave the zero of a tetrahedron without stiffness slightly negative.
        frequencies[tetrahedron] = math.sqrt(max(largest_eigenvalue(matrix), 0.0) / (0.25 * mass[tetrahedron]))


@part
def set_laplacian(points, corners, modulus, matrix):
    """Set the Laplacian (4, 4) [N/m] of a tetrahedron's six springs, each of stiffness modulus / length^2."""
    matrix[:] = 0.0
    for i in range(3):
        for j in range(i + 1, 4):
            square = 0.0
            for axis in range(3):
                difference = points[corners[j], axis] - points[corners[i], axis]
                square += difference * difference
            stiffness = modulus / square
            matrix[i, j] = matrix[j, i] = -stiffness
            matrix[i, i] += stiffness
            matrix[j, j] += stiffness


@kernel
def largest_eigenvalue(matrix):
    """Return the largest eigenvalue of a symmetric matrix, destroying it: Jacobi (Golub, Van Loan, 1996, section 8.4)."""
    n = len(matrix)
    for _ in range(N_SWEEPS):
        rest = 0.0
        for p in range(n - 1):
            for q in range(p + 1, n):
                rest += abs(matrix[p, q])
                if matrix[p, q] != 0.0:
                    rotate(matrix, p, q)
        if rest == 0.0:
            break
    largest = matrix[0, 0]
    for p in range(1, n):
        largest = max(largest, matrix[p, p])
    return largest


@part
def rotate(matrix, p, q):
    """Turn axes p and q so that the entry (p, q) of a symmetric matrix becomes zero."""
    slope = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    tangent = math.copysign(1.0 / (abs(slope) + math.sqrt(1.0 + slope * slope)), slope)
    cosine = 1.0 / math.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    matrix[p, p] -= tangent * matrix[p, q]
    matrix[q, q] += tangent * matrix[p, q]
    matrix[p, q] = matrix[q, p] = 0.0
    for r in range(len(matrix)):
        if r not in (p, q):
            first, second = matrix[r, p], matrix[r, q]
            matrix[r, p] = matrix[p, r] = cosine * first - sine * second
            matrix[r, q] = matrix[q, r] = sine * first + cosine * second


def element_limits(mesh: Mesh, tetrahedra: Tetrahedra) -> Limits:
    """Return frequencies and damping rates of each tetrahedron of a mesh by itself, each (n_tets,)."""
    frequency = element_frequencies(mesh, tetrahedra)
    rate, drag = np.zeros((2, len(tetrahedra.mass)))
    if len(tetrahedra.viscosity):
        drag = tetrahedra.viscosity / tetrahedra.mass
    if len(tetrahedra.damping_modulus):
        # Without stiffness there is no damping in proportion to it either.
        modulus = np.where(tetrahedra.modulus > 0, tetrahedra.modulus, 1.0)
        rate = tetrahedra.damping_modulus / modulus * frequency**2
    return Limits(frequency, rate + drag, drag)


def element_frequency(body: Body) -> float:
    """Return the bound on every frequency of the body and of all bodies cut from it [rad/s]."""
    return float(np.max(element_frequencies(body.mesh, body.tetrahedra)))


def stable_step(body: Body, integrator: Integrator) -> float:
    """Return the longest step [s] that is stable for the body and for all bodies cut from it.

    It depends on mesh and material alone, so it is computed once. It is infinite for schemes that are always stable and where
    there is neither stiffness nor damping, and zero where the scheme is never stable.
    """
    return integrator.stable_step(element_limits(body.mesh, body.tetrahedra))


def check_step(step: float, stable: float, scheme: str, where: str = "") -> None:
    """Raise unless a step [s] can be taken where so long a one is stable."""
    if stable == 0.0:
        raise StabilityError(
            f"{where}{scheme} has no stable step for this body: some of it has stiffness and no viscosity, so that every "
            "motion of it grows; give the material viscosity, or choose another integrator"
        )
    if not step > 0.0:
        raise ValueError(f"{where}step must be positive, not {step}")
    if step > stable:
        raise StabilityError(
            f"{where}a step of {step:.6g} s is above the stable step of {stable:.6g} s for {scheme}; "
            "leave it out to have it chosen"
        )


def assembled_frequency(body: Body) -> float:
    """Return the highest frequency of the body as it is [rad/s], springs taken as k times the identity: a check on the bound.

    It is the square root of the largest eigenvalue of M^-1 K over free nodes; pinned ones drop out with their inverse mass of 0.
    """
    # Imported where it is used, as in `gmapspring.mesh`.
    from scipy import sparse
    from scipy.sparse.linalg import eigsh

    n = body.n_nodes
    i, j = body.springs.endpoints.T.astype(np.int64)
    k = body.springs.stiffness.astype(np.float64)
    scale = np.where(body.nodes.is_pinned, 0.0, 1.0 / np.sqrt(body.nodes.mass))
    rows, columns, values = np.concatenate([i, j, i, j]), np.concatenate([j, i, i, j]), np.concatenate([-k, -k, k, k])
    matrix = sparse.coo_array((scale[rows] * values * scale[columns], (rows, columns)), shape=(n, n)).tocsr()
    if n <= DENSE_LIMIT:
        largest = np.linalg.eigvalsh(matrix.toarray())[-1]
    else:
        # A fixed start, so that equal bodies give equal numbers.
        start = np.random.default_rng(0).standard_normal(n)
        largest = eigsh(matrix, k=1, which="LA", v0=start, return_eigenvectors=False)[0]
    return float(np.sqrt(max(largest, 0.0)))
