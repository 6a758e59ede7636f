"""What a mesh file holds, before anything is checked."""

from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, Any]

REGION_PREFIX = "region:"
"""A data array of this name prefix in a VTK file marks a region: nonzero inside."""


class RawMesh(NamedTuple):
    """Points, tetrahedra and regions as they stand in a file."""

    points: Array
    """Coordinates [m], float64, shape (n_points, 3)."""

    tetrahedra: Array
    """Rows of points, from 0, int64, shape (n_tetrahedra, 4)."""

    cell_regions: dict[str, Array]
    """Named masks, bool, shape (n_tetrahedra,)."""

    point_regions: dict[str, Array]
    """Named masks, bool, shape (n_points,)."""

    ignored_solids: dict[str, int]
    """Solid cells that are not linear tetrahedra: how many of each kind."""


def regions_in(data: dict[str, Array]) -> dict[str, Array]:
    """Return the masks among named data arrays, by region name."""
    return {
        name.removeprefix(REGION_PREFIX): np.asarray(values).reshape(len(values), -1)[:, 0] != 0
        for name, values in data.items()
        if name.startswith(REGION_PREFIX)
    }
