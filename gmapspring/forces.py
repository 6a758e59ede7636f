"""What pushes on nodes: external forces, viscosity, springs. It sees arrays of nodes and springs, never the map.

    start_force     what acts on one node by itself
    finish_forces   what depends on more than one node, or goes over them once more
    sum_forces      all of it: the first for each node, then the second

Integrators that go over the nodes anyway call the first right after they have moved one, while its rows are at hand: to fetch
them again would take a third of what nodes take. So a new term, which is a change in this file, goes into one of these two.
A term that the scene does not name has arrays without rows, and costs nothing. The order of all additions is fixed, so equal
states give equal bits.
"""

from gmapspring.jit import part
from gmapspring.quad import load, store
from gmapspring.spring_kernel import add_spring_forces


@part
def sum_forces(nodes, springs, n_nodes, n_springs, state, force):
    """Set force (capacity, 4) [N] to all that pushes on the nodes in a state (capacity, 8)."""
    start_forces(nodes, n_nodes, state, force)
    finish_forces(nodes, springs, n_nodes, n_springs, state, force)


@part
def start_forces(nodes, n_nodes, state, force):
    """Set force (capacity, 4) [N] to what acts on nodes by themselves in a state (capacity, 8)."""
    for i in range(n_nodes):
        start_force(nodes, i, state, force)


@part
def start_force(nodes, i, state, force):
    """Set row i of force (capacity, 4) [N] to weight and loads, less viscosity * velocity, where the scene names them."""
    external, viscosity = nodes.external, nodes.viscosity
    number = force.dtype.type
    if viscosity.shape[0] > 0:
        drag = viscosity[i] * load(state, i, 4)
        store(force, i, 0, load(external, i, 0) - drag if external.shape[0] > 0 else number(-1) * drag)
    elif external.shape[0] > 0:
        store(force, i, 0, load(external, i, 0))
    else:
        for axis in range(4):
            force[i, axis] = number(0)


@part
def finish_forces(nodes, springs, n_nodes, n_springs, state, force):
    """Add to force (capacity, 4) [N], started for the same state (capacity, 8), all else that pushes on the nodes."""
    add_spring_forces(springs, n_springs, state, force)
