"""Pick the tetrahedra out of VTK's cells; the same for .vtu and legacy .vtk files."""

from typing import Any, NamedTuple

import numpy as np

from gmapspring.errors import MeshError

Array = np.ndarray[Any, Any]

TETRAHEDRON = 10
"""VTK's number for the linear tetrahedron."""

SIZES = {1: 1, 3: 2, 5: 3, 8: 4, 9: 4, TETRAHEDRON: 4, 11: 8, 12: 8, 13: 6, 14: 5}
"""Points of the linear cells of fixed size, by VTK's number."""

SOLID_NAMES = {11: "voxels", 12: "hexahedra", 13: "prisms", 14: "pyramids", 24: "second-order tetrahedra", 42: "polyhedra"}
"""Solids that are not linear tetrahedra, by VTK's number."""


class PickedCells(NamedTuple):
    """The tetrahedra among the cells of a file."""

    tetrahedra: Array
    """Rows of points, int64, shape (n_tetrahedra, 4)."""

    is_tetrahedron: Array
    """Which cells they are, bool, shape (n_cells,)."""

    ignored_solids: dict[str, int]
    """Solid cells that are not linear tetrahedra: how many of each kind."""


def pick_tetrahedra(connectivity: Array, ends: Array, types: Array) -> PickedCells:
    """Pick them from the points of all cells in a row, the end of each cell in it, and the kinds of the cells."""
    if len(ends) != len(types):
        raise MeshError(f"there are {len(ends)} cells but {len(types)} kinds: the file is truncated or corrupt")
    ends = ends.astype(np.int64)
    sizes = np.diff(ends, prepend=0)
    if (sizes < 0).any() or (len(ends) and ends[-1] != len(connectivity)):
        raise MeshError("the ends of the cells do not fit their points: the file is truncated or corrupt")
    for kind, size in SIZES.items():
        if (sizes[types == kind] != size).any():
            raise MeshError(f"a cell of kind {kind} does not have {size} points: the file is truncated or corrupt")
    is_tetrahedron = types == TETRAHEDRON
    tetrahedra = connectivity[ends[is_tetrahedron][:, None] + np.arange(-4, 0)].astype(np.int64)
    counts = {name: int(np.count_nonzero(types == kind)) for kind, name in SOLID_NAMES.items()}
    return PickedCells(tetrahedra, is_tetrahedron, {name: count for name, count in counts.items() if count})
