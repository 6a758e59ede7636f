"""The upkeep of the embedding: after any change of the map, nodes and springs are brought in line with it, here alone.

Sums run over the tetrahedra of a cell in ascending order, never by subtraction: a body that was cut has, to the last bit, the
masses and stiffnesses of one that was built cut.
"""

import numpy as np

from gmapspring.body import read_body
from gmapspring.jit import inlined_part, kernel, part
from gmapspring.quad import load, store
from gmapspring.topology.darts import CORNER_EDGES, EDGE_CORNERS, EDGE_OF_DART
from gmapspring.topology.gmap import N_EDGES, N_VERTICES, SIX, THREE, TWENTY_FOUR, TWO, VERTEX
from gmapspring.topology.walks import code_of_dart, walk_vertex


@part
def sum_node(matter, node, members, start, stop):
    """Sum a node's mass, drag and constant force over its corners, 4*tetrahedron + corner, ascending from start to stop."""
    owned = matter.tetrahedra
    mass, viscosity, x, y, z = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(start, stop):
        mass += 0.25 * owned.mass[np.uint64(members[i]) >> TWO]
    if owned.viscosity.shape[0] > 0:
        for i in range(start, stop):
            viscosity += 0.25 * owned.viscosity[np.uint64(members[i]) >> TWO]
    if owned.load.shape[0] > 0:
        for i in range(start, stop):
            tetrahedron, corner = np.uint64(members[i]) >> TWO, np.uint64(members[i]) & THREE
            x += owned.load[tetrahedron, corner, 0]
            y += owned.load[tetrahedron, corner, 1]
            z += owned.load[tetrahedron, corner, 2]
    set_node(matter, node, mass, viscosity, x, y, z)


@part
def set_node(matter, node, mass, viscosity, x, y, z):
    """Set what a node has of mass [kg], drag [N s/m] and load [N]."""
    nodes, gravity = matter.nodes, matter.gravity
    nodes.mass[node] = mass
    nodes.inverse_mass[node] = 0.0 if nodes.is_pinned[node] else 1.0 / mass
    if nodes.viscosity.shape[0] > 0:
        nodes.viscosity[node] = viscosity
    if nodes.external.shape[0] > 0:
        nodes.external[node, 0] = mass * gravity[0] + x
        nodes.external[node, 1] = mass * gravity[1] + y
        nodes.external[node, 2] = mass * gravity[2] + z


@part
def sum_spring(matter, spring, members, start, stop):
    """Sum a spring's stiffness and damping over the tetrahedra round it, 6*tetrahedron + edge, ascending from start to stop."""
    owned = matter.tetrahedra
    modulus, damping_modulus = 0.0, 0.0
    for i in range(start, stop):
        modulus += owned.modulus[np.uint64(members[i]) // SIX]
    if owned.damping_modulus.shape[0] > 0:
        for i in range(start, stop):
            damping_modulus += owned.damping_modulus[np.uint64(members[i]) // SIX]
    set_spring(matter.springs, spring, modulus, damping_modulus)


@part
def set_spring(springs, spring, modulus, damping_modulus):
    """Set a spring's stiffness [N/m] and damping [N s/m] from sums of modulus [J] and damping modulus [J s]."""
    length = np.float64(springs.rest_length[spring])
    springs.stiffness[spring] = modulus / (length * length)
    if springs.damping.shape[0] > 0:
        springs.damping[spring] = damping_modulus / (length * length)


@part
def join_spring(gmap, springs, spring):
    """Set a spring's end nodes, in the direction of its lowest dart."""
    dart = np.uint64(gmap.edge_dart[spring])
    tetrahedron = dart // TWENTY_FOUR
    edge = np.uint64(EDGE_OF_DART[dart - tetrahedron * TWENTY_FOUR])
    springs.endpoints[spring, 0] = gmap.vertex_of[tetrahedron, np.uint64(EDGE_CORNERS[edge, 0])]
    springs.endpoints[spring, 1] = gmap.vertex_of[tetrahedron, np.uint64(EDGE_CORNERS[edge, 1])]


@part
def join_springs_at(gmap, springs, members, start, stop):
    """Set the end nodes of all springs at a node whose corners stand from start to stop."""
    for i in range(start, stop):
        tetrahedron, corner = np.uint64(members[i]) >> TWO, np.uint64(members[i]) & THREE
        for j in range(3):
            spring = np.uint64(gmap.edge_of[tetrahedron, np.uint64(CORNER_EDGES[corner, j])])
            if np.uint64(gmap.edge_dart[spring]) // TWENTY_FOUR == tetrahedron:  # once for each, which has one lowest dart
                join_spring(gmap, springs, spring)


@part
def copy_node(nodes, source, target):
    """Copy every live value of a node's row."""
    store(nodes.state, target, 0, load(nodes.state, source, 0))
    store(nodes.state, target, 4, load(nodes.state, source, 4))
    nodes.mass[target] = nodes.mass[source]
    nodes.inverse_mass[target] = nodes.inverse_mass[source]
    nodes.is_pinned[target] = nodes.is_pinned[source]
    nodes.point[target] = nodes.point[source]
    if nodes.viscosity.shape[0] > 0:
        nodes.viscosity[target] = nodes.viscosity[source]
    if nodes.external.shape[0] > 0:
        store(nodes.external, target, 0, load(nodes.external, source, 0))


@part
def copy_spring(springs, source, target):
    """Copy every value of a spring's row."""
    springs.endpoints[target, 0] = springs.endpoints[source, 0]
    springs.endpoints[target, 1] = springs.endpoints[source, 1]
    springs.rest_length[target] = springs.rest_length[source]
    springs.stiffness[target] = springs.stiffness[source]
    if springs.damping.shape[0] > 0:
        springs.damping[target] = springs.damping[source]


@part
def merge_nodes(nodes, kept, gone):
    """Give two nodes that become one the mean position and velocity, weighted by mass; a pinned one holds the other.

    Equal values stay as they are to the last bit, so that cutting and sewing at once changes nothing.
    """
    if nodes.is_pinned[gone] and not nodes.is_pinned[kept]:
        for i in range(8):
            nodes.state[kept, i] = nodes.state[gone, i]
    elif not nodes.is_pinned[kept]:
        share = nodes.mass[gone] / (nodes.mass[kept] + nodes.mass[gone])
        for i in range(8):
            nodes.state[kept, i] += share * (nodes.state[gone, i] - nodes.state[kept, i])
    nodes.is_pinned[kept] |= nodes.is_pinned[gone]


@inlined_part
def embed(gmap, matter, vertices, edges):
    """Bring nodes and springs in line with a map that has been settled and compacted.

    New rows copy position, velocity and rest length; rows follow their cells' numbers; sums are made anew;
    springs are joined to the nodes they now end at.
    """
    nodes, springs = matter.nodes, matter.springs
    for i in range(len(vertices.copied)):
        copy_node(nodes, vertices.copied[i, 0], vertices.copied[i, 1])
    for i in range(len(edges.copied)):
        copy_spring(springs, edges.copied[i, 0], edges.copied[i, 1])
    for i in range(len(vertices.moved)):
        copy_node(nodes, vertices.moved[i, 0], vertices.moved[i, 1])
    for i in range(len(edges.moved)):
        copy_spring(springs, edges.moved[i, 0], edges.moved[i, 1])
    start = np.int64(0)
    for i in range(len(edges.changed)):
        sum_spring(matter, edges.changed[i], edges.members, start, edges.ends[i])
        join_spring(gmap, springs, edges.changed[i])
        start = edges.ends[i]
    start = np.int64(0)
    for i in range(len(vertices.changed)):
        sum_node(matter, vertices.changed[i], vertices.members, start, vertices.ends[i])
        if vertices.is_joined[i]:
            join_springs_at(gmap, springs, vertices.members, start, vertices.ends[i])
        start = vertices.ends[i]
    for i in range(len(vertices.moved)):
        code = code_of_dart(VERTEX, np.int64(gmap.vertex_dart[vertices.moved[i, 1]]))
        join_springs_at(gmap, springs, gmap.queue, np.int64(0), walk_vertex(gmap, code >> 2, code & 3, gmap.queue))


@kernel
def embed_all(table, row, real):
    """Sum every node and spring of a body, and join every spring: for one that has just been built."""
    body = read_body(table, row, real)
    matter, gmap = body.matter, body.gmap
    sum_nodes(gmap, matter)
    n_springs = gmap.counts[N_EDGES]
    modulus, damping_modulus = np.zeros(n_springs), np.zeros(n_springs)
    for tetrahedron in range(len(gmap.edge_of)):
        if gmap.component_of[tetrahedron] >= 0:
            for edge in range(6):
                spring = gmap.edge_of[tetrahedron, edge]
                modulus[spring] += matter.tetrahedra.modulus[tetrahedron]
                if matter.tetrahedra.damping_modulus.shape[0] > 0:
                    damping_modulus[spring] += matter.tetrahedra.damping_modulus[tetrahedron]
    for spring in range(n_springs):
        set_spring(matter.springs, spring, modulus[spring], damping_modulus[spring])
        join_spring(gmap, matter.springs, spring)


@part
def sum_nodes(gmap, matter):
    """Sum every node: tetrahedra give their shares in ascending order, as in sum_node."""
    owned, n_nodes = matter.tetrahedra, gmap.counts[N_VERTICES]
    mass, viscosity, load_ = np.zeros(n_nodes), np.zeros(n_nodes), np.zeros((n_nodes, 3))
    for tetrahedron in range(len(gmap.vertex_of)):
        if gmap.component_of[tetrahedron] >= 0:
            for corner in range(4):
                node = gmap.vertex_of[tetrahedron, corner]
                mass[node] += 0.25 * owned.mass[tetrahedron]
                if owned.viscosity.shape[0] > 0:
                    viscosity[node] += 0.25 * owned.viscosity[tetrahedron]
                if owned.load.shape[0] > 0:
                    for i in range(3):
                        load_[node, i] += owned.load[tetrahedron, corner, i]
    for node in range(n_nodes):
        set_node(matter, node, mass[node], viscosity[node], load_[node, 0], load_[node, 1], load_[node, 2])


@kernel
def sum_external(table, row, real):
    """Sum the constant force of every node, with all else: for a body with other loads."""
    body = read_body(table, row, real)
    matter, gmap = body.matter, body.gmap
    sum_nodes(gmap, matter)
