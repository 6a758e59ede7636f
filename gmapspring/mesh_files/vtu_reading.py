"""Read .vtu files in every encoding that VTK writes, save lz4: text, base64 or raw, plain or compressed."""

import base64
import lzma
import pathlib
import re
import zlib
from collections.abc import Callable
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.raw_mesh import RawMesh, regions_in
from gmapspring.mesh_files.vtk_cells import pick_tetrahedra

Array = np.ndarray[Any, Any]

TYPES = {"Int": "i", "UInt": "u", "Float": "f"}
"""numpy's letters for VTK's kinds of numbers."""

DECOMPRESSORS: dict[str, Callable[[bytes], bytes]] = {
    "vtkZLibDataCompressor": zlib.decompress,
    "vtkLZMADataCompressor": lzma.decompress,
}
"""Known compressors by VTK's names."""


class Encoding(NamedTuple):
    """How the arrays of a file are stored."""

    byte_order: str
    """"<" or ">"."""

    header: Any
    """dtype of the sizes before each array."""

    compressor: str
    """VTK's name, empty for none."""

    appended: bytes
    """All that follows the arrays in an AppendedData element, empty without one."""

    is_raw: bool
    """Whether the appended data are raw bytes and not base64."""


def read_vtu(path: pathlib.Path) -> RawMesh:
    """Read an unstructured grid in XML; arrays called "region:NAME" become regions."""
    data = path.read_bytes()
    if not data.strip():
        raise MeshError("the file is empty")
    root, encoding = _parsed(data)
    pieces = root.findall("./UnstructuredGrid/Piece")
    if len(pieces) != 1:
        raise MeshError(f"the file has {len(pieces)} pieces; merge them into one before saving")
    piece = pieces[0]
    n_points, n_cells = int(piece.attrib["NumberOfPoints"]), int(piece.attrib["NumberOfCells"])
    points = _only(_arrays(piece, "Points", encoding, n_points)).reshape(n_points, 3).astype(np.float64)
    cells = _arrays(piece, "Cells", encoding, None)
    picked = pick_tetrahedra(cells["connectivity"].ravel(), cells["offsets"].ravel(), cells["types"].ravel())
    if len(picked.is_tetrahedron) != n_cells:
        raise MeshError(f"{n_cells} cells are announced and {len(picked.is_tetrahedron)} found: the file is corrupt")
    cell_regions = regions_in(_arrays(piece, "CellData", encoding, n_cells))
    cell_regions = {name: mask[picked.is_tetrahedron] for name, mask in cell_regions.items()}
    point_regions = regions_in(_arrays(piece, "PointData", encoding, n_points))
    return RawMesh(points, picked.tetrahedra, cell_regions, point_regions, picked.ignored_solids)


def _parsed(data: bytes) -> tuple[ElementTree.Element, Encoding]:
    """Return the XML tree and the encoding; raw appended data are no XML and are cut out first."""
    found = re.search(rb"<AppendedData\b([^>]*)>\s*_", data)
    appended, is_raw = b"", False
    if found:
        end = data.rfind(b"</AppendedData>")
        if end < 0:
            raise MeshError("the appended data have no end: the file is truncated")
        appended, is_raw = data[found.end() : end], b"raw" in found[1]
        data = data[: found.start()] + data[end + len(b"</AppendedData>") :]
    root = ElementTree.fromstring(data)
    if root.tag != "VTKFile" or root.get("type") != "UnstructuredGrid":
        raise MeshError(f"it is a <{root.tag}> of type {root.get('type')!r}, not a VTKFile of type 'UnstructuredGrid'")
    byte_order = ">" if root.get("byte_order") == "BigEndian" else "<"
    compressor = root.get("compressor", "")
    if compressor and compressor not in DECOMPRESSORS:
        raise MeshError(f"compression {compressor} is not supported; save it with zlib or without compression")
    header = np.dtype(f"{byte_order}u{8 if root.get('header_type') == 'UInt64' else 4}")
    return root, Encoding(byte_order, header, compressor, appended, is_raw)


def _only(arrays: dict[str, Array]) -> Array:
    """Return the one array of a section."""
    if len(arrays) != 1:
        raise MeshError(f"a section should hold one array and holds {len(arrays)}: the file is corrupt")
    return next(iter(arrays.values()))


def _arrays(piece: ElementTree.Element, name: str, encoding: Encoding, length: int | None) -> dict[str, Array]:
    """Return the arrays of a section by name, each (length,) or (length, k) where a length is given."""
    arrays = {}
    for element in piece.findall(f"./{name}/DataArray"):
        letters = re.fullmatch(r"(Int|UInt|Float)(8|16|32|64)", element.get("type", ""))
        if letters is None:
            continue  # text, which no region is made of
        values = _values(element, np.dtype(f"{encoding.byte_order}{TYPES[letters[1]]}{int(letters[2]) // 8}"), encoding)
        width = int(element.get("NumberOfComponents", 1))
        if length is not None:
            if len(values) != length * width:
                raise MeshError(
                    f"array {element.get('Name')!r} has {len(values)} values instead of {length} x {width}: "
                    "the file is truncated or corrupt"
                )
            values = values.reshape(length, width) if width > 1 else values
        arrays[element.get("Name", "")] = values
    return arrays


def _values(element: ElementTree.Element, dtype: Any, encoding: Encoding) -> Array:
    """Return the numbers of one DataArray."""
    text, form = element.text or "", element.get("format", "ascii")
    if form == "ascii":
        convert = float if dtype.kind == "f" else int
        return np.array([convert(word) for word in text.split()], dtype=dtype)
    if form == "appended":
        stored = encoding.appended[int(element.attrib["offset"]) :]
        return np.frombuffer(_unpacked(stored, encoding, encoding.is_raw), dtype)
    if form == "binary":
        return np.frombuffer(_unpacked(b"".join(text.encode().split()), encoding, False), dtype)
    raise MeshError(f"array {element.get('Name')!r} has the unknown format {form!r}")


def _unpacked(stored: bytes, encoding: Encoding, is_raw: bool) -> bytes:
    """Return the bytes of an array that starts here: first its sizes, then its content, perhaps compressed."""
    word = encoding.header.itemsize
    first, rest = _decoded(stored, word, is_raw)
    count = int(np.frombuffer(first, encoding.header)[0])
    if not encoding.compressor:
        # In base64 the size and the content are usually one stream; padding after the size tells two.
        is_apart = is_raw or b"=" in stored[: len(stored) - len(rest)]
        return _decoded(rest, count, is_raw)[0] if is_apart else _decoded(stored, word + count, is_raw)[0][word:]
    # Number of blocks, size of each, size of the last if partial, compressed sizes.
    header, rest = _decoded(stored, (3 + count) * word, is_raw)
    sizes = np.frombuffer(header, encoding.header)[3:].astype(np.int64)
    packed = _decoded(rest, int(sizes.sum()), is_raw)[0]
    ends = np.cumsum(sizes)
    decompress = DECOMPRESSORS[encoding.compressor]
    return b"".join(decompress(packed[end - size : end]) for end, size in zip(ends, sizes, strict=True))


def _decoded(stored: bytes, n_bytes: int, is_raw: bool) -> tuple[bytes, bytes]:
    """Return the first bytes of raw or base64 data, and what is stored after them."""
    n_stored = n_bytes if is_raw else 4 * ((n_bytes + 2) // 3)
    if n_stored > len(stored):
        raise MeshError("an array is shorter than its header says: the file is truncated")
    taken = stored[:n_stored]
    return (taken if is_raw else base64.b64decode(taken, validate=True)[:n_bytes]), stored[n_stored:]
