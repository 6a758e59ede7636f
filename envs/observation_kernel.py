"""The inner loops that write an observation."""

from typing import Any, NamedTuple

import numpy as np

from gmapspring.jit import kernel

Array = np.ndarray[Any, Any]


class Constants(NamedTuple):
    """What never changes while a scene is played, in the units of the observation."""

    rest_position: Array
    """Of each mesh point / h, shape (n_points, 3)."""
    is_target: Array
    """bool (n_tetrahedra,)."""
    is_anchor: Array
    """bool (n_tetrahedra,)."""
    stiffness: Array
    """log(E / E0), shape (n_tetrahedra,)."""
    tetrahedron_mass: Array
    """[kg], shape (n_tetrahedra,)."""
    volume: Array
    """6 V / h^3, shape (n_tetrahedra,)."""
    area: Array
    """Of each interior face / h^2, shape (n_faces,)."""
    centroid: Array
    """Of each interior face / h, shape (n_faces, 3)."""
    load: Array
    """Direction of the load, 0 without one, and its size / (E0 h^2), shape (4,)."""
    length: float
    """What turns metres into h."""
    velocity: float
    """What turns m/s into h per time between two cuts."""
    mass: float
    """What turns kilograms into mean node masses."""
    strain: float
    """What turns strain into parts of the limit."""
    largest: float
    """Largest size of any value."""


class Observation(NamedTuple):
    """Arrays of one observation, in the order of its space; see `envs.observation` for their columns."""

    nodes: Array
    faces: Array
    face_tetrahedra: Array
    face_nodes: Array
    tetrahedra: Array
    tetrahedron_nodes: Array
    tetrahedron_neighbours: Array
    components: Array
    globals: Array
    action_mask: Array


@kernel
def fill_observation(
    table, gmap, nodes, constants, strain, volume_ratio, is_attached, label_of, row_of_node, out
):
    """Write all parts but the mask, of which the globals are there already and only held within bounds.

    Args:
        table: `ActionTable` of the mesh.
        gmap: the map.
        nodes: `Nodes` of the body.
        constants: `Constants` of the scene.
        strain: largest edge strain of each tetrahedron, shape (n_tetrahedra,).
        volume_ratio: volume / rest volume, shape (n_tetrahedra,).
        is_attached: bool (n_tetrahedra,).
        label_of: component of each tetrahedron, int32 (n_tetrahedra,).
        row_of_node: scratch, int32 (4 n_tetrahedra,).
        out: `Observation` to write.
    """
    _fill_tetrahedra(table, gmap, constants, strain, volume_ratio, is_attached, label_of, out)
    _fill_nodes(gmap, nodes, constants, is_attached, row_of_node, out)
    _fill_faces(table, gmap, constants, is_attached, out)
    for place in range(out.globals.shape[0]):
        out.globals[place] = _held(out.globals[place], constants.largest)


@kernel
def _fill_tetrahedra(table, gmap, constants, strain, volume_ratio, is_attached, label_of, out):
    """Write the tables of tetrahedra, but not their nodes."""
    rows, largest = out.tetrahedra, constants.largest
    rows[:] = 0.0
    for tet in range(is_attached.shape[0]):
        out.components[tet] = label_of[tet]
        n_free, n_cut = 0, 0
        for face in range(4):
            slot = gmap.image[tet, face] // 6
            is_free = slot == 4 * tet + face
            out.tetrahedron_neighbours[tet, face] = -1.0 if is_free else slot // 4
            n_free += is_free
            n_cut += is_free and table.face_of_slot[tet, face] >= 0
        if is_attached[tet]:
            rows[tet, 0] = rows[tet, 1] = 1.0
            rows[tet, 2] = constants.is_target[tet]
            rows[tet, 3] = constants.is_anchor[tet]
            rows[tet, 4] = _held(strain[tet] * constants.strain, largest)
            rows[tet, 5] = _held(volume_ratio[tet], largest)
            rows[tet, 6] = constants.stiffness[tet]
            rows[tet, 7] = constants.volume[tet]
            rows[tet, 8] = 0.25 * n_free
            rows[tet, 9] = 0.25 * n_cut


@kernel
def _fill_nodes(gmap, nodes, constants, is_attached, row_of_node, out):
    """Write the table of nodes and the nodes of each tetrahedron."""
    rows = out.nodes
    rows[:] = 0.0
    row_of_node[:] = -1
    for tet in range(is_attached.shape[0]):
        for corner in range(4):
            if not is_attached[tet]:
                out.tetrahedron_nodes[tet, corner] = -1.0
                continue
            node = gmap.vertex_of[tet, corner]
            if row_of_node[node] < 0:
                row_of_node[node] = 4 * tet + corner
                _start_node(nodes, node, constants, rows, 4 * tet + corner)
            row = row_of_node[node]
            out.tetrahedron_nodes[tet, corner] = row
            # Shares of the node's mass, as they are summed.
            share = 0.25 * constants.tetrahedron_mass[tet] / nodes.mass[node]
            if constants.is_target[tet]:
                rows[row, 12] = min(rows[row, 12] + share, 1.0)
            rows[row, 13] = max(rows[row, 13], out.tetrahedra[tet, 4])
            rows[row, 14] += share * constants.stiffness[tet]


@kernel
def _start_node(nodes, node, constants, rows, row):
    """Write the row of a node: all but what its tetrahedra add."""
    largest, point = constants.largest, nodes.point[node]
    rows[row, 0] = 1.0
    for axis in range(3):
        position = nodes.state[node, axis] * constants.length
        rows[row, 1 + axis] = _held(position, largest)
        rows[row, 4 + axis] = _held(position - constants.rest_position[point, axis], largest)
        rows[row, 7 + axis] = _held(nodes.state[node, 4 + axis] * constants.velocity, largest)
    rows[row, 10] = nodes.is_pinned[node]
    rows[row, 11] = nodes.mass[node] * constants.mass
    rows[row, 13] = -largest


@kernel
def _fill_faces(table, gmap, constants, is_attached, out):
    """Write the tables of faces."""
    rows = out.faces
    for face in range(table.face_slots.shape[0]):
        for side in range(2):
            tet = table.face_slots[face, side] // 4
            out.face_tetrahedra[face, side] = tet
            for corner in range(3):
                # A tetrahedron that is gone has no nodes: -1 is copied.
                place = table.face_corners[face, side, corner]
                out.face_nodes[face, 3 * side + corner] = out.tetrahedron_nodes[tet, place]
        slot = table.face_slots[face, 0]
        is_sewn = is_attached[slot // 4] and gmap.image[slot // 4, slot % 4] // 6 != slot
        rows[face, 0] = is_sewn
        rows[face, 1] = constants.area[face] if is_sewn else 0.0
        for axis in range(3):
            rows[face, 2 + axis] = constants.centroid[face, axis] if is_sewn else 0.0


@kernel
def _held(value, largest):
    """Return a value held within plus or minus the largest; what is not a number becomes 0."""
    if value != value:
        return 0.0
    return min(max(value, -largest), largest)
