"""Read gmsh's formats 1 (text) and 2 (text and binary): one list of nodes, one of elements with their tags."""

from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.gmsh_parts import Elements, GmshMesh, Numbers, node_count, section

Array = np.ndarray[Any, Any]


def read_format_1(data: bytes) -> GmshMesh:
    """Read $NOD and $ELM; an element is `number kind physical elementary n_nodes nodes`."""
    node_ids, points = _text_nodes(section(data, "NOD", "ENDNOD"))
    rows = []
    for number, kind, physical, _, n_nodes, *nodes in _text_rows(section(data, "ELM", "ENDELM"), 5):
        rows.append((number, kind, physical, nodes))
        if n_nodes != len(nodes):
            raise MeshError(f"element {number} announces {n_nodes} nodes and has {len(nodes)}: the file is corrupt")
    return GmshMesh(node_ids, points, _grouped(rows))


def read_format_2(data: bytes, byte_order: str) -> GmshMesh:
    """Read $Nodes and $Elements; byte_order is "" for text."""
    nodes, elements = section(data, "Nodes"), section(data, "Elements")
    if not byte_order:
        return GmshMesh(*_text_nodes(nodes), _text_elements(elements))
    return GmshMesh(*_binary_nodes(nodes, byte_order), _binary_elements(elements, byte_order))


def _text_nodes(content: bytes) -> tuple[Array, Array]:
    """Return numbers and points of `count`, then rows `number x y z`."""
    numbers = Numbers(content)
    rows = numbers.take("float", 4 * numbers.one("int")).reshape(-1, 4)
    if numbers.position != len(numbers.content) or not (rows[:, 0] == np.floor(rows[:, 0])).all():
        raise MeshError("the rows of nodes are not `number x y z`, or more than announced: the file is corrupt")
    return rows[:, 0].astype(np.int64), rows[:, 1:]


def _text_rows(content: bytes, least: int) -> list[list[int]]:
    """Return the rows of whole numbers of a section that starts with their count; each has at least so many."""
    first, *lines = content.split(b"\n")
    rows = [[int(word) for word in line.split()] for line in lines if line.strip()]
    if int(first) != len(rows):
        raise MeshError(f"a section announces {int(first)} elements and has {len(rows)}: the file is corrupt")
    for place, row in enumerate(rows):
        if len(row) < least:
            raise MeshError(f"row {place} of the elements is too short: the file is corrupt")
    return rows


def _text_elements(content: bytes) -> list[Elements]:
    """Return the elements of rows `number kind n_tags tags nodes`; the first tag is the physical group."""
    rows = []
    for number, kind, n_tags, *rest in _text_rows(content, 3):
        rows.append((number, kind, rest[0] if n_tags > 0 else 0, rest[max(n_tags, 0) :]))
    return _grouped(rows)


def _grouped(rows: list[tuple[int, int, int, list[int]]]) -> list[Elements]:
    """Collect rows (number, kind, physical, nodes) by kind and physical group."""
    groups: dict[tuple[int, int], list[tuple[int, list[int]]]] = {}
    for number, kind, physical, nodes in rows:
        if len(nodes) != node_count(kind):
            raise MeshError(f"element {number} of kind {kind} has {len(nodes)} nodes; it needs {node_count(kind)}")
        groups.setdefault((kind, physical), []).append((number, nodes))
    return [
        Elements(kind, np.array([number for number, _ in group]), np.array([nodes for _, nodes in group]), physical)
        for (kind, physical), group in groups.items()
    ]


def _counted(content: bytes) -> tuple[int, bytes]:
    """Return the count that stands in text before a binary block, and the block."""
    count, _, block = content.partition(b"\n")
    return int(count), block


def _binary_nodes(content: bytes, byte_order: str) -> tuple[Array, Array]:
    """Return numbers and points of binary rows `number x y z`."""
    count, block = _counted(content)
    row = np.dtype([("number", f"{byte_order}i4"), ("point", f"{byte_order}f8", 3)])
    if count * row.itemsize > len(block):
        raise MeshError("section $Nodes ends too early: the file is truncated or its counts are wrong")
    rows = np.frombuffer(block, row, count=count)
    return rows["number"].astype(np.int64), rows["point"].astype(np.float64)


def _binary_elements(content: bytes, byte_order: str) -> list[Elements]:
    """Return the elements of binary blocks `kind count n_tags`, then rows `number tags nodes`."""
    total, block = _counted(content)
    numbers = Numbers(block, byte_order)
    elements, n_read = [], 0
    while n_read < total:
        kind, count, n_tags = numbers.take("int", 3).tolist()
        width = 1 + n_tags + node_count(kind)
        if count < 1 or n_tags < 0:
            raise MeshError("an element block has a count below one: the file is corrupt")
        rows = numbers.take("int", count * width).reshape(count, width)
        groups = rows[:, 1] if n_tags else np.zeros(count, dtype=np.int64)
        for physical in np.unique(groups):
            chosen = rows[groups == physical]
            elements.append(Elements(kind, chosen[:, 0], chosen[:, 1 + n_tags :], int(physical)))
        n_read += count
    return elements
