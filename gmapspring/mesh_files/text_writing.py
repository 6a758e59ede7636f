"""Write meshes as text that other mesh programs read: gmsh's format 2.2 (.msh) and medit's (.mesh)."""

import io
import pathlib
import warnings
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh
from gmapspring.mesh_files.reading import MeshWarning
from gmapspring.mesh_files.vtu_writing import write_mesh
from gmapspring.paths import write_atomically

Array = np.ndarray[Any, Any]

GMSH_POINT, GMSH_TETRAHEDRON = 15, 4
"""Gmsh's numbers of the kinds of elements."""


def write_any(path: pathlib.Path, mesh: Mesh) -> None:
    """Write a mesh in the format that the file's ending names; warn, by `MeshWarning`, of regions that it cannot hold.

    A .vtu file holds all regions. In a .msh file a tetrahedron is of one cell region at most, and in a .mesh file
    regions have numbers for names and points are of none.

    Raises:
        MeshError: there is no writer for this ending, or the file cannot be written.
    """
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise MeshError(f"cannot write {path}: the ending {path.suffix!r} is none of {', '.join(WRITERS)}")
    try:
        writer(path, mesh)
    except OSError as error:
        raise MeshError(f"cannot write {path}: {error.strerror or error}") from error


def _write_gmsh(path: pathlib.Path, mesh: Mesh) -> None:
    """Write gmsh's format 2.2: regions are physical groups, those of points by elements of a single point."""
    region = _one_region_each(path, mesh)
    cells, points = list(mesh.cell_regions), list(mesh.point_regions)
    names = [f'3 {number} "{name}"' for number, name in enumerate(cells, start=1)]
    names += [f'0 {number} "{name}"' for number, name in enumerate(points, start=len(cells) + 1)]
    elements = [
        f"{GMSH_POINT} 2 {number} {number} {point + 1}"
        for number, name in enumerate(points, start=len(cells) + 1)
        for point in np.flatnonzero(mesh.point_regions[name])
    ]
    corners = (mesh.tetrahedra + 1).tolist()
    elements += [f"{GMSH_TETRAHEDRON} 2 {of} {of} {' '.join(map(str, row))}" for of, row in zip(region, corners, strict=True)]
    _write(path, [
        *("$MeshFormat", "2.2 0 8", "$EndMeshFormat"),
        *(["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames"] if names else []),
        *("$Nodes", str(mesh.n_points), *_numbered(_rows(mesh.points)), "$EndNodes"),
        *("$Elements", str(len(elements)), *_numbered(elements), "$EndElements"),
    ])  # fmt: skip


def _write_medit(path: pathlib.Path, mesh: Mesh) -> None:
    """Write medit's format: the reference of a tetrahedron is the number of its region, from 1 up, 0 for none."""
    if mesh.point_regions:
        _warn(path, f"no regions of points ({', '.join(mesh.point_regions)})")
    for number, name in enumerate(mesh.cell_regions, start=1):
        if name != f"ref_{number}":
            _warn(path, f"no names of regions: {name} becomes ref_{number}")
    region, corners = _one_region_each(path, mesh), (mesh.tetrahedra + 1).tolist()
    _write(path, [
        *("MeshVersionFormatted 2", "Dimension 3"),
        *("Vertices", str(mesh.n_points), *(f"{row} 0" for row in _rows(mesh.points))),
        *("Tetrahedra", str(mesh.n_tetrahedra)),
        *(f"{' '.join(map(str, row))} {of}" for of, row in zip(region, corners, strict=True)),
        "End",
    ])  # fmt: skip


WRITERS: dict[str, Callable[[pathlib.Path, Mesh], None]] = {".vtu": write_mesh, ".msh": _write_gmsh, ".mesh": _write_medit}
"""Writers by file ending."""


def _one_region_each(path: pathlib.Path, mesh: Mesh) -> list[int]:
    """Return the number of each tetrahedron's region, from 1 up, 0 for none; of several, the first."""
    number, taken = np.zeros(mesh.n_tetrahedra, np.int64), 0
    for place, mask in enumerate(mesh.cell_regions.values(), start=1):
        taken += int(np.count_nonzero(number[mask]))
        number[mask & (number == 0)] = place
    if taken:
        _warn(path, f"one region of a tetrahedron, and keeps the first of {taken} more")
    return [int(of) for of in number]


def _warn(path: pathlib.Path, what: str) -> None:
    """Tell what a format cannot hold."""
    warnings.warn(f"{path}: {path.suffix} holds {what}; .vtu holds them all", MeshWarning, stacklevel=4)


def _rows(points: Array) -> list[str]:
    """Return a line for each point, with all digits."""
    return [" ".join(map(repr, row)) for row in points.tolist()]


def _numbered(lines: Iterable[str]) -> Iterable[str]:
    """Put the number before each line, from 1 up."""
    return (f"{number} {line}" for number, line in enumerate(lines, start=1))


def _write(path: pathlib.Path, lines: Iterable[str]) -> None:
    """Write lines as a file, in one go."""
    text = io.StringIO()
    text.writelines(f"{line}\n" for line in lines)
    write_atomically(path, text.getvalue().encode())
