"""Cases of bodies whose parts differ by orders of magnitude."""

import numpy as np

import gmapspring as gs
from tests.stability.cases.bodies import DENSITY, YOUNG_MODULUS, build, gentle_motion, held_at_low_x, small_box
from tests.stability.cases.limits import LINEAR
from tests.stability.cases.verdict import Verdict, all_finite

RATIO = 1e6


def spread(n: int, seed: int) -> np.ndarray:
    """Return factors from 1 to RATIO, evenly spread in orders of magnitude, in random order."""
    return np.random.default_rng(seed).permutation(np.geomspace(1.0, RATIO, n))


def stiffness_ratio(scheme, dtype):
    """Step a body whose stiffest tetrahedron is a million times as stiff as its softest."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh), young_modulus=YOUNG_MODULUS * spread(mesh.n_tetrahedra, 1))
    # A tenth of the shortest edge in the softest: float32 positions resolve no less against the stiffest.
    speed = 0.01 * np.sqrt(YOUNG_MODULUS / DENSITY)
    return Verdict(LINEAR, (gentle_motion(sim, speed), all_finite(sim)))


def mass_ratio(scheme, dtype):
    """Step a body whose heaviest tetrahedron is a million times as heavy as its lightest."""
    mesh = small_box()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh), density=DENSITY * spread(mesh.n_tetrahedra, 2) / RATIO)
    return Verdict(LINEAR, (gentle_motion(sim, 0.01 * np.sqrt(YOUNG_MODULUS / DENSITY)), all_finite(sim)))


def slivers(scheme, dtype):
    """Step a box with a squeezed layer: dihedral angles below one degree, quality below 1e-3."""
    mesh = sliver_mesh()
    sim = build(scheme, dtype, mesh, pinned=held_at_low_x(mesh))
    return Verdict(LINEAR, (gentle_motion(sim, 0.01), all_finite(sim)))


def sliver_mesh() -> gs.Mesh:
    """Return a box of two layers, 0.1 m and 0.00004 m high."""
    mesh = gs.meshes.box((2, 2, 2), 0.1)
    points = mesh.points.copy()
    points[points[:, 2] > 0.15, 2] = 0.10004
    squeezed = gs.Mesh(points, mesh.tetrahedra)
    assert dihedral_angles(squeezed).min() < 1.0
    assert qualities(squeezed).min() < 1e-3
    return squeezed


def outward_areas(mesh) -> np.ndarray:
    """Return the area vectors [m^2] of the faces of each tetrahedron, (n, 4, 3), opposite corners 0 to 3."""
    a, b, c, d = np.moveaxis(mesh.points[mesh.tetrahedra], 1, 0)
    faces = ((b, d, c), (a, c, d), (a, d, b), (a, b, c))
    return np.stack([0.5 * np.cross(r - p, q - p) for p, q, r in faces], axis=1)


def dihedral_angles(mesh) -> np.ndarray:
    """Return the six dihedral angles of each tetrahedron [degrees], (n, 6)."""
    areas = outward_areas(mesh)
    normals = areas / np.linalg.norm(areas, axis=2, keepdims=True)
    first, second = np.triu_indices(4, 1)
    cosine = -np.sum(normals[:, first] * normals[:, second], axis=2)
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))


def qualities(mesh) -> np.ndarray:
    """Return three times the inner over the outer radius of each tetrahedron, 1 where it is regular, (n,)."""
    corners = mesh.points[mesh.tetrahedra]
    edges = corners[:, 1:] - corners[:, :1]
    inner = 3.0 * mesh.volumes / np.linalg.norm(outward_areas(mesh), axis=2).sum(axis=1)
    centre = np.linalg.solve(edges, 0.5 * np.sum(edges**2, axis=2)[..., None])[..., 0]
    return 3.0 * inner / np.linalg.norm(centre, axis=1)


CASES = {
    "stiffness ratio 1e6": stiffness_ratio,
    "mass ratio 1e6": mass_ratio,
    "slivers": slivers,
}
