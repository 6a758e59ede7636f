"""Read legacy .vtk files (versions 1 to 5.1, text and binary)."""

import pathlib
from typing import Any
from urllib.parse import unquote

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.raw_mesh import RawMesh, regions_in
from gmapspring.mesh_files.vtk_cells import pick_tetrahedra

Array = np.ndarray[Any, Any]

TYPES = {
    "char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtkidtype": "i4",
    "float": "f4",
    "double": "f8",
    **{f"vtktypeint{bits}": f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"vtktypeuint{bits}": f"u{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"vtktypefloat{bits}": f"f{bits // 8}" for bits in (32, 64)},
}
"""numpy's names of the types; the binary form is big-endian."""

WIDTHS = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1}
"""Numbers per item of the attributes `KEYWORD name type`."""


class LegacyText:
    """A legacy file, read from the front: lines of words, and numbers in text or binary."""

    def __init__(self, data: bytes) -> None:
        """Read the three lines of the header."""
        self.data, self.position, self.is_binary = data, 0, False
        if not self.line().startswith("# vtk DataFile Version"):
            raise MeshError("it does not begin with '# vtk DataFile Version'")
        self.line()
        form = self.line().strip().upper()
        if form not in ("ASCII", "BINARY"):
            raise MeshError(f"its third line is {form[:20]!r}, neither ASCII nor BINARY")
        self.is_binary = form == "BINARY"

    def line(self) -> str:
        """Return the next line without its end."""
        end = self.data.find(b"\n", self.position)
        end = len(self.data) if end < 0 else end
        line = self.data[self.position : end]
        self.position = end + 1
        return line.decode("utf-8", errors="replace").rstrip("\r")

    def words(self) -> list[str]:
        """Return the words of the next line that is not blank; none at the end of the file."""
        while self.position < len(self.data):
            words = self.line().split()
            if words:
                return words
        return []

    def skip_paragraph(self) -> None:
        """Skip lines up to the next blank one."""
        while self.position < len(self.data) and self.line().strip():
            pass

    def numbers(self, type_name: str, count: int) -> Array:
        """Return the next numbers, as text or in big-endian bytes."""
        if type_name.lower() not in TYPES:
            raise MeshError(f"arrays of type {type_name!r} are not supported; save the mesh without them")
        dtype = np.dtype(TYPES[type_name.lower()])
        if self.is_binary:
            taken = self.data[self.position : self.position + count * dtype.itemsize]
            self.position += len(taken)
            return np.frombuffer(taken, dtype.newbyteorder(">"), count=count).astype(dtype)
        words: list[str] = []
        while len(words) < count and self.position < len(self.data):
            words += self.line().split()
        if len(words) != count:
            raise MeshError(f"{count} numbers are announced and {len(words)} found: the file is truncated or corrupt")
        convert = float if dtype.kind == "f" else int
        return np.array([convert(word) for word in words], dtype=np.float64 if dtype.kind == "f" else dtype)


class LegacyGrid:
    """What has been read so far; one method for each kind of section."""

    def __init__(self, text: LegacyText) -> None:
        """Start with nothing."""
        self.text = text
        self.points = np.zeros((0, 3))
        self.connectivity = self.ends = self.types = np.zeros(0, dtype=np.int64)
        self.point_data: dict[str, Array] = {}
        self.cell_data: dict[str, Array] = {}
        self.fields: dict[str, Array] = {}
        self.length = 0

    def read_section(self, words: list[str]) -> None:
        """Read the section that starts with these words."""
        keyword, arguments = words[0].upper(), words[1:]
        if keyword == "POINTS":
            self.points = self.text.numbers(arguments[1], 3 * int(arguments[0])).reshape(-1, 3)
        elif keyword == "CELLS":
            self._read_cells(int(arguments[0]), int(arguments[1]))
        elif keyword == "CELL_TYPES":
            self.types = self.text.numbers("int", int(arguments[0]))
        elif keyword in ("POINT_DATA", "CELL_DATA"):
            self.fields = self.point_data if keyword == "POINT_DATA" else self.cell_data
            self.length = int(arguments[0])
        elif keyword == "METADATA":
            self.text.skip_paragraph()
        else:
            self._read_attribute(keyword, arguments)

    def _read_cells(self, count: int, size: int) -> None:
        """Read CELLS: rows `n point ...` of the given total size, or since version 5.1 offsets and points apart."""
        start = self.text.position
        words = self.text.words()
        if words[:1] == ["OFFSETS"]:
            self.ends = self.text.numbers(words[1], count)[1:]
            self.connectivity = self.text.numbers(self.text.words()[1], size)
            return
        self.text.position = start
        numbers = self.text.numbers("int", size)
        heads, place = [], 0
        for _ in range(count):
            heads.append(place)
            place += 1 + int(numbers[place])
        if place != size:
            raise MeshError("the cells do not fit their announced size: the file is corrupt")
        self.ends = np.cumsum(numbers[heads])
        self.connectivity = np.delete(numbers, heads)

    def _read_attribute(self, keyword: str, arguments: list[str]) -> None:
        """Read one named array, or a group of them."""
        if keyword == "FIELD":
            for _ in range(int(arguments[1])):
                self._read_field()
        elif keyword == "SCALARS":
            width = int(arguments[2]) if len(arguments) > 2 else 1
            self.text.words()  # LOOKUP_TABLE name
            self._store(arguments[0], self.text.numbers(arguments[1], width * self.length))
        elif keyword in WIDTHS:
            self._store(arguments[0], self.text.numbers(arguments[1], WIDTHS[keyword] * self.length))
        elif keyword == "TEXTURE_COORDINATES":
            self._store(arguments[0], self.text.numbers(arguments[2], int(arguments[1]) * self.length))
        elif keyword in ("COLOR_SCALARS", "LOOKUP_TABLE"):
            # Colours are bytes in a binary file and fractions in a text.
            n_colours = int(arguments[1]) * (self.length if keyword == "COLOR_SCALARS" else 4)
            self.text.numbers("unsigned_char" if self.text.is_binary else "float", n_colours)
        else:
            raise MeshError(f"unknown keyword {keyword[:40]!r}: the file is corrupt")

    def _read_field(self) -> None:
        """Read `name width length type` and its numbers; a paragraph of metadata may stand before it."""
        words = self.text.words()
        while words[:1] == ["METADATA"]:
            self.text.skip_paragraph()
            words = self.text.words()
        name, width, length, type_name = words
        self._store(name, self.text.numbers(type_name, int(width) * int(length)))

    def _store(self, name: str, numbers: Array) -> None:
        """Keep an array; before POINT_DATA or CELL_DATA it belongs to neither and is dropped."""
        if self.length:
            self.fields[unquote(name)] = numbers.reshape(self.length, -1)


def read_vtk(path: pathlib.Path) -> RawMesh:
    """Read a legacy VTK file; arrays called "region:NAME" become regions."""
    data = path.read_bytes()
    if not data.strip():
        raise MeshError("the file is empty")
    text = LegacyText(data)
    words = text.words()
    if [word.upper() for word in words] != ["DATASET", "UNSTRUCTURED_GRID"]:
        raise MeshError(f"it holds {' '.join(words)[:60]!r} and not an unstructured grid")
    grid = LegacyGrid(text)
    while words := text.words():
        grid.read_section(words)
    cells = pick_tetrahedra(grid.connectivity, grid.ends, grid.types)
    cell_regions = {name: mask[cells.is_tetrahedron] for name, mask in regions_in(grid.cell_data).items()}
    return RawMesh(
        grid.points.astype(np.float64),
        cells.tetrahedra,
        cell_regions,
        regions_in(grid.point_data),
        cells.ignored_solids,
    )
