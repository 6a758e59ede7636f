"""Where a body must be at the end of a motion: our RK4 with a step that no longer matters, and SciPy with forces by NumPy."""

from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from gmapspring import Simulation, measure
from gmapspring.body import Body
from gmapspring.stability import element_frequency
from gmapspring.topology.darts import EDGE_CORNERS
from tests.benchmarks.studies.precision_scenes import Scene, size_of
from tests.naive_mechanics import acceleration

CONVERGED = 1e-10
"""A step is short enough where twice of it changes no error by more."""
MAX_HALVINGS = 12
CHECKED_RADIANS = 600.0
"""SciPy follows a motion through so many radians of its fastest element, since its steps cost a hundred of ours."""
RELATIVE, ABSOLUTE = 1e-11, 1e-13
"""Tolerances of SciPy; the second in [m] and [m/s]."""


class Errors(NamedTuple):
    """How far a body is from where it should be."""

    position: float
    """Root of the mean square distance of nodes, over the size of the body."""
    strain: float
    """Largest difference of a spring's strain."""

    @property
    def worst(self) -> float:
        """Return the larger one; NaN if one is."""
        return float(np.maximum(self.position, self.strain))


class Motion(NamedTuple):
    """Where a body is."""

    position: np.ndarray
    """Of its nodes [m], float64 (n_nodes, 3)."""
    strain: np.ndarray
    """Of its springs, (n_springs,)."""
    size: float
    """Of the body [m]."""

    def errors(self, reference: "Motion") -> Errors:
        """Return how far this is from a reference."""
        distance = np.linalg.norm(self.position - reference.position, axis=1)
        position = np.sqrt(np.mean(distance**2)) / reference.size
        return Errors(float(position), float(np.max(np.abs(self.strain - reference.strain))))


class Reference(NamedTuple):
    """The end of a scene, and why it can be trusted."""

    end: Motion
    step: float
    """Step of RK4 [s]."""
    change: float
    """How far the end is with twice that step."""
    checked_seconds: float
    """How long SciPy followed the motion [s]."""
    checked: float
    """How far it then was from RK4 with this step."""
    travel: float
    """Root of the mean square distance that nodes have come, over the size of the body."""
    largest_strain: float
    """At the end."""


def motion_of(body: Body, position: np.ndarray | None = None) -> Motion:
    """Return where a body is, or its springs would be with other positions (n_nodes, 3)."""
    if position is None:
        position = body.nodes.position.astype(np.float64)
        return Motion(position, measure.edge_strains(body), size_of(body.mesh))
    system = naive_system(body)
    ends = position[system["endpoints"]]
    strain = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / system["rest_length"] - 1.0
    return Motion(position, strain, size_of(body.mesh))


def refer(scene: Scene) -> Reference:
    """Return the end of a scene."""
    simulation = scene.build("rk4", np.float64)
    start = simulation.save_state()
    begin = motion_of(simulation.body)

    def follow(seconds: float, step: float) -> Motion:
        simulation.load_state(start)
        simulation.advance(seconds, step)
        return motion_of(simulation.body)

    step, end = simulation.stable_step, follow(scene.seconds, simulation.stable_step)
    for _ in range(MAX_HALVINGS):
        step, twice = step / 2, end
        end = follow(scene.seconds, step)
        change = twice.errors(end).worst
        if change <= CONVERGED:
            break
    seconds = min(scene.seconds, CHECKED_RADIANS / element_frequency(simulation.body))
    ours = follow(seconds, step)
    simulation.load_state(start)
    checked = ours.errors(motion_of(simulation.body, follow_by_scipy(simulation, seconds))).worst
    return Reference(end, step, change, seconds, checked, end.errors(begin).position, float(np.abs(end.strain).max()))


def follow_by_scipy(simulation: Simulation, seconds: float) -> np.ndarray:
    """Return the positions (n_nodes, 3) after some seconds from the present state, by an eighth-order scheme."""
    system, nodes = naive_system(simulation.body), simulation.body.nodes
    shape = (2, len(nodes.mass), 3)

    def slope(_: float, flat: np.ndarray) -> np.ndarray:
        position, velocity = flat.reshape(shape)
        return np.concatenate([velocity.ravel(), acceleration(system, position, velocity).ravel()])

    start = np.concatenate([nodes.position.ravel(), nodes.velocity.ravel()]).astype(np.float64)
    solution = solve_ivp(slope, (0.0, seconds), start, "DOP853", t_eval=[seconds], rtol=RELATIVE, atol=ABSOLUTE)
    position: np.ndarray = solution.y[:, -1].reshape(shape)[0]
    return position


def naive_system(body: Body) -> dict[str, Any]:
    """Return a body as the naive mechanics takes it, summed anew: of ours it uses who shares which node and spring alone."""
    mesh, alive = body.mesh, body.is_alive
    n_tets, corners, edges = mesh.n_tetrahedra, body.vertex_of[alive], body.edge_of[alive]
    points = mesh.points[mesh.tetrahedra[alive]]
    volume = np.abs(np.linalg.det(points[:, 1:] - points[:, :1])) / 6.0
    modulus, density, damping, viscosity = (
        body.material.per_tetrahedron(name, n_tets)[alive] for name in ("young_modulus", "density", "damping", "viscosity")
    )
    quarter = density * volume / 4.0
    load = quarter[:, None, None] * body.matter.gravity
    if len(body.tetrahedra.load):
        load = load + body.tetrahedra.load[alive]
    sides = points[:, EDGE_CORNERS]
    rest_length, endpoints = np.zeros(body.n_springs), np.zeros((body.n_springs, 2), np.int64)
    rest_length[edges] = np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=2)
    endpoints[edges] = corners[:, EDGE_CORNERS]

    def summed(shares: np.ndarray, cells: np.ndarray, n_cells: int) -> np.ndarray:
        total = np.zeros((n_cells, *shares.shape[2:]))
        np.add.at(total, cells, np.broadcast_to(shares, (*cells.shape, *shares.shape[2:])))
        return total

    n_nodes, n_springs = body.n_nodes, body.n_springs
    return {
        "endpoints": endpoints,
        "rest_length": rest_length,
        "is_pinned": body.nodes.is_pinned,
        "mass": summed(quarter[:, None], corners, n_nodes),
        "viscosity": summed((viscosity * quarter)[:, None], corners, n_nodes),
        "load": summed(load, corners, n_nodes),
        "stiffness": summed((modulus * volume)[:, None], edges, n_springs) / rest_length**2,
        "damping": summed((damping * modulus * volume)[:, None], edges, n_springs) / rest_length**2,
    }
