"""The body: a mesh, its map, and its matter.

Everything mechanical is owned by tetrahedra and summed over cells: a node's mass is a quarter of the mass of each tetrahedron
around its vertex, a spring's stiffness is E V / l^2 summed over the tetrahedra round its edge (Van Gelder, "Approximate
simulation of elastic membranes by triangulated spring meshes", 1998).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gmapspring.addresses import address_row, struct_reader
from gmapspring.matter import Matter, Nodes, Springs, Tetrahedra, empty_matter, empty_nodes, empty_springs, no_matter
from gmapspring.mesh import Mesh
from gmapspring.topology import gmap as topology
from gmapspring.topology.build import build_gmap, empty_gmap
from gmapspring.topology.darts import EDGE_CORNERS, OUTWARD_FACE_CORNERS
from gmapspring.topology.gmap import N_EDGES, N_TETRAHEDRA, N_VERTICES, GMap
from gmapspring.topology.room import empty_room


@dataclass(frozen=True)
class Material:
    """What the body is made of; each value is one number or one per tetrahedron."""

    young_modulus: float | Sequence[float] | np.ndarray
    """Young's modulus [Pa]."""
    density: float | Sequence[float] | np.ndarray
    """Density [kg/m^3]."""
    damping: float | Sequence[float] | np.ndarray = 0.0
    """Spring damping in proportion to stiffness [s]."""
    viscosity: float | Sequence[float] | np.ndarray = 0.0
    """Drag in proportion to mass [1/s]."""

    def per_tetrahedron(self, name: str, n_tetrahedra: int) -> np.ndarray:
        """Return one value for each tetrahedron, float64 (n_tetrahedra,); raise ValueError for one that cannot be."""
        value = np.asarray(getattr(self, name), dtype=np.float64)
        if value.shape not in ((), (n_tetrahedra,)):
            raise ValueError(f"material.{name} has shape {value.shape}; give one number or {n_tetrahedra}, one per tetrahedron")
        value = np.broadcast_to(value, (n_tetrahedra,))
        lowest = 0.0 if name != "density" else np.nextafter(0.0, 1.0)
        bad = np.flatnonzero(~(np.isfinite(value) & (value >= lowest)))
        if len(bad):
            sign = "positive" if name == "density" else "zero or positive"
            raise ValueError(f"material.{name} of tetrahedron {bad[0]} is {value[bad[0]]}; it must be finite and {sign}")
        return np.ascontiguousarray(value)


class BodyArrays(NamedTuple):
    """All arrays of a body, as kernels find them; matter first, so that what reads matter reads a row of these too."""

    matter: Matter
    gmap: GMap
    room: np.ndarray
    """Scratch of cuts, int64; see topology/room.py."""


read_body = struct_reader(lambda dtype: BodyArrays(no_matter(dtype), empty_gmap(0), empty_room()))
"""read_body(table, row, real) -> BodyArrays, for kernels; see addresses.py."""


class Body:
    """A cut or whole body: the mesh it came from, its map, and its mechanics."""

    def __init__(self, mesh: Mesh, material: Material, gmap: GMap, matter: Matter):
        self.mesh = mesh
        self.material = material
        self.gmap = gmap
        self.room = empty_room()
        self.matter = matter

    @property
    def matter(self) -> Matter:
        """All mechanics."""
        return self._matter

    @matter.setter
    def matter(self, matter: Matter) -> None:
        self._matter = matter
        self.table = address_row(BodyArrays(matter, self.gmap, self.room))[None]
        """Where kernels find the arrays, one row; see addresses.py."""
        self.real = matter.nodes.state.dtype.type(0)
        """A number of the body's precision."""

    def __getstate__(self) -> dict:
        """Return what a copy is made from: addresses hold for this body alone."""
        kept = {name: value for name, value in self.__dict__.items() if name not in ("table", "_matter")}
        return kept | {"matter": self.matter}

    def __setstate__(self, state: dict) -> None:
        """Take over copied arrays, which lie elsewhere; they share counts as before."""
        matter = state.pop("matter")
        self.__dict__.update(state)
        self.matter = matter._replace(counts=self.gmap.counts)

    @property
    def node_rows(self) -> Nodes:
        """Nodes with their spare rows, as kernels take them."""
        return self.matter.nodes

    @property
    def spring_rows(self) -> Springs:
        """Springs with their spare rows, as kernels take them."""
        return self.matter.springs

    @property
    def tetrahedra(self) -> Tetrahedra:
        """What each tetrahedron of the mesh owns; rows of removed ones stay."""
        return self.matter.tetrahedra

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return int(self.gmap.counts[N_VERTICES])

    @property
    def n_springs(self) -> int:
        """Number of springs."""
        return int(self.gmap.counts[N_EDGES])

    @property
    def n_tetrahedra(self) -> int:
        """Number of tetrahedra that are not removed."""
        return int(self.gmap.counts[N_TETRAHEDRA])

    @property
    def nodes(self) -> Nodes:
        """The live nodes, as views."""
        return Nodes(*(rows[: self.n_nodes] for rows in self.matter.nodes))

    @property
    def springs(self) -> Springs:
        """The live springs, as views."""
        return Springs(*(rows[: self.n_springs] for rows in self.matter.springs))

    @property
    def vertex_of(self) -> np.ndarray:
        """Node of each corner, column i for column i of mesh.tetrahedra, -1 where removed, (n_tets, 4)."""
        return self.gmap.vertex_of

    @property
    def edge_of(self) -> np.ndarray:
        """Spring of edges 01 02 03 12 13 23, -1 where removed, (n_tets, 6)."""
        return self.gmap.edge_of

    @property
    def face_of(self) -> np.ndarray:
        """Face opposite each corner, -1 where removed, (n_tets, 4); see gmap.face_of."""
        return topology.face_of(self.gmap)

    @property
    def is_alive(self) -> np.ndarray:
        """Which tetrahedra are not removed, bool (n_tets,)."""
        return topology.is_alive(self.gmap)

    @property
    def node_of_point(self) -> np.ndarray:
        """The node that continues each mesh point: the one with its lowest dart; -1 where none is left, (n_points,)."""
        nodes = self.nodes
        result = np.full(self.mesh.n_points, -1, dtype=np.int64)
        order = np.argsort(-self.gmap.vertex_dart[: self.n_nodes].astype(np.int64), kind="stable")
        result[nodes.point[order]] = order  # the lowest dart writes last
        return result

    def surface(self) -> np.ndarray:
        """Return the boundary as triangles of nodes, counter-clockwise from outside, (n_triangles, 3)."""
        faces = topology.boundary_faces(self.gmap)
        return self.vertex_of[faces[:, :1], OUTWARD_FACE_CORNERS[faces[:, 1]]]

    def surface_normals(self) -> np.ndarray:
        """Return the outward unit normal of each triangle of surface(), zero where it has no area, (n_triangles, 3)."""
        a, b, c = np.moveaxis(self.nodes.position[self.surface()].astype(np.float64), 1, 0)
        normals = np.cross(b - a, c - a)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0.0)


def build_body(mesh: Mesh, material: Material, pinned: np.ndarray, gravity: np.ndarray, dtype: type, n_work: int = 0) -> Body:
    """Build the body of a mesh at rest; pinned is bool (n_points,), gravity [m/s^2] is (3,).

    n_work: how many states an integrator needs room for.
    """
    gmap = build_gmap(mesh.tetrahedra, mesh.n_points)
    tetrahedra = own_matter(mesh, material)
    n = mesh.n_tetrahedra
    nodes = empty_nodes(4 * n, dtype, bool(gravity.any()), len(tetrahedra.viscosity) > 0)
    springs = empty_springs(6 * n, dtype, len(tetrahedra.damping_modulus) > 0)
    matter = empty_matter(nodes, springs, tetrahedra, n_work)._replace(gravity=gravity, counts=gmap.counts)
    body = Body(mesh, material, gmap, matter)
    live = body.nodes
    live.point[gmap.vertex_of] = mesh.tetrahedra
    live.position[:] = mesh.points[live.point]
    live.is_pinned[:] = pinned[live.point]
    ends = mesh.points[mesh.tetrahedra][:, EDGE_CORNERS]
    body.springs.rest_length[gmap.edge_of] = np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)
    return body


def own_matter(mesh: Mesh, material: Material) -> Tetrahedra:
    """Compute what each tetrahedron owns; a term that is zero everywhere gets no rows."""
    n, volume = mesh.n_tetrahedra, np.array(mesh.volumes)
    modulus = material.per_tetrahedron("young_modulus", n) * volume
    mass = material.per_tetrahedron("density", n) * volume
    damping = material.per_tetrahedron("damping", n)
    viscosity = material.per_tetrahedron("viscosity", n)
    nothing = np.zeros(0)
    return Tetrahedra(
        volume=volume,
        mass=mass,
        modulus=modulus,
        damping_modulus=damping * modulus if damping.any() else nothing,
        viscosity=viscosity * mass if viscosity.any() else nothing,
        load=np.zeros((0, 4, 3)),
    )
