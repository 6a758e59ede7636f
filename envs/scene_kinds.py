"""Parts of a scene file that come in several kinds, told apart by the key `kind`: mesh, pinned, direction.

Targets and vessels are in targets.py. To add a kind is to add its model here and name it in scene_config.py.
"""

import pathlib
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import PositiveFloat, PositiveInt, ValidationInfo, field_validator

from envs.surface import surface_of
from gmapspring.config import Config
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh

Array = np.ndarray[Any, Any]
Vector = tuple[float, float, float]


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
        return region_of(mesh.point_regions, self.name, "pinned.name").copy()


class ConeDirection(Config):
    """Pull in a random upward direction."""

    kind: Literal["cone"]
    width: PositiveFloat
    """Spread: a standard normal vector, folded upward, gets 1 / width added to its height."""

    def draw(self, mesh: Mesh, target: Array, rng: np.random.Generator) -> Array:
        """Return a unit vector, shape (3,)."""
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2]) + 1.0 / self.width
        return unit(direction)


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
        outward = unit(outward)
        direction = rng.normal(size=3)
        along = direction @ outward
        return unit(direction + (abs(along) - along + 1.0 / self.width) * outward)


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
        return unit(np.array(self.vector))


def unit(vector: Array) -> Array:
    """Return a vector divided by its length."""
    return np.asarray(vector / np.sqrt((vector**2).sum()))


def region_of(regions: Mapping[str, Array], name: str, path: str) -> Array:
    """Return a named region of a mesh, or raise with the names there are."""
    if name not in regions:
        raise ConfigError(f"{path}: the mesh has no region {name!r}; it has {', '.join(sorted(regions)) or 'none'}")
    return np.asarray(regions[name])
