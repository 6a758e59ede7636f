"""Parts of a scene file that come in several kinds, told apart by the key `kind`: mesh, pinned, target, direction.

To add a kind is to add its model here and name it in scene_config.py.
"""

import pathlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import PositiveFloat, PositiveInt, ValidationInfo, field_validator
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from gmapspring.config import Config
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]
Vector = tuple[float, float, float]

ELLIPSOID_DRAWS = 50
"""Ellipsoids drawn before a target is given up as too small for the mesh."""


class BoxMesh(Config):
    """Ask for a box of cubes, six tetrahedra each."""

    kind: Literal["box"]
    cells: tuple[PositiveInt, PositiveInt, PositiveInt]
    """Cubes along x, y and z."""
    spacing: PositiveFloat
    """Edge of a cube [m]; also the unit of length of all costs."""


class FileMesh(Config):
    """Ask for a mesh file."""

    kind: Literal["file"]
    path: str
    """The file; a relative path starts at the folder of the scene file."""
    spacing: PositiveFloat | None = None
    """Unit of length of all costs [m]; by default (6 mean volume)^(1/3)."""

    @field_validator("path")
    @classmethod
    def _start_at_the_scene_file(cls, path: str, info: ValidationInfo) -> str:
        return str((info.context or {}).get("folder", pathlib.Path()) / path)


class PinnedPlane(Config):
    """Pin the lowest points along an axis."""

    kind: Literal["plane"]
    axis: Literal["x", "y", "z"] = "z"

    def points(self, mesh: Mesh) -> Array:
        """Return the pinned points, bool, shape (n_points,)."""
        height = mesh.points[:, "xyz".index(self.axis)]
        # Round-off in a file must not unpin half of a plane.
        return np.asarray(height <= height.min() + 1e-6 * np.ptp(height))


class PinnedRegion(Config):
    """Pin a named region of points of the mesh file."""

    kind: Literal["region"]
    name: str

    def points(self, mesh: Mesh) -> Array:
        """Return the pinned points, bool, shape (n_points,)."""
        return _region(mesh.point_regions, self.name, "pinned.name").copy()


class TopCubeTarget(Config):
    """Free one random cube of the top layer; only for a box."""

    kind: Literal["top_cube"]

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        assert isinstance(source, BoxMesh)  # SceneConfig sees to it
        n_x, n_y, n_z = source.cells
        i, j = rng.integers(0, n_x), rng.integers(0, n_y)
        cube_of = np.arange(mesh.n_tetrahedra) // 6
        return np.asarray(cube_of == (i * n_y + j) * n_z + n_z - 1)


class EllipsoidTarget(Config):
    """Free what lies in a random ellipsoid near the top."""

    kind: Literal["ellipsoid"]
    radius: PositiveFloat
    """Mean half-axis, in units of length h; each half-axis is 0.8 to 1.25 of it."""
    min_tetrahedra: PositiveInt = 6
    """Fewest tetrahedra that make a target; a smaller one is drawn again."""

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
        low, extent = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)
        radius = self.radius * spacing
        for _ in range(ELLIPSOID_DRAWS):
            centre = low + extent * rng.uniform([0.25, 0.25, 1.0], [0.75, 0.75, 1.0])
            centre[2] -= rng.uniform(0.0, 0.5) * radius
            distance = (centroids - centre) / (radius * rng.uniform(0.8, 1.25, 3))
            inside = np.asarray((distance**2).sum(axis=1) < 1.0)
            if inside.sum() >= self.min_tetrahedra:
                return inside
        raise ConfigError(
            f"target.radius = {self.radius} h ({radius:.3g} m) gave fewer than {self.min_tetrahedra} tetrahedra "
            f"in {ELLIPSOID_DRAWS} draws; enlarge it"
        )


class UnderSurfaceTarget(Config):
    """Free what lies in a random ellipsoid near a random place of the surface."""

    kind: Literal["under_surface"]
    radius: PositiveFloat
    """Mean half-axis, in units of length h; each half-axis is 0.8 to 1.25 of it."""
    min_tetrahedra: PositiveInt = 6
    """Fewest tetrahedra that make a target; a smaller one, or one in several pieces, is drawn again."""

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        surface = surface_of(mesh)
        centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
        radius = self.radius * spacing
        for _ in range(ELLIPSOID_DRAWS):
            face = rng.integers(len(surface.area))
            centre = surface.centroid[face] - _unit(surface.area[face]) * (rng.uniform(0.0, 0.5) * radius)
            distance = (centroids - centre) / (radius * rng.uniform(0.8, 1.25, 3))
            inside = np.asarray((distance**2).sum(axis=1) < 1.0)
            if inside.sum() >= self.min_tetrahedra and is_one_piece(mesh, inside):
                return inside
        raise ConfigError(
            f"target.radius = {self.radius} h ({radius:.3g} m) gave no piece of {self.min_tetrahedra} tetrahedra "
            f"in {ELLIPSOID_DRAWS} draws; enlarge it"
        )


class RegionTarget(Config):
    """Free a named region of tetrahedra of the mesh file."""

    kind: Literal["region"]
    name: str

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        return _region(mesh.cell_regions, self.name, "target.name").copy()


class ConeDirection(Config):
    """Pull in a random upward direction."""

    kind: Literal["cone"]
    width: PositiveFloat
    """Spread: a standard normal vector, folded upward, gets 1 / width added to its height."""

    def draw(self, mesh: Mesh, target: Array, rng: np.random.Generator) -> Array:
        """Return a unit vector, shape (3,)."""
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2]) + 1.0 / self.width
        return _unit(direction)


class OutwardDirection(Config):
    """Pull in a random direction that leads out of the body where the target lies bare."""

    kind: Literal["outward"]
    width: PositiveFloat
    """Spread: a standard normal vector, folded outward, gets 1 / width added to its outward part."""

    def draw(self, mesh: Mesh, target: Array, rng: np.random.Generator) -> Array:
        """Return a unit vector, shape (3,)."""
        surface = surface_of(mesh)
        outward = surface.area[target[surface.tetrahedron]].sum(axis=0)
        if not outward.any():
            raise ConfigError("load.direction.kind 'outward' needs a target with a face on the surface; choose 'cone' or 'fixed'")
        outward = _unit(outward)
        direction = rng.normal(size=3)
        along = direction @ outward
        return _unit(direction + (abs(along) - along + 1.0 / self.width) * outward)


class FixedDirection(Config):
    """Pull in one given direction."""

    kind: Literal["fixed"]
    vector: Vector

    @field_validator("vector")
    @classmethod
    def _is_not_zero(cls, vector: Vector) -> Vector:
        if not any(vector):
            raise ValueError("give a direction other than zero")
        return vector

    def draw(self, mesh: Mesh, target: Array, rng: np.random.Generator) -> Array:
        """Return a unit vector, shape (3,)."""
        return _unit(np.array(self.vector))


class Surface(NamedTuple):
    """Bare faces of an uncut mesh."""

    tetrahedron: Array
    """Whose face each is, (n,)."""
    centroid: Array
    """[m], (n, 3)."""
    area: Array
    """Outward vector as long as the area [m^2], (n, 3)."""


@lru_cache(maxsize=16)
def surface_of(mesh: Mesh) -> Surface:
    """Return the bare faces of a mesh."""
    is_bare = np.ones(4 * mesh.n_tetrahedra, dtype=bool)
    for slots in paired_faces(mesh.tetrahedra, mesh.n_points):
        is_bare[slots] = False
    corners = mesh.points[mesh.tetrahedra[:, OUTWARD_FACE_CORNERS].reshape(-1, 3)[is_bare]]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return Surface(np.flatnonzero(is_bare) // 4, corners.mean(axis=1), area)


def is_one_piece(mesh: Mesh, members: Array) -> bool:
    """Return whether chains of faces join all of some tetrahedra, bool (n_tetrahedra,), among themselves."""
    one, other = (slots // 4 for slots in paired_faces(mesh.tetrahedra, mesh.n_points))
    is_link = members[one] & members[other]
    place = np.cumsum(members) - 1
    links = coo_array((is_link[is_link], (place[one[is_link]], place[other[is_link]])), shape=(members.sum(),) * 2)
    return bool(connected_components(links, directed=False, return_labels=False) == 1)


def _unit(vector: Array) -> Array:
    """Return a vector divided by its length."""
    return np.asarray(vector / np.sqrt((vector**2).sum()))


def _region(regions: Mapping[str, Array], name: str, path: str) -> Array:
    """Return a named region of a mesh, or raise with the names there are."""
    if name not in regions:
        raise ConfigError(f"{path}: the mesh has no region {name!r}; it has {', '.join(sorted(regions)) or 'none'}")
    return np.asarray(regions[name])
