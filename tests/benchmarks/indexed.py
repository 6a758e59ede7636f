"""The plain indexed model: the mass/spring step as one writes it in numba without topology, on (n, 3) arrays and with fastmath.

It is the yardstick of the rows "ours / plain indexed", and, in float64, the reference that every error is measured against.
"""

import math

import numba
import numpy as np

from tests.benchmarks.bodies import IndexedModel
from tests.benchmarks.timing import Stepper

fast = numba.njit(cache=True, fastmath=True, error_model="numpy", nogil=True, boundscheck=False)


class Work:
    """Arrays of one Runge-Kutta step, each (n_nodes, 3): start, stage, weighted sum, force."""

    def __init__(self, model: IndexedModel):
        """Start at rest."""
        self.position = np.array(model.position)
        self.arrays = (self.position, *(np.zeros_like(self.position) for _ in range(6)))

    def restart(self, model: IndexedModel) -> None:
        """Go back to the start, at rest."""
        for array in self.arrays:
            array[:] = 0
        self.position[:] = model.position


def plain_indexed(model: IndexedModel) -> Stepper:
    """Return the body as a stepper, in the precision of the model."""
    work, scalar = Work(model), model.position.dtype.type
    first, second = (np.ascontiguousarray(model.endpoints[:, end]) for end in (0, 1))
    springs = (first, second, model.stiffness, model.stiffness * model.rest_length, model.damping)
    inverse_mass = np.repeat(model.inverse_mass, 3)
    constants = (inverse_mass, np.ascontiguousarray(model.gravity).reshape(-1), scalar(model.drag))
    run = run_damped if model.is_damped else run_elastic

    def advance(step: float, n_steps: int) -> None:
        run(n_steps, scalar(step), *springs, *constants, *work.arrays)

    return Stepper(restart=lambda: work.restart(model), advance=advance, positions=lambda: work.position)


def with_step(stepper: Stepper, step: float) -> Stepper:
    """Return a stepper whose advance(step, n_steps) is called with a fixed step [s]."""
    return stepper._replace(advance=lambda n_steps: stepper.advance(step, n_steps))


@fast
def add_elastic(first, second, stiffness, tension, position, force):
    """Add the pull of springs without damping; tension is stiffness times rest length [N]."""
    one = stiffness.dtype.type(1)
    for s in range(len(first)):
        i, j = first[s], second[s]
        dx = position[j, 0] - position[i, 0]
        dy = position[j, 1] - position[i, 1]
        dz = position[j, 2] - position[i, 2]
        inverse = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        pull = stiffness[s] - tension[s] * inverse
        force[i, 0] += pull * dx
        force[i, 1] += pull * dy
        force[i, 2] += pull * dz
        force[j, 0] -= pull * dx
        force[j, 1] -= pull * dy
        force[j, 2] -= pull * dz


@fast
def add_damped(first, second, stiffness, tension, damping, position, velocity, force):
    """Add the pull of springs with damping."""
    one = stiffness.dtype.type(1)
    for s in range(len(first)):
        i, j = first[s], second[s]
        dx = position[j, 0] - position[i, 0]
        dy = position[j, 1] - position[i, 1]
        dz = position[j, 2] - position[i, 2]
        du = velocity[j, 0] - velocity[i, 0]
        dv = velocity[j, 1] - velocity[i, 1]
        dw = velocity[j, 2] - velocity[i, 2]
        inverse = one / math.sqrt(dx * dx + dy * dy + dz * dz)
        pull = stiffness[s] - tension[s] * inverse + damping[s] * (dx * du + dy * dv + dz * dw) * inverse * inverse
        force[i, 0] += pull * dx
        force[i, 1] += pull * dy
        force[i, 2] += pull * dz
        force[j, 0] -= pull * dx
        force[j, 1] -= pull * dy
        force[j, 2] -= pull * dz


@fast
def first_stage(half, weight, inverse_mass, gravity, drag, position, velocity, there, speed, moved, gained, force):
    """Start the sums, and go half a step along the slope; all arrays flat, so that the loop becomes vector code."""
    for i in range(len(position)):
        slope = velocity[i]
        acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope
        force[i] = 0
        moved[i] = weight * slope
        gained[i] = weight * acceleration
        there[i] = position[i] + half * slope
        speed[i] = velocity[i] + half * acceleration


@fast
def middle_stage(reach, weight, inverse_mass, gravity, drag, position, velocity, there, speed, moved, gained, force):
    """Add to the sums, and go the reach [s] along the slope."""
    for i in range(len(position)):
        slope = speed[i]
        acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope
        force[i] = 0
        moved[i] += weight * slope
        gained[i] += weight * acceleration
        there[i] = position[i] + reach * slope
        speed[i] = velocity[i] + reach * acceleration


@fast
def last_stage(weight, inverse_mass, gravity, drag, position, velocity, there, speed, moved, gained, force):
    """Set the state to the sums."""
    for i in range(len(position)):
        slope = speed[i]
        acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope
        force[i] = 0
        position[i] += moved[i] + weight * slope
        velocity[i] += gained[i] + weight * acceleration


@fast
def run_damped(n_steps, step, first, second, stiffness, tension, damping, inverse_mass, gravity, drag,
               position, velocity, there, speed, moved, gained, force):
    """Take Runge-Kutta steps of a damped body."""
    scalar = position.dtype.type
    half, third, sixth = scalar(step / 2), scalar(step / 3), scalar(step / 6)
    flat = (position.reshape(-1), velocity.reshape(-1), there.reshape(-1), speed.reshape(-1),
            moved.reshape(-1), gained.reshape(-1), force.reshape(-1))
    for _ in range(n_steps):
        add_damped(first, second, stiffness, tension, damping, position, velocity, force)
        first_stage(half, sixth, inverse_mass, gravity, drag, *flat)
        add_damped(first, second, stiffness, tension, damping, there, speed, force)
        middle_stage(half, third, inverse_mass, gravity, drag, *flat)
        add_damped(first, second, stiffness, tension, damping, there, speed, force)
        middle_stage(step, third, inverse_mass, gravity, drag, *flat)
        add_damped(first, second, stiffness, tension, damping, there, speed, force)
        last_stage(sixth, inverse_mass, gravity, drag, *flat)


@fast
def run_elastic(n_steps, step, first, second, stiffness, tension, _damping, inverse_mass, gravity, drag,
                position, velocity, there, speed, moved, gained, force):
    """Take Runge-Kutta steps of a body whose springs have no damping."""
    scalar = position.dtype.type
    half, third, sixth = scalar(step / 2), scalar(step / 3), scalar(step / 6)
    flat = (position.reshape(-1), velocity.reshape(-1), there.reshape(-1), speed.reshape(-1),
            moved.reshape(-1), gained.reshape(-1), force.reshape(-1))
    for _ in range(n_steps):
        add_elastic(first, second, stiffness, tension, position, force)
        first_stage(half, sixth, inverse_mass, gravity, drag, *flat)
        add_elastic(first, second, stiffness, tension, there, force)
        middle_stage(half, third, inverse_mass, gravity, drag, *flat)
        add_elastic(first, second, stiffness, tension, there, force)
        middle_stage(step, third, inverse_mass, gravity, drag, *flat)
        add_elastic(first, second, stiffness, tension, there, force)
        last_stage(sixth, inverse_mass, gravity, drag, *flat)
