"""The bodies that everything is measured on, and the same bodies as an indexed model: arrays without any topology."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from gmapspring import Material, Mesh, Simulation, meshes
from gmapspring.mesh_files import read_mesh
from gmapspring.paths import configs_folder
from tests.benchmarks.timing import Stepper

YOUNG_MODULUS, DENSITY = 5000.0, 1000.0
"""Soft tissue [Pa], [kg/m^3]."""
DAMPING, VISCOSITY = 2e-3, 1.0
"""Spring damping over stiffness [s]; drag over mass [1/s]."""
GRAVITY = (0.0, 0.0, -9.81)
"""[m/s^2]."""
STEP_SHARE = 0.8
"""Part of the stable step that is taken."""
EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
"""Corners of a tetrahedron's edges."""
BOXES = {"2k": (7, 7, 7), "20k": (15, 15, 15), "200k": (33, 32, 32), "1M": (55, 55, 55)}
"""Cubes along each axis; six tetrahedra each."""


class Case(NamedTuple):
    """A mesh, what it is made of, and how it is held."""

    mesh: Mesh
    material: Material
    pinned: np.ndarray
    """bool (n_points,)."""
    gravity: tuple[float, float, float]
    """[m/s^2]."""
    step: float
    """Time step that all contestants take [s]."""

    def simulate(self, dtype: type = np.float64, **arguments: object) -> Simulation:
        """Return our body."""
        named = {"pinned": self.pinned, "gravity": self.gravity, "integrator": "rk4", "dtype": dtype}
        return Simulation(self.mesh, self.material, **(named | arguments))


class IndexedModel(NamedTuple):
    """The body as one writes it without topology; arrays of numbers have the dtype that is timed."""

    position: np.ndarray
    """At the start [m], (n_nodes, 3)."""
    endpoints: np.ndarray
    """The two nodes of each spring, uint32 (n_springs, 2)."""
    stiffness: np.ndarray
    """[N/m], (n_springs,)."""
    rest_length: np.ndarray
    """[m], (n_springs,)."""
    damping: np.ndarray
    """[N s/m], (n_springs,)."""
    inverse_mass: np.ndarray
    """[1/kg], 0 where pinned, (n_nodes,)."""
    gravity: np.ndarray
    """[m/s^2], 0 where pinned, (n_nodes, 3)."""
    drag: float
    """Viscosity over mass [1/s]."""

    @property
    def is_damped(self) -> bool:
        """Tell whether springs have damping."""
        return bool(self.damping.any())

    def typed(self, dtype: type) -> "IndexedModel":
        """Return the model in another precision."""
        whole = self.endpoints
        return IndexedModel(*(field if field is whole else np.asarray(field, dtype) for field in self[:-1]), self.drag)


@lru_cache(maxsize=4)
def mesh_of(size: str) -> Mesh:
    """Return a mesh by its name: "liver", or a key of BOXES."""
    if size == "liver":
        return read_mesh(configs_folder() / "meshes" / "liver.vtu")
    cells = BOXES[size]
    return meshes.box(cells, spacing=0.2 / max(cells))


def make_case(size: str, is_damped: bool = True, gravity: tuple[float, float, float] = GRAVITY) -> Case:
    """Return a named body, held at its anchor or, a box, at its bottom."""
    mesh = mesh_of(size)
    pinned = mesh.points[:, 2] < mesh.points[:, 2].min() + 1e-9
    if size == "liver":
        pinned = np.zeros(mesh.n_points, dtype=bool)
        pinned[mesh.point_regions["anchor"]] = True
    # All contestants take the step of the damped body, so that their times compare.
    damped = Material(YOUNG_MODULUS, DENSITY, DAMPING, VISCOSITY)
    material = damped if is_damped else Material(YOUNG_MODULUS, DENSITY)
    return Case(mesh, material, pinned, gravity, STEP_SHARE * stable_step_of(size))


@lru_cache(maxsize=8)
def stable_step_of(size: str) -> float:
    """Return the stable step of a damped body [s]."""
    return Simulation(mesh_of(size), Material(YOUNG_MODULUS, DENSITY, DAMPING, VISCOSITY)).stable_step


def index(case: Case) -> IndexedModel:
    """Return a case as an indexed model in float64, from the mesh alone: nothing of ours is used."""
    corners, points, material = case.mesh.tetrahedra, case.mesh.points, case.material
    ends = np.sort(corners[:, EDGES].reshape(-1, 2), axis=1)
    edges, spring_of = np.unique(ends, axis=0, return_inverse=True)
    volume = np.abs(np.linalg.det(points[corners[:, 1:]] - points[corners[:, :1]])) / 6.0
    rest_length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    modulus = np.bincount(spring_of.ravel(), np.repeat(material.young_modulus * volume, 6), len(edges))
    mass = np.bincount(corners.ravel(), np.repeat(material.density * volume / 4.0, 4), len(points))
    stiffness = modulus / rest_length**2
    return IndexedModel(
        position=np.array(points),
        endpoints=edges.astype(np.uint32),
        stiffness=stiffness,
        rest_length=rest_length,
        damping=material.damping * stiffness,
        inverse_mass=np.where(case.pinned, 0.0, 1.0 / mass),
        gravity=np.where(case.pinned[:, None], 0.0, case.gravity),
        drag=float(material.viscosity),
    )


def ours(case: Case, dtype: type = np.float64, simulation: Simulation | None = None) -> Stepper:
    """Return our body as a stepper; a simulation of one's own may stand for the freshly built one."""
    simulation = simulation or case.simulate(dtype)
    start, step = simulation.save_state(), case.step
    return Stepper(
        restart=lambda: simulation.load_state(start),
        advance=lambda n_steps: simulation.advance(n_steps * step, step=step),
        positions=lambda: simulation.body.nodes.position[simulation.body.node_of_point],
    )
