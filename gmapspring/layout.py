"""The order of nodes and springs in memory: numbered anew, so that what is close in the body is close in memory again."""

import numpy as np

from gmapspring.body import Body
from gmapspring.cut import CutReport
from gmapspring.snapshot import changing_arrays, load_arrays, save_arrays
from gmapspring.topology.darts import CORNER_OF_DART, EDGE_OF_DART


def renumber(body: Body) -> CutReport:
    """Number nodes and springs in the order in which tetrahedra meet them; the report lists those that moved.

    Nothing else changes, but forces are then summed in another order, which shows in their last bits. Cuts put what is new at
    the end and fill holes with what was last: in the end, a step of a large body fetches nodes from all over the memory.
    """
    before = save_arrays(body)
    try:
        return _renumber(body)
    except BaseException:
        load_arrays(body, before)
        raise


def _renumber(body: Body) -> CutReport:
    """Number nodes and springs anew, one array after the other."""
    gmap, (_, in_nodes, in_springs) = body.gmap, changing_arrays(body)
    nodes = _order(gmap.vertex_dart[: body.n_nodes], CORNER_OF_DART)
    springs = _order(gmap.edge_dart[: body.n_springs], EDGE_OF_DART)
    _reorder((*in_nodes, gmap.vertex_dart, gmap.link), nodes)
    _reorder((*in_springs, gmap.edge_dart), springs)
    place_of_node, place_of_spring = _places(nodes), _places(springs)
    is_alive = body.is_alive
    gmap.vertex_of[is_alive] = place_of_node[gmap.vertex_of[is_alive]]
    gmap.edge_of[is_alive] = place_of_spring[gmap.edge_of[is_alive]]
    endpoints = body.springs.endpoints[: body.n_springs]
    endpoints[...] = place_of_node[endpoints]
    moved_nodes, moved_springs = _moves(place_of_node), _moves(place_of_spring)
    sizes = (0, 0, 0, 0, moved_nodes.size, moved_springs.size, 0, 0)
    return CutReport(np.concatenate((sizes, moved_nodes.ravel(), moved_springs.ravel())), np.zeros(0, dtype=np.int64))


def _order(darts: np.ndarray, local_of_dart: np.ndarray) -> np.ndarray:
    """Return the old number of the cell for each new one, given the cells' lowest darts, (n,): a cell is met where that lies."""
    return np.argsort(24 * (darts // 24) + local_of_dart[darts % 24])


def _reorder(arrays: tuple[np.ndarray, ...], order: np.ndarray) -> None:
    """Put row order[i] of each array into row i; an array of a term that the scene does not name has no rows."""
    for array in arrays:
        if len(array):
            array[: len(order)] = array[order]


def _places(order: np.ndarray) -> np.ndarray:
    """Return the new number of each old one, (n,)."""
    places = np.empty_like(order)
    places[order] = np.arange(len(order))
    return places


def _moves(places: np.ndarray) -> np.ndarray:
    """Return (from, to) of all that got another number, (k, 2)."""
    numbers = np.arange(len(places))
    return np.stack((numbers, places), axis=1)[places != numbers]
