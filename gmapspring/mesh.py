"""A tetrahedral mesh: points, tetrahedra and named regions, checked once so that nothing downstream has to."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from gmapspring.mesh_checks import (
    check_faces,
    check_volumes,
    checked_points,
    checked_regions,
    checked_tetrahedra,
    paired_faces,
    signed_volumes,
)
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Hold a mesh that a body can be built on; raise `MeshError` for any other, naming the culprit and the way out."""

    points: Array
    """Rest positions [m], float64, shape (n_points, 3); each is a corner of some tetrahedron."""

    tetrahedra: Array
    """Points at the corners, int32, shape (n_tetrahedra, 4); dot(cross(p1 - p0, p2 - p0), p3 - p0) > 0."""

    cell_regions: Mapping[str, Array] = field(default_factory=dict)
    """Named sets of tetrahedra: masks, bool, shape (n_tetrahedra,)."""

    point_regions: Mapping[str, Array] = field(default_factory=dict)
    """Named sets of points: masks, bool, shape (n_points,)."""

    def __post_init__(self) -> None:
        """Check everything, then keep private read-only copies."""
        points = checked_points(self.points)
        tetrahedra = checked_tetrahedra(self.tetrahedra, len(points))
        check_volumes(points, tetrahedra)
        check_faces(tetrahedra, len(points))
        cells = checked_regions(self.cell_regions, len(tetrahedra), "tetrahedra", "cell_regions")
        marks = checked_regions(self.point_regions, len(points), "points", "point_regions")
        self.__dict__.update(points=points, tetrahedra=tetrahedra, cell_regions=cells, point_regions=marks)
        self._freeze()

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take over the fields of a pickled or copied mesh, whose arrays arrive writable."""
        self.__dict__.update({name: value for name, value in state.items() if name != "volumes"})
        self._freeze()

    def _freeze(self) -> None:
        """Make all arrays read-only: what has been checked stays true."""
        for array in (self.points, self.tetrahedra, *self.cell_regions.values(), *self.point_regions.values()):
            array.flags.writeable = False

    @property
    def n_points(self) -> int:
        """Return the number of points."""
        return len(self.points)

    @property
    def n_tetrahedra(self) -> int:
        """Return the number of tetrahedra."""
        return len(self.tetrahedra)

    @cached_property
    def volumes(self) -> Array:
        """Return the volume of each tetrahedron [m^3], shape (n_tetrahedra,), all positive."""
        volumes = signed_volumes(self.points, self.tetrahedra)
        volumes.flags.writeable = False
        return volumes


class PinchedPoints(NamedTuple):
    """Points at which parts of a mesh touch without sharing a face there."""

    points: Array
    """Their ids, ascending, shape (n_pinched,)."""

    n_nodes: Array
    """Nodes that each becomes in a body (two or more), shape (n_pinched,)."""


def pinched_points(mesh: Mesh) -> PinchedPoints:
    """Report the points that become several nodes, since their tetrahedra are not connected through faces.

    Such a mesh is legal: the body holds together through faces only, so its parts come apart at these points.
    """
    # Imported where it is used: that would be a sixth of the time to an environment's first step, which needs none of it.
    from scipy import sparse
    from scipy.sparse import csgraph

    first, second = paired_faces(mesh.tetrahedra, mesh.n_points)
    corner_of = 4 * (first // 4)[:, None] + OUTWARD_FACE_CORNERS[first % 4]
    other_of = 4 * (second // 4)[:, None] + OUTWARD_FACE_CORNERS[second % 4]
    # The same three points on both sides, but wound the other way: match them by their ids.
    ids = mesh.tetrahedra.ravel()
    corner_of = np.take_along_axis(corner_of, np.argsort(ids[corner_of], axis=1), axis=1).ravel()
    other_of = np.take_along_axis(other_of, np.argsort(ids[other_of], axis=1), axis=1).ravel()
    size = 4 * mesh.n_tetrahedra
    links = sparse.coo_array((np.ones(len(corner_of), np.int8), (corner_of, other_of)), shape=(size, size))
    n_nodes, node_of = csgraph.connected_components(links, directed=False)
    point_of_node = np.empty(n_nodes, np.int64)
    point_of_node[node_of] = ids
    counts = np.bincount(point_of_node, minlength=mesh.n_points)
    pinched = np.flatnonzero(counts > 1)
    return PinchedPoints(pinched, counts[pinched])
