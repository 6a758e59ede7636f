"""The inner loops that write observations, each number once, straight to where they are handed out."""

from typing import Any, NamedTuple

import numpy as np

from envs.arrays import (
    COST,
    HEALTHY_STRAIN,
    HEALTHY_VOLUME,
    LOWEST_RATIO,
    N_COMPONENTS,
    N_STEPS,
    TARGET_STRAIN,
    TARGET_VOLUME,
    read_task,
)
from envs.sight import LARGEST, LENGTH, MASS, STRAIN, VELOCITY
from gmapspring.jit import kernel, part
from gmapspring.topology.gmap import N_VERTICES

Array = np.ndarray[Any, Any]


class Observation(NamedTuple):
    """Arrays of observations, in the order of their space; see `envs.observation` for their columns."""

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
def observe(table, rows, real, places, out):
    """Write what there is to see of rows of a table to places of out, an `Observation` whose arrays have places in front."""
    for k in range(len(rows)):
        task, place = read_task(table, rows[k], real), places[k]
        tetrahedron_nodes = out.tetrahedron_nodes[place]
        show_tetrahedra(task, out.tetrahedra[place], out.tetrahedron_neighbours[place], out.components[place])
        show_nodes(task, tetrahedron_nodes, out.nodes[place])
        show_faces(task, tetrahedron_nodes.reshape(tetrahedron_nodes.size), out.faces[place], out.face_tetrahedra[place],
                   out.face_nodes[place])
        show_globals(task, out.globals[place])
        mask, action_mask = task.play.mask, out.action_mask[place]
        for action in range(len(mask)):
            action_mask[action] = mask[action]


@part
def show_tetrahedra(task, rows, neighbours, components):
    """Write the table of tetrahedra, their neighbours and components."""
    image, face_of_slot, whole = task.body.gmap.image, task.rules.face_of_slot, task.rules.sight.tetrahedra
    is_attached, label_of = task.play.is_attached, task.play.label_of
    strain, volume_ratio, strain_unit = task.play.strain, task.play.volume_ratio, task.rules.sight.units[STRAIN]
    for tet in range(len(is_attached)):
        components[tet] = label_of[tet]
        n_free, n_cut = 0, 0
        for face in range(4):
            dart = image[tet, face]
            is_free = dart == 24 * tet + 6 * face
            neighbours[tet, face] = np.int32(-1) if is_free else np.int32(np.uint32(dart) // np.uint32(24))
            n_free += is_free
            n_cut += is_free and face_of_slot[tet, face] >= 0
        if is_attached[tet]:
            for column in range(11):
                rows[tet, column] = whole[tet, column]
            rows[tet, 4] = held(strain[tet] * strain_unit)
            rows[tet, 5] = held(volume_ratio[tet])
            rows[tet, 8] = 0.25 * n_free
            rows[tet, 9] = 0.25 * n_cut
        else:
            for column in range(11):
                rows[tet, column] = 0.0


@part
def show_nodes(task, tetrahedron_nodes, rows):
    """Write the table of nodes and the nodes of each tetrahedron."""
    numbers = rows.reshape(rows.size)
    for place in range(len(numbers)):
        numbers[place] = 0.0
    sum_shares(task, tetrahedron_nodes)
    row_of_node = task.play.row_of_node
    for node in range(task.body.gmap.counts[N_VERTICES]):
        if row_of_node[node] >= 0:
            show_node(task, node, rows[np.uint64(row_of_node[node])])


@part
def sum_shares(task, tetrahedron_nodes):
    """Set what tetrahedra add to each node, Play.node_sums, and where it is shown: at its lowest corner."""
    sight, is_attached, strain, vertex_of = task.rules.sight, task.play.is_attached, task.play.strain, task.body.gmap.vertex_of
    shares, row_of_node, sums = sight.shares, task.play.row_of_node, task.play.node_sums
    for node in range(task.body.gmap.counts[N_VERTICES]):
        row_of_node[node] = -1
    for tet in range(len(is_attached)):
        if not is_attached[tet]:
            for corner in range(4):
                tetrahedron_nodes[tet, corner] = -1.0
            continue
        target, stiffness, largest = shares[tet, 0], shares[tet, 1], strain[tet]
        for corner in range(4):
            node = np.uint64(vertex_of[tet, corner])
            if row_of_node[node] < 0:
                row_of_node[node] = np.int32(4 * tet + corner)
                sums[node, 0], sums[node, 1], sums[node, 2] = target, stiffness, largest
            else:
                sums[node, 0] += target
                sums[node, 1] += stiffness
                sums[node, 2] = max(sums[node, 2], largest)
            tetrahedron_nodes[tet, corner] = row_of_node[node]


@part
def show_node(task, node, row):
    """Write the row of a node."""
    nodes, sight, sums = task.body.matter.nodes, task.rules.sight, task.play.node_sums
    state, rest_position, units, point = nodes.state, sight.rest_position, sight.units, np.uint64(nodes.point[node])
    mass, length, per_time = nodes.mass[node], units[LENGTH], units[VELOCITY]
    inverse, is_calm = 1.0 / mass, True
    row[0] = 1.0
    for axis in range(3):
        position, velocity = state[node, axis] * length, state[node, 4 + axis] * per_time
        moved = position - rest_position[point, axis]
        row[1 + axis], row[4 + axis], row[7 + axis] = position, moved, velocity
        is_calm &= (abs(position) <= LARGEST) & (abs(moved) <= LARGEST) & (abs(velocity) <= LARGEST)
    if not is_calm:
        for column in range(1, 10):
            row[column] = held(row[column])
    row[10] = nodes.is_pinned[node]
    row[11] = mass * units[MASS]
    row[12] = min(sums[node, 0] * inverse, 1.0)
    row[13] = held(sums[node, 2] * units[STRAIN])
    row[14] = sums[node, 1] * inverse


@part
def show_faces(task, corner_nodes, rows, face_tetrahedra, face_nodes):
    """Write the tables of faces."""
    sight, gmap, is_attached, face_slots = task.rules.sight, task.body.gmap, task.play.is_attached, task.rules.face_slots
    image, faces, sides, corners = gmap.image, sight.faces, sight.face_tetrahedra, sight.face_corners
    for face in range(len(face_slots)):
        face_tetrahedra[face, 0], face_tetrahedra[face, 1] = sides[face, 0], sides[face, 1]
        for corner in range(6):
            # A tetrahedron that is gone has no nodes: -1 is copied.
            face_nodes[face, corner] = corner_nodes[np.uint64(corners[face, corner])]
        slot = np.uint64(face_slots[face, 0])
        tet = slot >> np.uint64(2)
        if is_attached[tet] and np.uint64(image[tet, slot & np.uint64(3)]) != np.uint64(6) * slot:
            for column in range(5):
                rows[face, column] = faces[face, column]
        else:
            for column in range(5):
                rows[face, column] = 0.0


@part
def show_globals(task, row):
    """Write the one row for the whole."""
    numbers, whole, rules = task.play.numbers, task.play.whole, task.rules
    load, start, strain_unit = rules.sight.load, rules.start, rules.sight.units[STRAIN]
    for place in range(4):
        row[place] = held(load[place])
    row[4] = held(numbers[HEALTHY_STRAIN] * strain_unit)
    row[5] = held(numbers[TARGET_STRAIN] * strain_unit)
    row[6] = held(numbers[HEALTHY_VOLUME] / start[0])
    row[7] = held(numbers[TARGET_VOLUME] / start[1])
    row[8] = held(numbers[COST] / 10.0)
    row[9] = held(whole[N_STEPS] / 100.0)
    row[10] = held(numbers[LOWEST_RATIO])
    row[11] = held(whole[N_COMPONENTS] / 10.0)


@part
def held(value):
    """Return a value held within plus or minus the largest; what is not a number becomes 0."""
    number = np.float64(value)
    if abs(number) <= LARGEST:
        return number
    return 0.0 if number != number else min(max(number, -LARGEST), LARGEST)
