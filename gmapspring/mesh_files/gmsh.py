"""Read gmsh .msh files: format 1, 2 (text and binary) and 4.1 (text and binary)."""

import pathlib
import re
from typing import Any

import numpy as np

from gmapspring.errors import MeshError
from gmapspring.mesh_files.gmsh_1_and_2 import read_format_1, read_format_2
from gmapspring.mesh_files.gmsh_4 import read_format_4
from gmapspring.mesh_files.gmsh_parts import DIMENSIONS, SOLID_NAMES, TETRAHEDRON, Elements, GmshMesh, section
from gmapspring.mesh_files.raw_mesh import RawMesh

Array = np.ndarray[Any, Any]

Names = dict[tuple[int, int], str]
"""Names of the physical groups (dimension, number)."""


def read_gmsh(path: pathlib.Path) -> RawMesh:
    """Read a gmsh file; its physical groups become regions."""
    data = path.read_bytes()
    if not data:
        raise MeshError("the file is empty")
    if data.lstrip().startswith(b"$NOD"):
        return _assembled(read_format_1(data), {})
    header = section(data, "MeshFormat").split(maxsplit=3)
    if len(header) < 3:
        raise MeshError("section $MeshFormat is incomplete: the file is truncated")
    version, is_binary, size_bytes = header[0].decode(), header[1] == b"1", int(header[2])
    byte_order = ""
    if is_binary:
        byte_order = "<" if header[3][:1] == b"\x01" else ">"
    if version.startswith("2"):
        mesh = read_format_2(data, byte_order)
    elif version == "4.1":
        mesh = read_format_4(data, byte_order, size_bytes)
    else:
        raise MeshError(f"gmsh format {version} is not supported; save it as format 4.1 or 2.2")
    return _assembled(mesh, _physical_names(data))


def _physical_names(data: bytes) -> Names:
    """Return the names of the physical groups: rows `dimension number "name"`."""
    if b"$PhysicalNames" not in data:
        return {}
    rows = re.findall(r'^\s*(\d+)\s+(\d+)\s+"(.*)"\s*$', section(data, "PhysicalNames").decode(), re.MULTILINE)
    return {(int(dimension), int(number)): name for dimension, number, name in rows}


def _assembled(mesh: GmshMesh, names: Names) -> RawMesh:
    """Renumber nodes by rows, and turn physical groups into regions."""
    rows = _node_rows(mesh.node_ids)
    tetrahedra, masks = _tetrahedra(mesh.elements)
    cell_regions = {names.get((3, physical), f"physical_{physical}"): mask for physical, mask in masks.items()}
    point_regions: dict[str, Array] = {}
    numbers_of: dict[str, set[int]] = {}
    for part in mesh.elements:
        name = names.get((DIMENSIONS.get(part.kind, -1), part.physical), "")
        if name and part.kind != TETRAHEDRON:
            mask = point_regions.setdefault(name, np.zeros(len(mesh.points), dtype=bool))
            mask[rows(part.nodes.ravel())] = True
        if part.kind in SOLID_NAMES:
            numbers_of.setdefault(SOLID_NAMES[part.kind], set()).update(part.ids.tolist())
    ignored = {kind: len(numbers) for kind, numbers in numbers_of.items()}
    return RawMesh(mesh.points, rows(tetrahedra), cell_regions, point_regions, ignored)


def _tetrahedra(elements: list[Elements]) -> tuple[Array, dict[int, Array]]:
    """Return the nodes of the tetrahedra, each once, and the mask of each physical group.

    gmsh writes an element once for each group that it is in: the same nodes in two groups are one tetrahedron.
    """
    parts = [part for part in elements if part.kind == TETRAHEDRON]
    nodes = np.concatenate([np.zeros((0, 4), dtype=np.int64), *(part.nodes for part in parts)])
    groups = np.repeat([part.physical for part in parts], [len(part.ids) for part in parts]).astype(np.int64)
    _, first, cell_of = np.unique(np.sort(nodes, axis=1), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    cell_of = np.argsort(order)[cell_of.ravel()]
    numbers, counts = np.unique(np.stack([cell_of, groups], axis=1), axis=0, return_counts=True)
    if (counts > 1).any():
        culprit = nodes[first[order][numbers[np.argmax(counts > 1), 0]]]
        raise MeshError(f"two tetrahedra are on the same nodes {culprit.tolist()}; remove one of them")
    masks = {}
    for physical in np.unique(groups[groups != 0]).tolist():
        masks[physical] = np.zeros(len(first), dtype=bool)
        masks[physical][cell_of[groups == physical]] = True
    return nodes[first[order]], masks


def _node_rows(node_ids: Array) -> Any:
    """Return a function from node numbers to rows; it raises for a number that no node has."""
    order = np.argsort(node_ids, kind="stable")
    ordered = node_ids[order]
    if len(ordered) == 0:
        raise MeshError("the file has no nodes")
    twins = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twins):
        raise MeshError(f"two nodes have the number {ordered[twins[0]]}: the file is corrupt")

    def rows(numbers: Array) -> Array:
        place = np.minimum(np.searchsorted(ordered, numbers), len(ordered) - 1)
        is_missing = ordered[place] != numbers
        if is_missing.any():
            raise MeshError(f"an element refers to node {numbers[is_missing][0]}, which the file does not have")
        return order[place]

    return rows
