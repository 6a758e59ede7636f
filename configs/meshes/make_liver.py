"""Make liver.vtu: a liver-like body of about 564 points, 2850 edges and 1856 tetrahedra, one ball topologically.

Run by hand: `pip install gmapspring[author]`, then `python configs/meshes/make_liver.py`. The same gmsh gives the same
file. The shape is a smooth blend of two lobes, less a notch in front and a hollow below. gmsh meshes it; then every
corner near a bad angle is moved, on the surface if it lies there, to where its worst angle is best.

Axes [m]: x from the right lobe to the left, y from the front edge to the back, z upward.
"""

import pathlib
import sys
from typing import Any

import gmsh
import numpy as np

from gmapspring import meshes
from gmapspring.mesh import Mesh
from gmapspring.mesh_files import write_mesh

Array = np.ndarray[Any, Any]

SURFACE_EDGE, INNER_EDGE = 0.01222, 0.0135
"""Wanted edge lengths at the surface and from INNER_DEPTH inward [m]: chosen for the paper's counts."""

INNER_DEPTH = 0.02
"""Depth at which the inner edge length is reached [m]."""

PAPER_COUNTS = np.array([564, 2850, 1856])
"""Points, edges and tetrahedra of the body in Meseure, Darles and Skapin (2010), to be met within 2 %."""

VIEWPOINT = np.array([0.0, 0.012, 0.006])
"""A point that sees the whole surface [m]."""

ANCHOR_CENTRE, ANCHOR_RADIUS = np.array([-0.035, 0.048, 0.022]), 0.032
"""The bare area at the back of the right lobe, where the organ hangs on the diaphragm [m]."""

TUMOUR_CENTRE, TUMOUR_RADII = np.array([-0.055, -0.024, 0.018]), np.array([0.0165, 0.0165, 0.0145])
"""A lump under the front of the right lobe [m]."""

ANGLE_AIM, EDGE_AIM = 30.0, 0.011
"""Worst angle [degrees] and shortest edge [m] that the corners are moved towards."""

EDGE_CORNERS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
FACE_CORNERS = np.array([(1, 2, 3), (0, 3, 2), (0, 1, 3), (0, 2, 1)])


def ellipsoid(points: Array, centre: tuple[float, ...], radii: tuple[float, ...]) -> Array:
    """Return about the signed distance to an ellipsoid [m], negative inside."""
    scaled = (points - np.array(centre)) / radii
    length = np.linalg.norm(scaled, axis=-1)
    # The centre has no direction; any large negative distance will do there.
    return length * (length - 1) / np.maximum(np.linalg.norm(scaled / radii, axis=-1), 1e-9)


def blended_union(first: Array, second: Array, width: float) -> Array:
    """Return the distance to the union of two bodies, rounded over the given width [m] (polynomial blend)."""
    overlap = np.maximum(width - np.abs(first - second), 0.0) / width
    return np.minimum(first, second) - overlap**2 * width / 4


def signed_distance(points: Array) -> Array:
    """Return about the signed distance of points (..., 3) to the organ's surface [m], negative inside."""
    right = ellipsoid(points, (-0.036, 0.0, 0.0), (0.064, 0.060, 0.040))
    left = ellipsoid(points, (0.050, 0.012, 0.012), (0.058, 0.036, 0.020))
    notch = ellipsoid(points, (0.026, -0.062, 0.0), (0.016, 0.042, 0.060))
    hollow = np.linalg.norm(points - np.array([0.02, -0.02, -0.125]), axis=-1) - 0.11
    body = blended_union(right, left, 0.04)
    return -blended_union(-body, blended_union(notch, hollow, 0.02), 0.02)


def dense_surface() -> tuple[Array, Array]:
    """Return a fine triangulation of the surface: a finely divided ball, each point pushed along its ray."""
    ball = meshes.ball(16)
    faces = ball.tetrahedra[:, FACE_CORNERS].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    used, triangles = np.unique(faces[np.sort(first[count == 1])], return_inverse=True)
    directions = ball.points[used] * (0.10, 0.058, 0.040)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    near, far = np.zeros(len(used)), np.full(len(used), 0.16)
    for _ in range(60):
        middle = (near + far) / 2
        is_inside = signed_distance(VIEWPOINT + directions * middle[:, None]) < 0
        near, far = np.where(is_inside, middle, near), np.where(is_inside, far, middle)
    return VIEWPOINT + directions * near[:, None], triangles.reshape(-1, 3)


def tetrahedralised(points: Array, triangles: Array) -> tuple[Array, Array]:
    """Return points and tetrahedra that gmsh fills the surface with."""
    gmsh.initialize(["gmsh", "-v", "2", "-nt", "1"], readConfigFiles=False)
    try:
        surface = gmsh.model.addDiscreteEntity(2)
        gmsh.model.mesh.addNodes(2, surface, np.arange(1, len(points) + 1), points.ravel())
        gmsh.model.mesh.addElementsByType(surface, 2, [], (triangles + 1).ravel())
        gmsh.model.mesh.classifySurfaces(np.pi, True, True, np.pi)
        gmsh.model.mesh.createGeometry()
        shell = gmsh.model.geo.addSurfaceLoop([tag for _, tag in gmsh.model.getEntities(2)])
        gmsh.model.geo.addVolume([shell])
        gmsh.model.geo.synchronize()
        for option in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints"):
            gmsh.option.setNumber(f"Mesh.{option}", 0)
        gmsh.model.mesh.setSizeCallback(wanted_edge)
        gmsh.option.setNumber("Mesh.OptimizeNetgen", 1)
        gmsh.model.mesh.generate(3)
        for method in ("Netgen", "", "Netgen", ""):
            gmsh.model.mesh.optimize(method)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        corners = gmsh.model.mesh.getElementsByType(4)[1]
    finally:
        gmsh.finalize()
    used, tetrahedra = np.unique(corners, return_inverse=True)
    row_of = {tag: row for row, tag in enumerate(tags.tolist())}
    return coordinates.reshape(-1, 3)[[row_of[tag] for tag in used.tolist()]], tetrahedra.reshape(-1, 4)


def wanted_edge(_dim: int, _tag: int, x: float, y: float, z: float, _size: float) -> float:
    """Return the wanted edge length at a place [m]."""
    depth = max(-float(signed_distance(np.array([x, y, z]))), 0.0)
    return SURFACE_EDGE + (INNER_EDGE - SURFACE_EDGE) * min(depth / INNER_DEPTH, 1.0)


def dihedral_angles(corners: Array) -> Array:
    """Return the six dihedral angles [degrees] of tetrahedra (..., 4, 3), shape (..., 6); NaN where flat."""
    faces = corners[..., FACE_CORNERS, :]
    normals = np.cross(faces[..., 1, :] - faces[..., 0, :], faces[..., 2, :] - faces[..., 0, :])
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    cosines = -(normals[..., EDGE_CORNERS[:, 0], :] * normals[..., EDGE_CORNERS[:, 1], :]).sum(axis=-1)
    return np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))


def quality(corners: Array) -> Array:
    """Return how near tetrahedra (..., 4, 3) come to both aims, angle and edge: the lesser part; -1 if inverted.

    Large angles count as half their distance to 180 degrees. Short edges count since they shorten the time step.
    """
    angles = dihedral_angles(corners)
    worst = np.minimum(angles.min(axis=-1), (180.0 - angles.max(axis=-1)) / 2)
    edges = corners[..., EDGE_CORNERS[:, 1], :] - corners[..., EDGE_CORNERS[:, 0], :]
    shortest = np.linalg.norm(edges, axis=-1).min(axis=-1)
    volumes = (np.cross(edges[..., 0, :], edges[..., 1, :]) * edges[..., 2, :]).sum(axis=-1)
    return np.where(volumes > 0, np.minimum(worst / ANGLE_AIM, shortest / EDGE_AIM), -1.0)


def on_surface(points: Array) -> Array:
    """Return points moved along the distance's gradient until they lie on the surface."""
    for _ in range(4):
        steps = 1e-6 * np.eye(3)
        gradient = np.stack([signed_distance(points + step) - signed_distance(points - step) for step in steps], -1)
        gradient /= 2e-6
        points = points - gradient * (signed_distance(points) / (gradient**2).sum(axis=-1))[..., None]
    return points


def improved(points: Array, tetrahedra: Array, is_surface: Array, n_sweeps: int = 40) -> Array:
    """Return points at which the worst angles are better: local random search, one corner after another."""
    generator = np.random.default_rng(2010)
    points = np.where(is_surface[:, None], on_surface(points), points)
    for sweep in range(n_sweeps):
        grades = quality(points[tetrahedra])
        bad = np.unique(tetrahedra[grades < np.quantile(grades, 0.25)])
        for point in generator.permutation(bad):
            star = tetrahedra[(tetrahedra == point).any(axis=1)]
            moves = generator.normal(scale=0.1 * SURFACE_EDGE * 0.5 ** (sweep / 10), size=(32, 3))
            places = points[point] + np.concatenate([np.zeros((1, 3)), moves])
            places = on_surface(places) if is_surface[point] else places
            corners = np.where((star == point)[None, :, :, None], places[:, None, None, :], points[star])
            points[point] = places[np.argmax(quality(corners).min(axis=1))]
    return points


def surface_points(tetrahedra: Array, n_points: int) -> Array:
    """Return which points lie on the boundary, bool, shape (n_points,)."""
    faces, count = np.unique(np.sort(tetrahedra[:, FACE_CORNERS].reshape(-1, 3), axis=1), axis=0, return_counts=True)
    is_surface = np.zeros(n_points, dtype=bool)
    is_surface[faces[count == 1]] = True
    return is_surface


def reordered(points: Array, tetrahedra: Array) -> tuple[Array, Array]:
    """Return the mesh with neighbours near each other in memory: points along the long axis, then by lowest corner.

    The corners of a tetrahedron are then 45 rows apart on average, against 108 for reverse Cuthill-McKee and 94 for
    a Hilbert curve: the body is long and thin.
    """
    order = np.argsort(points[:, 0], kind="stable")
    tetrahedra = np.argsort(order)[tetrahedra]
    return points[order], tetrahedra[np.lexsort(np.sort(tetrahedra, axis=1).T[::-1])]


def with_regions(points: Array, tetrahedra: Array) -> Mesh:
    """Return the mesh with the anchor and the tumour marked."""
    is_near = np.linalg.norm(points - ANCHOR_CENTRE, axis=1) < ANCHOR_RADIUS
    anchor = is_near & surface_points(tetrahedra, len(points))
    centroids = points[tetrahedra].mean(axis=1)
    tumour = np.linalg.norm((centroids - TUMOUR_CENTRE) / TUMOUR_RADII, axis=1) < 1
    return Mesh(points, tetrahedra, {"tumour": tumour}, {"anchor": anchor})


def main() -> None:
    """Make the organ, print its figures, and write it beside this script if they are good."""
    points, tetrahedra = tetrahedralised(*dense_surface())
    is_surface = surface_points(tetrahedra, len(points))
    points = improved(points, tetrahedra, is_surface)
    mesh = with_regions(*reordered(points, tetrahedra))
    edges = np.unique(np.sort(mesh.tetrahedra[:, EDGE_CORNERS].reshape(-1, 2), axis=1), axis=0)
    counts = np.array([mesh.n_points, len(edges), mesh.n_tetrahedra])
    angles = dihedral_angles(mesh.points[mesh.tetrahedra])
    print(f"points, edges, tetrahedra: {counts}; {100 * (counts / PAPER_COUNTS - 1).round(4)} % off the paper's")
    print(f"dihedral angles: {angles.min():.1f} to {angles.max():.1f} degrees; {is_surface.sum()} points on the surface")
    print(f"anchor: {mesh.point_regions['anchor'].sum()} points; tumour: {mesh.cell_regions['tumour'].sum()} tetrahedra")
    if (abs(counts / PAPER_COUNTS - 1) > 0.02).any() or angles.min() < 15 or angles.max() > 150:
        sys.exit("not written: the counts or the angles miss their aims")
    write_mesh(pathlib.Path(__file__).with_name("liver.vtu"), mesh)


if __name__ == "__main__":
    main()
