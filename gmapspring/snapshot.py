"""The changing state of a body as array copies: microseconds to take and to put back, topology included."""

from typing import NamedTuple

import numpy as np

from gmapspring.body import Body
from gmapspring.errors import StateFileError
from gmapspring.topology.gmap import STAMP


class Snapshot(NamedTuple):
    """Copies of all arrays that a cut or a step changes; live rows only."""

    gmap: tuple[np.ndarray, ...]
    nodes: tuple[np.ndarray, ...]
    springs: tuple[np.ndarray, ...]
    load: np.ndarray


def changing_arrays(body: Body) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """List the live parts of what changes: of the map, of the nodes, of the springs."""
    gmap, n_nodes, n_springs = body.gmap, body.n_nodes, body.n_springs
    # Stamps only grow: putting an old one back would make old marks look fresh.
    in_map = (gmap.image, gmap.vertex_of, gmap.edge_of, gmap.component_of, gmap.vertex_dart[:n_nodes],
              gmap.edge_dart[:n_springs], gmap.link[:n_nodes])
    nodes, springs = body.node_rows, body.spring_rows
    in_nodes = tuple(rows[:n_nodes] for rows in (nodes.state, nodes.external, nodes.mass, nodes.inverse_mass,
                                                 nodes.viscosity, nodes.is_pinned, nodes.point))
    return in_map, in_nodes, tuple(rows[:n_springs] for rows in (springs.endpoints, springs.rest_length,
                                                                       springs.stiffness, springs.damping))


def save_arrays(body: Body) -> Snapshot:
    """Copy the state of a body."""
    in_map, in_nodes, in_springs = changing_arrays(body)
    return Snapshot(
        gmap=(body.gmap.counts[:STAMP].copy(), *(array.copy() for array in in_map)),
        nodes=tuple(array.copy() for array in in_nodes),
        springs=tuple(array.copy() for array in in_springs),
        load=body.tetrahedra.load.copy(),
    )


def load_arrays(body: Body, snapshot: Snapshot) -> None:
    """Put a state back into the body it was taken from, or into one built alike; raise StateFileError for a foreign one."""
    counts, *in_map = snapshot.gmap
    terms = body.matter
    name_loads(body, snapshot.load, has_external=snapshot.nodes[1].shape[0] > 0)
    before = body.gmap.counts[:STAMP].copy()
    body.gmap.counts[:STAMP] = counts
    targets = changing_arrays(body)
    sources = (tuple(in_map), snapshot.nodes, snapshot.springs)
    pairs = [pair for group in zip(targets, sources, strict=True) for pair in zip(*group, strict=True)]
    if any(target.shape != source.shape or target.dtype != source.dtype for target, source in pairs):
        body.gmap.counts[:STAMP] = before
        body.matter = terms
        raise StateFileError("the state belongs to a body of another size, precision or set of terms; build the same body first")
    for target, source in pairs:
        target[...] = source


def name_loads(body: Body, load: np.ndarray, has_external: bool) -> None:
    """Put corner loads in place, (n_tets, 4, 3) or (0, 4, 3), and make or drop the rows of constant forces; sum nothing."""
    nodes, tetrahedra = body.node_rows, body.tetrahedra
    if (nodes.external.shape[0] > 0) != has_external:
        rows = len(nodes.mass) if has_external else 0
        nodes = nodes._replace(external=np.zeros((rows, 4), nodes.state.dtype))
    if tetrahedra.load.shape != load.shape:
        tetrahedra = tetrahedra._replace(load=np.empty_like(load))
    tetrahedra.load[...] = load
    body.matter = body.matter._replace(nodes=nodes, tetrahedra=tetrahedra)
