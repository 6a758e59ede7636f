"""Read gmsh's format 4.1 (text and binary): nodes and elements stand in blocks, one for each entity of the model."""

from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.gmsh_parts import Elements, GmshMesh, Numbers, node_count, section

Array = np.ndarray[Any, Any]

Groups = dict[tuple[int, int], list[int]]
"""Physical groups of each entity (dimension, tag)."""


def read_format_4(data: bytes, byte_order: str, size_bytes: int) -> GmshMesh:
    """Read $Entities, $Nodes and $Elements; byte_order is "" for text."""
    groups: Groups = {}
    if b"$Entities" in data:
        groups = _physical_groups(Numbers(section(data, "Entities"), byte_order, size_bytes))
    nodes = Numbers(section(data, "Nodes"), byte_order, size_bytes)
    elements = Numbers(section(data, "Elements"), byte_order, size_bytes)
    return GmshMesh(*_nodes(nodes), _elements(elements, groups))


def _physical_groups(numbers: Numbers) -> Groups:
    """Return the physical groups of all entities: points have a position, others a bounding box and a boundary."""
    counts = numbers.take("size", 4)
    groups: Groups = {}
    for dimension, count in enumerate(counts.tolist()):
        for _ in range(count):
            tag = numbers.one("int")
            numbers.take("float", 3 if dimension == 0 else 6)
            # A negative number only says that the entity is reversed in the group.
            groups[dimension, tag] = np.abs(numbers.take("int", numbers.one("size"))).tolist()
            if dimension > 0:
                numbers.take("int", numbers.one("size"))
    return groups


def _nodes(numbers: Numbers) -> tuple[Array, Array]:
    """Return numbers and points; a block lists its numbers first, then x y z and the parameters, if it has any."""
    n_blocks, n_nodes, _, _ = numbers.take("size", 4).tolist()
    ids, points = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 3))]
    for _ in range(n_blocks):
        dimension, _, is_parametric = numbers.take("int", 3).tolist()
        count = numbers.one("size")
        width = 3 + (dimension if is_parametric else 0)
        ids.append(numbers.take("size", count))
        points.append(numbers.take("float", count * width).reshape(count, width)[:, :3])
    if sum(map(len, ids)) != n_nodes:
        raise MeshError(f"section $Nodes announces {n_nodes} nodes and has {sum(map(len, ids))}: the file is corrupt")
    return np.concatenate(ids), np.concatenate(points)


def _elements(numbers: Numbers, groups: Groups) -> list[Elements]:
    """Return the elements; a block has rows `number nodes`."""
    n_blocks, n_elements, _, _ = numbers.take("size", 4).tolist()
    elements, n_read = [], 0
    for _ in range(n_blocks):
        dimension, tag, kind = numbers.take("int", 3).tolist()
        count, width = numbers.one("size"), 1 + node_count(kind)
        rows = numbers.take("size", count * width).reshape(count, width)
        n_read += count
        for physical in groups.get((dimension, tag), []) or [0]:
            elements.append(Elements(kind, rows[:, 0], rows[:, 1:], physical))
    if n_read != n_elements:
        raise MeshError(f"section $Elements announces {n_elements} elements and has {n_read}: the file is corrupt")
    return elements
