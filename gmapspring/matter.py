"""Matter: nodes, springs and what tetrahedra own, in compact arrays; and how kernels find them. It knows no map.

Row i of the nodes is vertex i of the map, row i of the springs is edge i. An array that no term needs has no rows.
"""

import math
from typing import NamedTuple

import numpy as np

from gmapspring.addresses import struct_reader

CACHE_LINE = 64
"""Bytes."""
GROUP = 16
"""The spring kernel takes springs in groups of so many at most: their arrays have room for a whole number of groups."""
BLOCK = 256
"""Springs between the two passes of the spring kernel: few enough that their nodes are still in the nearest cache."""
N_NODES, N_SPRINGS = range(2)
"""Places in Matter.counts."""


class Nodes(NamedTuple):
    """Arrays over nodes; the first n_nodes rows are live. An array that no term needs has no rows."""

    state: np.ndarray
    """Rows [x y z 0 u v w 0]: position [m] and velocity [m/s], shape (capacity, 8)."""
    force: np.ndarray
    """Scratch of the force kernels [N], shape (capacity, 4); between steps springs may be left out."""
    external: np.ndarray
    """Constant force: weight and loads [N], shape (capacity, 4), or (0, 4) where the scene names neither."""
    mass: np.ndarray
    """Mass [kg], float64 (capacity,)."""
    inverse_mass: np.ndarray
    """1 / mass [1/kg], 0 where pinned, (capacity,)."""
    viscosity: np.ndarray
    """Drag coefficient [N s/m], (capacity,) or (0,)."""
    is_pinned: np.ndarray
    """Held in place, bool (capacity,)."""
    point: np.ndarray
    """The mesh point a node stems from, int32 (capacity,)."""

    @property
    def position(self) -> np.ndarray:
        """Positions [m], a writable view, shape (n, 3)."""
        return self.state[:, 0:3]

    @property
    def velocity(self) -> np.ndarray:
        """Velocities [m/s], a writable view, shape (n, 3)."""
        return self.state[:, 4:7]


class Springs(NamedTuple):
    """Arrays over springs; the first n_springs rows are live."""

    endpoints: np.ndarray
    """The two nodes, uint32 (capacity, 2)."""
    rest_length: np.ndarray
    """Length without tension [m], (capacity,)."""
    stiffness: np.ndarray
    """Stiffness [N/m], (capacity,)."""
    damping: np.ndarray
    """Damping along the spring [N s/m], (capacity,) or (0,)."""
    coefficient: np.ndarray
    """Scratch of the spring kernel [N/m], (BLOCK,)."""


class Tetrahedra(NamedTuple):
    """What each tetrahedron of the mesh owns: constants, except for the loads."""

    volume: np.ndarray
    """Volume at rest [m^3], (n,)."""
    mass: np.ndarray
    """Mass [kg], (n,)."""
    modulus: np.ndarray
    """Young's modulus times volume [J], (n,): its share of a spring's stiffness times that spring's rest length squared."""
    damping_modulus: np.ndarray
    """The same for spring damping [J s], (n,) or (0,)."""
    viscosity: np.ndarray
    """Drag coefficient, shared equally by its corners [N s/m], (n,) or (0,)."""
    load: np.ndarray
    """Force on each corner [N], (n, 4, 3) or (0, 4, 3)."""


class Matter(NamedTuple):
    """All mechanics of a body, as the kernels take it."""

    nodes: Nodes
    springs: Springs
    tetrahedra: Tetrahedra
    gravity: np.ndarray
    """Acceleration [m/s^2], (3,)."""
    work: np.ndarray
    """Scratch of the integrator: so many states, one after the other, as it needs, and one more, (n * capacity, 8)."""
    counts: np.ndarray
    """Live nodes and live springs, and what else the map counts, int64 (5,)."""


def empty_nodes(capacity: int, dtype: type, has_external: bool, has_viscosity: bool) -> Nodes:
    """Make node arrays; rows beyond the live ones cost no memory until they are used."""
    return Nodes(
        state=aligned_zeros((capacity, 8), dtype),
        force=aligned_zeros((capacity, 4), dtype),
        external=aligned_zeros((capacity if has_external else 0, 4), dtype),
        mass=np.zeros(capacity),
        inverse_mass=np.zeros(capacity, dtype),
        viscosity=np.zeros(capacity if has_viscosity else 0, dtype),
        is_pinned=np.zeros(capacity, bool),
        point=np.zeros(capacity, np.int32),
    )


def empty_springs(capacity: int, dtype: type, has_damping: bool) -> Springs:
    """Make spring arrays, with room for a whole number of the kernel's groups."""
    capacity = -(-capacity // GROUP) * GROUP
    return Springs(
        endpoints=aligned_zeros((capacity, 2), np.uint32),
        rest_length=aligned_zeros((capacity,), dtype),
        stiffness=aligned_zeros((capacity,), dtype),
        damping=aligned_zeros((capacity if has_damping else 0,), dtype),
        coefficient=aligned_zeros((BLOCK,), dtype),
    )


def empty_matter(nodes: Nodes, springs: Springs, tetrahedra: Tetrahedra, n_work: int) -> Matter:
    """Put matter together, without weight or live rows, with room for n_work states."""
    capacity, dtype = len(nodes.state), nodes.state.dtype.type
    work = aligned_zeros(((n_work + 1) * capacity, 8), dtype)
    return Matter(nodes, springs, tetrahedra, np.zeros(3), work, np.zeros(5, np.int64))


def no_matter(dtype: type) -> Matter:
    """Return matter of no tetrahedra at all: what the types of its arrays are."""
    none = np.zeros(0)
    owned = Tetrahedra(none, none, none, none, none, np.zeros((0, 4, 3)))
    return empty_matter(empty_nodes(0, dtype, True, True), empty_springs(0, dtype, True), owned, 0)


read_matter = struct_reader(no_matter)
"""read_matter(table, row, real) -> Matter, for kernels; see addresses.py."""


def aligned_zeros(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Make an array that starts on a cache line, so that no row of a state lies across two; rows cost no memory until used."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    buffer = np.zeros(size + CACHE_LINE, np.uint8)
    start = -buffer.ctypes.data % CACHE_LINE
    return buffer[start: start + size].view(dtype).reshape(shape)
