"""The upkeep of the embedding: after any change of the map, nodes and springs are brought in line with it, here alone.

Sums run over the tetrahedra of a cell in ascending order, never by subtraction: a body that was cut has, to the last bit, the
masses and stiffnesses of one that was built cut.
"""

import numpy as np

from gmapspring.jit import kernel
from gmapspring.topology.darts import CORNER_EDGES, EDGE_CORNERS
from gmapspring.topology.gmap import EDGE, N_EDGES, N_VERTICES, VERTEX
from gmapspring.topology.walks import code_of_dart, sort, walk_edge, walk_vertex


@kernel
def sum_node(gmap, matter, node):
    """Sum a node's mass, drag and constant force over the tetrahedra around it."""
    nodes = matter.nodes
    code = code_of_dart(VERTEX, np.int64(gmap.vertex_dart[node]))
    star = gmap.queue[: walk_vertex(gmap, code >> 2, code & 3, gmap.queue)]
    sort(star)
    mass = 0.0
    viscosity = 0.0
    load = np.zeros(3)
    for member in star:
        tetrahedron = member >> 2
        mass += 0.25 * matter.tetrahedra.mass[tetrahedron]
        if matter.tetrahedra.viscosity.shape[0] > 0:
            viscosity += 0.25 * matter.tetrahedra.viscosity[tetrahedron]
        if matter.tetrahedra.load.shape[0] > 0:
            for i in range(3):
                load[i] += matter.tetrahedra.load[tetrahedron, member & 3, i]
    nodes.mass[node] = mass
    nodes.inverse_mass[node] = 0.0 if nodes.is_pinned[node] else 1.0 / mass
    if nodes.viscosity.shape[0] > 0:
        nodes.viscosity[node] = viscosity
    if nodes.external.shape[0] > 0:
        for i in range(3):
            nodes.external[node, i] = mass * matter.gravity[i] + load[i]


@kernel
def sum_spring(gmap, matter, spring):
    """Sum a spring's stiffness and damping over the tetrahedra round it."""
    springs = matter.springs
    code = code_of_dart(EDGE, np.int64(gmap.edge_dart[spring]))
    ring = gmap.queue[: walk_edge(gmap, code // 6, code % 6, gmap.queue)]
    sort(ring)
    modulus = 0.0
    damping_modulus = 0.0
    for member in ring:
        modulus += matter.tetrahedra.modulus[member // 6]
        if matter.tetrahedra.damping_modulus.shape[0] > 0:
            damping_modulus += matter.tetrahedra.damping_modulus[member // 6]
    length = np.float64(springs.rest_length[spring])
    springs.stiffness[spring] = modulus / (length * length)
    if springs.damping.shape[0] > 0:
        springs.damping[spring] = damping_modulus / (length * length)


@kernel
def join_spring(gmap, matter, spring):
    """Set a spring's end nodes, in the direction of its lowest dart."""
    code = code_of_dart(EDGE, np.int64(gmap.edge_dart[spring]))
    ends = EDGE_CORNERS[code % 6]
    matter.springs.endpoints[spring, 0] = gmap.vertex_of[code // 6, ends[0]]
    matter.springs.endpoints[spring, 1] = gmap.vertex_of[code // 6, ends[1]]


@kernel
def join_springs_at(gmap, matter, node):
    """Set the end nodes of all springs at a node."""
    code = code_of_dart(VERTEX, np.int64(gmap.vertex_dart[node]))
    for member in gmap.queue[: walk_vertex(gmap, code >> 2, code & 3, gmap.queue)]:
        for edge in CORNER_EDGES[member & 3]:
            join_spring(gmap, matter, gmap.edge_of[member >> 2, edge])


@kernel
def copy_node(nodes, source, target):
    """Copy every live value of a node's row."""
    for i in range(8):
        nodes.state[target, i] = nodes.state[source, i]
    nodes.mass[target] = nodes.mass[source]
    nodes.inverse_mass[target] = nodes.inverse_mass[source]
    nodes.is_pinned[target] = nodes.is_pinned[source]
    nodes.point[target] = nodes.point[source]
    if nodes.viscosity.shape[0] > 0:
        nodes.viscosity[target] = nodes.viscosity[source]
    if nodes.external.shape[0] > 0:
        for i in range(4):
            nodes.external[target, i] = nodes.external[source, i]


@kernel
def copy_spring(springs, source, target):
    """Copy every value of a spring's row."""
    springs.endpoints[target, 0] = springs.endpoints[source, 0]
    springs.endpoints[target, 1] = springs.endpoints[source, 1]
    springs.rest_length[target] = springs.rest_length[source]
    springs.stiffness[target] = springs.stiffness[source]
    if springs.damping.shape[0] > 0:
        springs.damping[target] = springs.damping[source]


@kernel
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


@kernel
def embed(gmap, matter, vertices, edges):
    """Bring nodes and springs in line with a map that has been settled and compacted.

    New rows copy position, velocity and rest length; sums are made anew; rows follow their cells' numbers;
    springs are joined to the nodes they now end at.
    """
    for i in range(len(vertices.copied)):
        copy_node(matter.nodes, vertices.copied[i, 0], vertices.copied[i, 1])
    for i in range(len(edges.copied)):
        copy_spring(matter.springs, edges.copied[i, 0], edges.copied[i, 1])
    for i in range(len(vertices.moved)):
        copy_node(matter.nodes, vertices.moved[i, 0], vertices.moved[i, 1])
    for i in range(len(edges.moved)):
        copy_spring(matter.springs, edges.moved[i, 0], edges.moved[i, 1])
    for node in vertices.changed:
        sum_node(gmap, matter, node)
    for spring in edges.changed:
        sum_spring(gmap, matter, spring)
        join_spring(gmap, matter, spring)
    for node in vertices.joined:
        join_springs_at(gmap, matter, node)


@kernel
def embed_all(gmap, matter):
    """Sum every node and spring, and join every spring: for a body just built, or with other loads."""
    for node in range(gmap.counts[N_VERTICES]):
        sum_node(gmap, matter, node)
    for spring in range(gmap.counts[N_EDGES]):
        sum_spring(gmap, matter, spring)
        join_spring(gmap, matter, spring)


@kernel
def sum_external(gmap, matter):
    """Sum the constant force of every node: all that changes with the loads. Runs over tetrahedra, in the order of sum_node."""
    nodes = matter.nodes
    n_nodes = gmap.counts[N_VERTICES]
    load = np.zeros((n_nodes, 3))
    if matter.tetrahedra.load.shape[0] > 0:
        for tetrahedron in range(len(gmap.vertex_of)):
            if gmap.component_of[tetrahedron] >= 0:
                for corner in range(4):
                    for i in range(3):
                        load[gmap.vertex_of[tetrahedron, corner], i] += matter.tetrahedra.load[tetrahedron, corner, i]
    for node in range(n_nodes):
        for i in range(3):
            nodes.external[node, i] = nodes.mass[node] * matter.gravity[i] + load[node, i]
