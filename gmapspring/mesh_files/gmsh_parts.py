"""What the readers of all gmsh formats share: numbers in text or binary, elements, sections."""

import re
from typing import Any, NamedTuple

import numpy as np

from gmapspring.errors import MeshError

Array = np.ndarray[Any, Any]

TETRAHEDRON = 4
"""gmsh's number for the linear tetrahedron."""

NODE_COUNTS = dict(
    enumerate(
        [2, 3, 4, 4, 8, 6, 5, 3, 6, 9, 10, 27, 18, 14, 1, 8, 20, 15, 13, 9, 10, 12, 15, 15, 21, 4, 5, 6, 20, 35, 56],
        start=1,
    )
)
"""Nodes of each kind of element, by gmsh's number."""

SOLID_NAMES = {5: "hexahedra", 6: "prisms", 7: "pyramids", 11: "second-order tetrahedra", 29: "third-order tetrahedra"}
"""Solids that are not linear tetrahedra and that a user may hope to have read."""

DIMENSIONS = {15: 0, 1: 1, 2: 2, 3: 2, TETRAHEDRON: 3}
"""Dimension of the linear elements."""


class Elements(NamedTuple):
    """Elements of one kind and one physical group; an element in several groups stands in several of these."""

    kind: int
    """gmsh's number for their kind."""

    ids: Array
    """Numbers in the file, int64, shape (n,)."""

    nodes: Array
    """Node numbers in the file, int64, shape (n, nodes of the kind)."""

    physical: int
    """Number of the physical group, 0 for none."""


class GmshMesh(NamedTuple):
    """A gmsh file as it stands: by numbers of the file, not by rows."""

    node_ids: Array
    """Node numbers in the file, int64, shape (n_nodes,)."""

    points: Array
    """Coordinates [m], float64, shape (n_nodes, 3)."""

    elements: list[Elements]
    """All elements."""


class Numbers:
    """A row of numbers in a section of a file, taken from the front; text and binary look the same."""

    def __init__(self, content: bytes, byte_order: str = "", size_bytes: int = 8) -> None:
        """Start at the front of a section; byte_order is "<" or ">" in a binary file, "" in a text."""
        self.types = {"int": f"{byte_order}i4", "size": f"{byte_order}u{size_bytes}", "float": f"{byte_order}f8"}
        self.is_text = not byte_order
        self.content: Any = np.array([float(word) for word in content.split()]) if self.is_text else content
        self.position = 0

    def take(self, kind: str, count: int) -> Array:
        """Return the next numbers, "float" as float64, "int" and "size" as int64; raise when there are too few."""
        item = 1 if self.is_text else np.dtype(self.types[kind]).itemsize
        end = self.position + count * item
        if count < 0 or end > len(self.content):
            raise MeshError("a section ends too early: the file is truncated or its counts are wrong")
        taken = self.content[self.position : end]
        self.position = end
        numbers = taken if self.is_text else np.frombuffer(taken, self.types[kind])
        if kind == "float":
            return np.asarray(numbers, dtype=np.float64)
        if self.is_text and not (numbers == np.floor(numbers)).all():
            raise MeshError("a number that must be whole is not: the file is corrupt")
        return np.asarray(numbers, dtype=np.int64)

    def one(self, kind: str) -> int:
        """Return the next whole number."""
        return int(self.take(kind, 1)[0])


def section(data: bytes, name: str, end: str = "") -> bytes:
    """Return what stands between $name and $end ($Endname unless told)."""
    closing = (end or f"End{name}").encode()
    found = re.search(rb"\$%s[ \t]*\r?\n(.*?)\$%s\b" % (name.encode(), closing), data, re.DOTALL)
    if found is None:
        raise MeshError(f"no complete section ${name}: the file is truncated or not a gmsh mesh")
    return found[1]


def node_count(kind: int) -> int:
    """Return the number of nodes of a kind of element."""
    if kind not in NODE_COUNTS:
        raise MeshError(f"an element is of kind {kind}, which gmsh does not have: the file is corrupt")
    return NODE_COUNTS[kind]
