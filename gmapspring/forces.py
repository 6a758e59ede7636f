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
    start_forces(nodes, n_nodes, state, force)
    add_spring_forces(springs, n_springs, state, force)


@part
def start_forces(nodes, n_nodes, state, force):
    """Set forces to what acts on nodes by themselves: weight and loads, less viscosity * velocity, where the scene names them."""
    external, viscosity = nodes.external, nodes.viscosity
    number = force.dtype.type
    has_external = external.shape[0] > 0
    if viscosity.shape[0] > 0:
        for i in range(n_nodes):
            drag = viscosity[i] * load(state, i, 4)
            store(force, i, 0, load(external, i, 0) - drag if has_external else number(-1) * drag)
    elif has_external:
        for i in range(n_nodes):
            store(force, i, 0, load(external, i, 0))
    else:
        for i in range(n_nodes):
            for axis in range(4):
                force[i, axis] = number(0)
