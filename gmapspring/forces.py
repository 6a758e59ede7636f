"""What pushes on nodes: external forces, viscosity, springs. It sees arrays of nodes and springs, never the map.

Integrators call `sum_forces` alone, so a new term, or a faster way to add an old one, is a change in this file. A term that the
scene does not name has arrays without rows; it is left out once per call, not once per node or spring. The order of all
additions is fixed, so equal states give equal bits.
"""

import math

from gmapspring.jit import kernel


@kernel
def sum_forces(nodes, springs, n_nodes, n_springs, state, force):
    """Set force (capacity, 4) [N] to all that pushes on the nodes in a state (capacity, 8)."""
    start_forces(nodes, n_nodes, force)
    add_viscous_forces(nodes, n_nodes, state, force)
    add_spring_forces(springs, n_springs, state, force)


@kernel
def start_forces(nodes, n_nodes, force):
    """Set forces to the constant ones, weight and loads, or to zero where the scene names neither."""
    external = nodes.external
    zero = force.dtype.type(0)
    if external.shape[0] > 0:
        for i in range(n_nodes):
            for axis in range(4):
                force[i, axis] = external[i, axis]
    else:
        for i in range(n_nodes):
            for axis in range(4):
                force[i, axis] = zero


@kernel
def add_viscous_forces(nodes, n_nodes, state, force):
    """Add -viscosity * velocity to each node, where the scene names viscosity."""
    viscosity = nodes.viscosity
    if viscosity.shape[0] > 0:
        for i in range(n_nodes):
            for axis in range(3):
                force[i, axis] -= viscosity[i] * state[i, 4 + axis]


@kernel
def add_spring_forces(springs, n_springs, state, force):
    """Add the pull of each spring to its two ends.

    On end i, with d from i to j and dv the velocity of j relative to i:
        (stiffness * (1 - rest_length / length) + damping * (d . dv) / length^2) * d
    """
    if springs.damping.shape[0] > 0:
        add_damped_springs(springs, n_springs, state, force)
    else:
        add_elastic_springs(springs, n_springs, state, force)


@kernel
def add_elastic_springs(springs, n_springs, state, force):
    """Add the pull of springs without damping."""
    endpoints, rest_length, stiffness = springs.endpoints, springs.rest_length, springs.stiffness
    zero = state.dtype.type(0)
    for s in range(n_springs):
        i, j = endpoints[s, 0], endpoints[s, 1]
        dx = state[j, 0] - state[i, 0]
        dy = state[j, 1] - state[i, 1]
        dz = state[j, 2] - state[i, 2]
        square = dx * dx + dy * dy + dz * dz
        # A spring of length zero has no direction to pull along: without the guard, 0 / 0 would spread through the body.
        if square > zero:
            length = math.sqrt(square)
            add_pull(stiffness[s] * (length - rest_length[s]) / length, dx, dy, dz, i, j, force)


@kernel
def add_damped_springs(springs, n_springs, state, force):
    """Add the pull of springs with damping."""
    endpoints, rest_length = springs.endpoints, springs.rest_length
    stiffness, damping = springs.stiffness, springs.damping
    zero = state.dtype.type(0)
    for s in range(n_springs):
        i, j = endpoints[s, 0], endpoints[s, 1]
        dx = state[j, 0] - state[i, 0]
        dy = state[j, 1] - state[i, 1]
        dz = state[j, 2] - state[i, 2]
        du = state[j, 4] - state[i, 4]
        dv = state[j, 5] - state[i, 5]
        dw = state[j, 6] - state[i, 6]
        square = dx * dx + dy * dy + dz * dz
        # See add_elastic_springs.
        if square > zero:
            length = math.sqrt(square)
            # Two quotients side by side are faster than one after the other.
            elastic = stiffness[s] * (length - rest_length[s]) / length
            viscous = damping[s] * (dx * du + dy * dv + dz * dw) / square
            add_pull(elastic + viscous, dx, dy, dz, i, j, force)


@kernel
def add_pull(coefficient, dx, dy, dz, i, j, force):
    """Pull node i towards node j, and j towards i, with a coefficient [N/m] times their difference [m]."""
    fx, fy, fz = coefficient * dx, coefficient * dy, coefficient * dz
    force[i, 0] += fx
    force[i, 1] += fy
    force[i, 2] += fz
    force[j, 0] -= fx
    force[j, 1] -= fy
    force[j, 2] -= fz
