"""Write .vtu files (VTK's XML format for unstructured grids), which ParaView opens. Needs numpy only."""

import base64
import os
import pathlib
import zlib
from collections.abc import Mapping
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh import Mesh
from gmapspring.mesh_checks import check_range, checked_shape
from gmapspring.mesh_files.raw_mesh import REGION_PREFIX
from gmapspring.mesh_files.vtk_cells import TETRAHEDRON
from gmapspring.paths import write_atomically

Array = np.ndarray[Any, Any]

TYPE_NAMES = {"i": "Int", "u": "UInt", "f": "Float"}
"""VTK's names of the kinds of numbers, to be followed by the number of bits."""


def write_mesh(
    path: str | os.PathLike[str],
    mesh: Mesh,
    point_data: Mapping[str, Any] | None = None,
    cell_data: Mapping[str, Any] | None = None,
) -> None:
    """Write a mesh with its regions, and fields on its points and tetrahedra, as a .vtu file.

    Args:
        path: a name that ends in .vtu; a file of that name is replaced only once the new one is complete.
        mesh: its regions become arrays "region:NAME", which `read_mesh` turns back into regions.
        point_data: named arrays of numbers or bools, shape (n_points,) or (n_points, k).
        cell_data: the same, shape (n_tetrahedra,) or (n_tetrahedra, k).

    Raises:
        MeshError: another ending, a field of another length, or one that is not numbers.
    """
    on_points = _with_regions(point_data or {}, mesh.point_regions)
    on_cells = _with_regions(cell_data or {}, mesh.cell_regions)
    write_vtu(path, mesh.points, mesh.tetrahedra, on_points, on_cells)


def write_vtu(
    path: str | os.PathLike[str],
    points: Array,
    tetrahedra: Array,
    point_data: Mapping[str, Any] | None = None,
    cell_data: Mapping[str, Any] | None = None,
) -> None:
    """Write plain arrays, such as the nodes of a cut body, as a .vtu file; see `write_mesh`.

    Args:
        path: a name that ends in .vtu.
        points: coordinates [m], shape (n_points, 3).
        tetrahedra: rows of points, shape (n_tetrahedra, 4).
        point_data: named fields, shape (n_points,) or (n_points, k).
        cell_data: named fields, shape (n_tetrahedra,) or (n_tetrahedra, k).
    """
    path = pathlib.Path(path)
    if path.suffix.lower() != ".vtu":
        raise MeshError(f"cannot write {path}: give a name that ends in .vtu")
    points = checked_shape(points)
    tetrahedra = np.asarray(tetrahedra)
    if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4 or tetrahedra.dtype.kind not in "iu":
        raise MeshError(f"tetrahedra have dtype {tetrahedra.dtype} and shape {tetrahedra.shape}; give integers (n, 4)")
    check_range(tetrahedra, len(points))
    text = _document(points, tetrahedra, point_data or {}, cell_data or {})
    try:
        write_atomically(path, text.encode())
    except OSError as error:
        raise MeshError(f"cannot write {path}: {error.strerror or error}") from error


def _with_regions(data: Mapping[str, Any], regions: Mapping[str, Array]) -> dict[str, Any]:
    """Return fields and regions together."""
    named = {f"{REGION_PREFIX}{name}": mask for name, mask in regions.items()}
    clashes = sorted(named.keys() & data.keys())
    if clashes:
        raise MeshError(f"field {clashes[0]!r} has the name of a region of the mesh; rename the field")
    return {**data, **named}


def _document(points: Array, tetrahedra: Array, point_data: Mapping[str, Any], cell_data: Mapping[str, Any]) -> str:
    """Return the whole file."""
    n_points, n_cells = len(points), len(tetrahedra)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian"',
        'header_type="UInt64" compressor="vtkZLibDataCompressor">',
        f'<UnstructuredGrid><Piece NumberOfPoints="{n_points}" NumberOfCells="{n_cells}">',
        *("<Points>", _data_array("Points", points), "</Points>"),
        "<Cells>",
        _data_array("connectivity", tetrahedra.astype(np.int32).ravel()),
        _data_array("offsets", np.arange(4, 4 * n_cells + 1, 4, dtype=np.int32)),
        _data_array("types", np.full(n_cells, TETRAHEDRON, dtype=np.uint8)),
        "</Cells>",
        *("<PointData>", *_fields(point_data, n_points, "point_data"), "</PointData>"),
        *("<CellData>", *_fields(cell_data, n_cells, "cell_data"), "</CellData>"),
        "</Piece></UnstructuredGrid></VTKFile>\n",
    ]
    return "\n".join(lines)


def _fields(data: Mapping[str, Any], length: int, where: str) -> list[str]:
    """Return the elements of named fields, each of the given length."""
    elements = []
    for name, values in data.items():
        array = np.asarray(values)
        if not isinstance(name, str) or not name:
            raise MeshError(f"{where} has the name {name!r}; give a non-empty string")
        if array.ndim not in (1, 2) or len(array) != length or array.dtype.kind not in "iufb":
            raise MeshError(
                f"{where}[{name!r}] has dtype {array.dtype} and shape {array.shape}; "
                f"give numbers of shape ({length},) or ({length}, k)"
            )
        elements.append(_data_array(name, array))
    return elements


def _data_array(name: str, values: Array) -> str:
    """Return one DataArray: a header of sizes, then the compressed values, both in base64."""
    if values.dtype.kind == "b":
        values = values.astype(np.uint8)
    if values.dtype.itemsize not in (1, 2, 4, 8) or values.dtype == np.float16:
        values = values.astype(np.float64 if values.dtype.itemsize > 8 else np.float32)
    type_name = f"{TYPE_NAMES[values.dtype.kind]}{8 * values.dtype.itemsize}"
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    content = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")).tobytes()
    packed = zlib.compress(content, 9)
    # One block: number of blocks, size of each, size of the last if partial, compressed size.
    sizes = np.array([1, len(content), 0, len(packed)] if content else [0, 0, 0], dtype="<u8").tobytes()
    body = base64.b64encode(sizes) + (base64.b64encode(packed) if content else b"")
    return f'<DataArray type="{type_name}" Name={quoteattr(name)}{components} format="binary">{body.decode()}</DataArray>'
