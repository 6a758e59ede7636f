"""What a mesh is like before anything is simulated on it: counts, quality, boundary, pieces, stable steps, memory."""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy import sparse, spatial
from scipy.sparse import csgraph

from gmapspring.addresses import leaves
from gmapspring.body import Body, BodyArrays, Material
from gmapspring.mesh import Mesh, pinched_points
from gmapspring.mesh_checks import paired_faces
from gmapspring.simulation import Simulation
from gmapspring.topology.darts import EDGE_CORNERS, OUTWARD_FACE_CORNERS
from gmapspring.topology.gmap import boundary_faces, components, singular_vertices

N_BINS = 10
"""Bins of the quality histogram, from 0 to 1."""

SAME_PLACE = 1e-6
"""Distance below which two points lie at the same place, over the shortest edge."""

EDGE_BETWEEN = np.zeros((4, 4), np.int64)
"""The edge between two corners of a tetrahedron."""
for _edge, (_one, _other) in enumerate(EDGE_CORNERS.tolist()):
    EDGE_BETWEEN[_one, _other] = EDGE_BETWEEN[_other, _one] = _edge

Array = np.ndarray[Any, Any]


@dataclass(frozen=True)
class MeshInfo:
    """Facts about a mesh and the body that it becomes."""

    n_points: int
    n_tetrahedra: int
    n_edges: int
    n_faces: int
    extent: tuple[float, float, float]
    """Size of the bounding box [m]."""
    volume: float
    """[m^3]"""
    regions: dict[str, int]
    """Tetrahedra of each cell region, and points of each point region."""
    n_components: int
    """Parts that hold together through faces."""
    n_boundary_faces: int
    boundary_area: float
    """[m^2]"""
    boundary_euler: int
    """Corners - edges + faces of the boundary, 2 for a ball, 0 for a ring; sheets that touch at a point have a corner each."""
    n_singular_nodes: int
    """Nodes whose link is neither a sphere nor a disc."""
    n_pinched_points: int
    """Points at which parts touch without sharing a face, so that they become several nodes."""
    n_coincident_points: int
    """Points that lie where another one does: where two of them should be one, the mesh has a crack and is not watertight."""
    quality: dict[str, float]
    """Mean ratio of tetrahedra (`mean_ratios`): lowest, median, mean."""
    quality_histogram: tuple[int, ...]
    """Tetrahedra by mean ratio, in ten equal bins from 0 to 1."""
    worst_tetrahedron: int
    stable_steps: dict[str, float]
    """Largest proven stable step of each integrator for the material [s]."""
    n_bytes: int
    """Memory of the body's arrays."""

    def as_dict(self) -> dict[str, Any]:
        """Return everything by name."""
        return asdict(self)


def describe(mesh: Mesh, material: Material, integrators: Iterable[str]) -> MeshInfo:
    """Return the facts about a mesh; the stable steps are those of some integrators for a material."""
    simulation = Simulation(mesh, material)
    body, ratios = simulation.body, mean_ratios(mesh)
    free = boundary_faces(body.gmap)
    corners = mesh.points[mesh.tetrahedra]
    pairs = len(paired_faces(mesh.tetrahedra, mesh.n_points)[0])
    return MeshInfo(
        n_points=mesh.n_points,
        n_tetrahedra=mesh.n_tetrahedra,
        n_edges=body.n_springs,
        n_faces=4 * mesh.n_tetrahedra - pairs,
        extent=tuple(np.ptp(mesh.points, axis=0).tolist()),
        volume=float(mesh.volumes.sum()),
        regions={name: int(mask.sum()) for name, mask in (*mesh.cell_regions.items(), *mesh.point_regions.items())},
        n_components=int(components(body.gmap).max()) + 1,
        n_boundary_faces=len(free),
        boundary_area=float(_areas(corners)[free[:, 0], free[:, 1]].sum()),
        boundary_euler=_boundary_euler(body),
        n_singular_nodes=len(singular_vertices(body.gmap)),
        n_pinched_points=len(pinched_points(mesh).points),
        n_coincident_points=_count_coincident(mesh),
        quality={"lowest": float(ratios.min()), "median": float(np.median(ratios)), "mean": float(ratios.mean())},
        quality_histogram=tuple(np.histogram(ratios, N_BINS, (0.0, 1.0))[0].tolist()),
        worst_tetrahedron=int(ratios.argmin()),
        stable_steps={name: Simulation(mesh, material, integrator=name).stable_step for name in integrators},
        n_bytes=sum(array.nbytes for array in leaves(BodyArrays(body.matter, body.gmap, body.room))),
    )


def mean_ratios(mesh: Mesh) -> Array:
    """Return the mean ratio of each tetrahedron, (n_tetrahedra,): 12 (3 V)^(2/3) over the sum of its squared edges.

    It is 1 for a regular tetrahedron and 0 for a flat one (Liu and Joe, "Relationship between tetrahedron shape measures", 1994).
    """
    ends = mesh.points[mesh.tetrahedra[:, EDGE_CORNERS]]
    squares = ((ends[:, :, 1] - ends[:, :, 0]) ** 2).sum(axis=(1, 2))
    return 12.0 * (3.0 * mesh.volumes) ** (2.0 / 3.0) / squares


def _count_coincident(mesh: Mesh) -> int:
    """Return how many points lie closer to another than a millionth of the shortest edge."""
    ends = mesh.points[mesh.tetrahedra[:, EDGE_CORNERS]]
    shortest = float(np.linalg.norm(ends[:, :, 1] - ends[:, :, 0], axis=2).min())
    pairs = spatial.cKDTree(mesh.points).query_pairs(SAME_PLACE * shortest, output_type="ndarray")
    return len(np.unique(pairs))


def _areas(corners: Array) -> Array:
    """Return the area of each face, opposite each corner [m^2], (n_tetrahedra, 4)."""
    areas = np.empty(corners.shape[:2])
    for face in range(4):
        a, b, c = (corners[:, corner] for corner in range(4) if corner != face)
        areas[:, face] = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return areas


def _boundary_euler(body: Body) -> int:
    """Return corners - edges + faces of the boundary surface; triangles that meet in a corner alone do not share it."""
    faces = boundary_faces(body.gmap)
    corners = OUTWARD_FACE_CORNERS[faces[:, 1]]
    edges = body.edge_of[faces[:, :1], EDGE_BETWEEN[corners, np.roll(corners, -1, axis=1)]]
    # Around an edge of the body lies one fan of tetrahedra: on the boundary it has two free faces, one going there, one back.
    sides = np.argsort(edges, axis=None, kind="stable").reshape(-1, 2)
    start, stop = np.arange(edges.size), np.roll(np.arange(edges.size).reshape(-1, 3), -1, axis=1).ravel()
    one, other = sides.T
    links = np.concatenate([np.stack([start[one], stop[other]]), np.stack([stop[one], start[other]])], axis=1)
    graph = sparse.coo_array((np.ones(links.shape[1], np.int8), links), shape=(edges.size, edges.size))
    n_corners = int(csgraph.connected_components(graph, directed=False)[0])
    return n_corners - len(sides) + len(faces)
