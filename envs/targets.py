"""What is to be freed and what must not be cut, by kind: the models of `target` and `no_cut` in a scene file.

To add a kind is to add its model here and name it in scene_config.py.
"""

from itertools import combinations
from typing import Any, Literal, Self

import numpy as np
from pydantic import PositiveFloat, PositiveInt, model_validator

from envs.action_table import action_table, beside, face_pieces
from envs.scene_kinds import BoxMesh, FileMesh, region_of, unit
from envs.surface import surface_of
from gmapspring.config import Config
from gmapspring.errors import ConfigError
from gmapspring.mesh import Mesh

Array = np.ndarray[Any, Any]

ELLIPSOID_DRAWS = 50
"""Ellipsoids drawn before a target is given up as too small for the mesh."""
ELLIPSOID_SETS = 1000
"""Sets of ellipsoids drawn before they are given up as too crowded."""


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
    """Free what lies in a random ellipsoid near the top, or in several that neither overlap nor touch by a face."""

    kind: Literal["ellipsoid"]
    radius: PositiveFloat
    """Mean half-axis, in units of length h; each half-axis is 0.8 to 1.25 of it."""
    min_tetrahedra: PositiveInt = 6
    """Fewest tetrahedra that make a target; a smaller one is drawn again."""
    count: PositiveInt | None = None
    """How many ellipsoids; by default one."""

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        table = action_table(mesh)
        for _ in range(ELLIPSOID_SETS):
            found = [self._draw_one(mesh, spacing, rng) for _ in range(self.count or 1)]
            if not any((beside(table, one) & other).any() for one, other in combinations(found, 2)):
                return np.asarray(np.any(found, axis=0))
        raise ConfigError(
            f"target.count = {self.count}: ellipsoids of radius {self.radius} h overlapped or touched in all "
            f"of {ELLIPSOID_SETS} draws; ask for fewer or smaller ones"
        )

    def _draw_one(self, mesh: Mesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return one ellipsoid, bool, shape (n_tetrahedra,)."""
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
        table, surface = action_table(mesh), surface_of(mesh)
        centroids = mesh.points[mesh.tetrahedra].mean(axis=1)
        radius = self.radius * spacing
        for _ in range(ELLIPSOID_DRAWS):
            face = rng.integers(len(surface.area))
            centre = surface.centroid[face] - unit(surface.area[face]) * (rng.uniform(0.0, 0.5) * radius)
            distance = (centroids - centre) / (radius * rng.uniform(0.8, 1.25, 3))
            inside = np.asarray((distance**2).sum(axis=1) < 1.0)
            if inside.sum() >= self.min_tetrahedra and face_pieces(table, inside).max() == 0:
                return inside
        raise ConfigError(
            f"target.radius = {self.radius} h ({radius:.3g} m) gave no piece of {self.min_tetrahedra} tetrahedra "
            f"in {ELLIPSOID_DRAWS} draws; enlarge it"
        )


class RegionTarget(Config):
    """Free a named region of tetrahedra of the mesh file, or several."""

    kind: Literal["region"]
    name: str | None = None
    names: tuple[str, ...] | None = None
    """Instead of `name`."""

    @model_validator(mode="after")
    def _names_something(self) -> Self:
        if (self.name is None) == (not self.names):
            raise ValueError("give either name, or names, a list of at least one")
        return self

    def draw(self, mesh: Mesh, source: BoxMesh | FileMesh, spacing: float, rng: np.random.Generator) -> Array:
        """Return the target, bool, shape (n_tetrahedra,)."""
        if self.name is not None:
            return region_of(mesh.cell_regions, self.name, "target.name").copy()
        return np.any([region_of(mesh.cell_regions, name, "target.names") for name in self.names or ()], axis=0)


class NoCutRegion(Config):
    """Spare a named region of tetrahedra of the mesh file; target tetrahedra never belong to it."""

    kind: Literal["region"]
    name: str

    def draw(self, mesh: Mesh, target: Array, pinned: Array, rng: np.random.Generator) -> Array:
        """Return the vessel, bool, shape (n_tetrahedra,)."""
        return region_of(mesh.cell_regions, self.name, "no_cut.name") & ~target


class Channel(Config):
    """Spare a random chain of tetrahedra that leads from the pinned plane up beside the target; only for a box."""

    kind: Literal["channel"]

    def draw(self, mesh: Mesh, target: Array, pinned: Array, rng: np.random.Generator) -> Array:
        """Return the vessel, bool, shape (n_tetrahedra,): of all chains to a random end, the shortest by random lengths.

        It has no face in common with the target, which therefore can be cut out without laying it open. If it can, it ends at a
        hollow of the target: there the cheapest cuts would go straight through healthy tissue, and often have to go round now.
        """
        # Imported where it is used, as in `gmapspring.mesh`: to play a scene that is shipped needs none of it.
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import dijkstra

        table, shape = action_table(mesh), (mesh.n_tetrahedra, mesh.n_tetrahedra)
        sides = table.face_tetrahedra
        apart = ~beside(table, target)
        faces = sides[apart[sides].all(axis=1)]
        graph = csr_array((rng.random(mesh.n_tetrahedra)[faces].sum(axis=1), tuple(faces.T)), shape=shape)
        starts = np.flatnonzero(apart & (pinned[mesh.tetrahedra].sum(axis=1) == 3))
        distance, before, _ = dijkstra(graph, directed=False, indices=starts, return_predecessors=True, min_only=True)
        is_free = ~pinned[mesh.tetrahedra].any(axis=1)
        is_end = apart & beside(table, ~apart) & is_free & np.isfinite(distance)
        n_targets_beside = np.bincount(sides[target[sides[:, ::-1]]], minlength=mesh.n_tetrahedra)
        is_best = is_end & beside(table, ~target & is_free & (n_targets_beside >= 2))
        ends = np.flatnonzero(is_best if is_best.any() else is_end)
        if not len(ends):
            raise ConfigError("no_cut.kind 'channel': there is no room for a channel beside the target; enlarge the box")
        vessel, tet = np.zeros(mesh.n_tetrahedra, dtype=bool), int(rng.choice(ends))
        while tet >= 0:
            vessel[tet], tet = True, int(before[tet])
        return vessel
