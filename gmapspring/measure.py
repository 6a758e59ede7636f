"""What can be read off a body: energies, momenta, volumes, strains, components. Nothing here changes it.

All sums are float64, whatever the dtype of the body. Arrays over tetrahedra have a row for each tetrahedron of the mesh; a
removed one has volume, ratio and strain 0.
"""

import math

import numpy as np

from gmapspring.body import Body
from gmapspring.jit import kernel
from gmapspring.topology import gmap as topology


def kinetic_energy(body: Body) -> float:
    """Return the kinetic energy [J]: the sum of m v^2 / 2."""
    velocity = body.nodes.velocity.astype(np.float64)
    return 0.5 * float(np.sum(body.nodes.mass * np.sum(velocity**2, axis=1)))


def elastic_energy(body: Body) -> float:
    """Return the elastic energy [J]: the sum of k (l - l0)^2 / 2 over springs."""
    stiffness, rest_length = (np.asarray(a, np.float64) for a in (body.springs.stiffness, body.springs.rest_length))
    return 0.5 * float(np.sum(stiffness * (_edge_lengths(body) - rest_length) ** 2))


def gravitational_energy(body: Body) -> float:
    """Return the potential energy in the body's gravity [J], 0 at the origin: the sum of -m g . x."""
    position = body.nodes.position.astype(np.float64)
    return -float(np.sum(body.nodes.mass[:, None] * position * body.matter.gravity))


def momentum(body: Body) -> np.ndarray:
    """Return the momentum [kg m/s], (3,): the sum of m v."""
    velocity = body.nodes.velocity.astype(np.float64)
    return np.sum(body.nodes.mass[:, None] * velocity, axis=0)


def angular_momentum(body: Body) -> np.ndarray:
    """Return the angular momentum about the origin [kg m^2/s], (3,): the sum of x cross m v."""
    position, velocity = (np.asarray(a, np.float64) for a in (body.nodes.position, body.nodes.velocity))
    return np.sum(np.cross(position, body.nodes.mass[:, None] * velocity), axis=0)


def volumes(body: Body) -> np.ndarray:
    """Return the present volume of each tetrahedron [m^3], negative if inside out, 0 if removed, (n_tets,)."""
    result = np.zeros(body.mesh.n_tetrahedra)
    corners = body.nodes.position.astype(np.float64)[body.vertex_of[body.is_alive]]
    a, b, c = (corners[:, i] - corners[:, 0] for i in (1, 2, 3))
    result[body.is_alive] = np.sum(np.cross(a, b) * c, axis=1) / 6.0
    return result


def volume_ratios(body: Body) -> np.ndarray:
    """Return the present volume of each tetrahedron over its rest volume, 0 if removed, (n_tets,)."""
    return volumes(body) / body.tetrahedra.volume


def edge_strains(body: Body) -> np.ndarray:
    """Return the strain of each spring, l / l0 - 1, (n_springs,)."""
    return _edge_lengths(body) / body.springs.rest_length.astype(np.float64) - 1.0


def tetrahedron_strains(body: Body) -> np.ndarray:
    """Return the largest spring strain of each tetrahedron's six edges, 0 if removed, (n_tets,)."""
    result = np.zeros(body.mesh.n_tetrahedra)
    result[body.is_alive] = np.max(edge_strains(body)[body.edge_of[body.is_alive]], axis=1)
    return result


def components(body: Body) -> np.ndarray:
    """Return the component of each tetrahedron, 0, 1, ... in the order of their lowest tetrahedron, -1 if removed, (n_tets,)."""
    return topology.components(body.gmap)


def _edge_lengths(body: Body) -> np.ndarray:
    """Return the present length of each spring [m], (n_springs,)."""
    ends = body.nodes.position.astype(np.float64)[body.springs.endpoints]
    return np.sqrt(np.sum((ends[:, 1] - ends[:, 0]) ** 2, axis=1))


@kernel
def measure_tetrahedra(vertex_of, edge_of, state, rest_length, rest_volume, strain, ratio):
    """Set strain and ratio (n_tets,) to tetrahedron_strains and volume_ratios: both in one pass, without allocation.

    For loops that measure at every step. Both are NaN where a corner's position is.
    """
    for tetrahedron in range(len(vertex_of)):
        strain[tetrahedron] = 0.0
        ratio[tetrahedron] = 0.0
        if vertex_of[tetrahedron, 0] >= 0:
            volume = signed_volume(vertex_of[tetrahedron], state)
            ratio[tetrahedron] = volume / rest_volume[tetrahedron]
            strain[tetrahedron] = largest_strain(vertex_of[tetrahedron], edge_of[tetrahedron], state, rest_length)


@kernel
def signed_volume(corners, state):
    """Return the volume [m^3] of the tetrahedron on four nodes."""
    a, b, c, d = corners
    ux, uy, uz = difference(state, a, b)
    vx, vy, vz = difference(state, a, c)
    wx, wy, wz = difference(state, a, d)
    return ((uy * vz - uz * vy) * wx + (uz * vx - ux * vz) * wy + (ux * vy - uy * vx) * wz) / 6.0


@kernel
def largest_strain(corners, edges, state, rest_length):
    """Return the largest strain of the six springs of a tetrahedron, edges 01 02 03 12 13 23; NaN if one is NaN."""
    largest = 0.0
    edge = 0
    for i in range(3):
        for j in range(i + 1, 4):
            dx, dy, dz = difference(state, corners[i], corners[j])
            rest = np.float64(rest_length[edges[edge]])
            square = (dx * dx + dy * dy + dz * dz) / (rest * rest)
            # A comparison with NaN is false: NaN is taken over, and then stays.
            if not (square <= largest) and largest == largest:
                largest = square
            edge += 1
    return math.sqrt(largest) - 1.0


@kernel
def difference(state, i, j):
    """Return the vector [m] from node i to node j, in float64."""
    dx = np.float64(state[j, 0]) - np.float64(state[i, 0])
    dy = np.float64(state[j, 1]) - np.float64(state[i, 1])
    dz = np.float64(state[j, 2]) - np.float64(state[i, 2])
    return dx, dy, dz
