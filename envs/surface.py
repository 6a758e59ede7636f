"""The surface of an uncut mesh: its bare faces, with normals."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import paired_faces
from gmapspring.topology.darts import OUTWARD_FACE_CORNERS

Array = np.ndarray[Any, Any]


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
