"""Running over all cells of one dimension by darts, both ways the paper describes: for study and for benchmarks.

With marks, every dart is visited and the orbit of each unmarked one is marked; with representatives, one dart of each cell
is kept at hand and nothing else is visited. The physics runs over compact arrays and uses neither.
Source: Meseure, Darles, Skapin, "A Topology-Based Mass/Spring System", CASA 2010, section 3.
"""

import numpy as np

from gmapspring.errors import TopologyError
from gmapspring.jit import kernel
from gmapspring.topology import gmap as topology
from gmapspring.topology.darts import ALPHA
from gmapspring.topology.gmap import N_EDGES, N_VERTICES, GMap, alpha3

ORBIT_OF_CELL = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))
"""The involutions whose orbit is an i-cell: vertex, edge, face, volume."""


def cover_by_marks(gmap: GMap, dimension: int) -> np.ndarray:
    """Return the lowest dart of each live i-cell, ascending, by marking the orbit of one dart after another."""
    involutions = np.zeros(4, dtype=np.bool_)
    involutions[list(ORBIT_OF_CELL[_checked(dimension)])] = True
    return mark_orbits(gmap.image, topology.is_alive(gmap), involutions, ALPHA)


def cover_by_representatives(gmap: GMap, dimension: int) -> np.ndarray:
    """Return one dart of each live i-cell, its lowest, in the order of the cells' numbers."""
    alive = topology.is_alive(gmap)
    if _checked(dimension) == 0:
        return gmap.vertex_dart[: gmap.counts[N_VERTICES]].astype(np.int64)
    if dimension == 1:
        return gmap.edge_dart[: gmap.counts[N_EDGES]].astype(np.int64)
    if dimension == 2:
        return 6 * np.unique(topology.face_of(gmap)[alive]).astype(np.int64)
    return 24 * np.flatnonzero(alive)


def cell_of_darts(gmap: GMap, dimension: int) -> np.ndarray:
    """Return the lowest dart of the i-cell of each dart, -1 where removed, int64 (24 * n_tets,)."""
    involutions = np.zeros(4, dtype=np.bool_)
    involutions[list(ORBIT_OF_CELL[_checked(dimension)])] = True
    result = np.full(24 * len(gmap.image), -1, dtype=np.int64)
    label_orbits(gmap.image, topology.is_alive(gmap), involutions, ALPHA, result)
    return result


def _checked(dimension: int) -> int:
    """Return a dimension from 0 to 3."""
    if dimension not in (0, 1, 2, 3):
        raise TopologyError(f"there are no {dimension}-cells: dimensions are 0 (vertices) to 3 (volumes)")
    return dimension


@kernel
def mark_orbits(image, is_alive, involutions, alpha_tables):
    """Return the first dart of each orbit, ascending."""
    lowest = np.full(24 * len(image), -1, dtype=np.int64)
    n_cells = label_orbits(image, is_alive, involutions, alpha_tables, lowest)
    found = np.empty(n_cells, dtype=np.int64)
    n_found = 0
    for dart in range(len(lowest)):
        if lowest[dart] == dart:
            found[n_found] = dart
            n_found += 1
    return found


@kernel
def label_orbits(image, is_alive, involutions, alpha_tables, lowest):
    """Mark every dart of live tetrahedra with the lowest dart of its orbit; return the number of orbits."""
    waiting = np.empty(24 * len(image), dtype=np.int64)
    n_cells = 0
    for start in range(24 * len(image)):
        if lowest[start] >= 0 or not is_alive[start // 24]:
            continue
        n_cells += 1
        lowest[start] = start
        waiting[0] = start
        n_waiting = 1
        while n_waiting > 0:
            n_waiting -= 1
            dart = waiting[n_waiting]
            for i in range(4):
                if involutions[i]:
                    reached = alpha3(image, dart) if i == 3 else dart // 24 * 24 + alpha_tables[i, dart % 24]
                    if lowest[reached] < 0:
                        lowest[reached] = start
                        waiting[n_waiting] = reached
                        n_waiting += 1
    return n_cells
