"""The simulation itself, let come to rest: what linear theory of our springs is worth."""

import numpy as np

from gmapspring import Material, Simulation
from tests.benchmarks.studies.statics import Problem, body_of, point_volumes, spring_displacement, spring_stiffness

SETTLE_TIME = 40.0
"""Times the inverse of the lowest frequency: critically damped, motion has then shrunk to exp(-40) of it."""


def settled_displacement(problem: Problem, load: float) -> np.ndarray:
    """Return where a simulation comes to rest whose weight is multiplied by load, over load [m], (n_points, 3)."""
    frequency = lowest_frequency(problem)
    material = Material(young_modulus=1.0, density=1.0, viscosity=2.0 * frequency)
    gravity = load * np.array(problem.weight)  # the density is 1
    simulation = Simulation(problem.mesh, material, pinned=problem.is_clamped, gravity=gravity)
    simulation.advance(SETTLE_TIME / frequency)
    nodes = simulation.body.nodes
    displacement = np.empty_like(problem.mesh.points)
    displacement[nodes.point] = nodes.position - problem.mesh.points[nodes.point]
    return displacement / load


def lowest_frequency(problem: Problem) -> float:
    """Return Rayleigh's estimate of the lowest frequency, at unit modulus and density [rad/s], from the shape under load."""
    shape = spring_displacement(problem).ravel()
    stiffness, mass = spring_stiffness(body_of(problem.mesh)), np.repeat(point_volumes(problem.mesh), 3)
    return float(np.sqrt(shape @ (stiffness @ shape) / np.sum(mass * shape**2)))
