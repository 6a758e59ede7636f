"""What pushes on nodes: external forces, viscosity, springs. It sees arrays of nodes and springs, never the map.

Integrators call `sum_forces` alone, so a new term, or a faster way to add an old one, is a change in this file. A term that the
scene does not name has arrays without rows; it is left out once per call, not once per node or spring. The order of all
additions is fixed, so equal states give equal bits.
"""

from gmapspring.jit import part
from gmapspring.quad import load, store
from gmapspring.spring_kernel import add_spring_forces


@part
def sum_forces(nodes, springs, n_nodes, n_springs, state, force):
    """Set force (capacity, 4) [N] to all that pushes on the nodes in a state (capacity, 8)."""
    start_forces(nodes, n_nodes, force)
    add_viscous_forces(nodes, n_nodes, state, force)
    add_spring_forces(springs, n_springs, state, force)


@part
def start_forces(nodes, n_nodes, force):
    """Set forces to the constant ones, weight and loads, or to zero where the scene names neither."""
    external = nodes.external
    zero = force.dtype.type(0)
    if external.shape[0] > 0:
        for i in range(n_nodes):
            store(force, i, 0, load(external, i, 0))
    else:
        for i in range(n_nodes):
            for axis in range(4):
                force[i, axis] = zero


@part
def add_viscous_forces(nodes, n_nodes, state, force):
    """Add -viscosity * velocity to each node, where the scene names viscosity."""
    viscosity = nodes.viscosity
    if viscosity.shape[0] > 0:
        for i in range(n_nodes):
            store(force, i, 0, load(force, i, 0) - viscosity[i] * load(state, i, 4))
