"""Warp on the CPU: a kernel over springs with atomic additions, and one over nodes, launched by recorded commands."""

import numpy as np
import warp as wp

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.timing import Stepper


@wp.kernel
def pull_springs(
    ends: wp.array(dtype=wp.vec2i), stiffness: wp.array(dtype=wp.float64), tension: wp.array(dtype=wp.float64),
    damping: wp.array(dtype=wp.float64), position: wp.array(dtype=wp.vec3d), velocity: wp.array(dtype=wp.vec3d),
    force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """Add the pull of each spring to its two nodes."""
    s = wp.tid()
    i = ends[s][0]
    j = ends[s][1]
    d = position[j] - position[i]
    square = wp.dot(d, d)
    amount = stiffness[s] - tension[s] / wp.sqrt(square) + damping[s] * wp.dot(d, velocity[j] - velocity[i]) / square
    pull = amount * d
    wp.atomic_add(force, i, pull)
    wp.atomic_sub(force, j, pull)


@wp.kernel
def move_nodes(
    stage: wp.int32, reach: wp.float64, weight: wp.float64, drag: wp.float64, inverse_mass: wp.array(dtype=wp.float64),
    gravity: wp.array(dtype=wp.vec3d), position: wp.array(dtype=wp.vec3d), velocity: wp.array(dtype=wp.vec3d),
    there: wp.array(dtype=wp.vec3d), speed: wp.array(dtype=wp.vec3d), moved: wp.array(dtype=wp.vec3d),
    gained: wp.array(dtype=wp.vec3d), force: wp.array(dtype=wp.vec3d),
):  # fmt: skip
    """Take each node through one stage."""
    i = wp.tid()
    slope = velocity[i]
    if stage > 0:
        slope = speed[i]
    acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope
    force[i] = wp.vec3d()
    if stage == 0:
        moved[i] = weight * slope
        gained[i] = weight * acceleration
    else:
        moved[i] = moved[i] + weight * slope
        gained[i] = gained[i] + weight * acceleration
    if stage < 3:
        there[i] = position[i] + reach * slope
        speed[i] = velocity[i] + reach * acceleration
    else:
        position[i] = position[i] + moved[i]
        velocity[i] = velocity[i] + gained[i]


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in Warp, float64."""
    wp.config.quiet = True
    wp.init()
    n, m, h = len(model.position), len(model.endpoints), case.step
    start = wp.array(model.position, dtype=wp.vec3d, device="cpu")
    arrays = [wp.zeros(n, dtype=wp.vec3d, device="cpu") for _ in range(7)]
    position, velocity, there, speed, _, _, force = arrays
    springs = [wp.array(model.endpoints.astype(np.int32), dtype=wp.vec2i, device="cpu")]
    springs += [wp.array(values, dtype=wp.float64, device="cpu")
                for values in (model.stiffness, model.stiffness * model.rest_length, model.damping)]  # fmt: skip
    inverse_mass = wp.array(model.inverse_mass, dtype=wp.float64, device="cpu")
    gravity = wp.array(model.gravity, dtype=wp.vec3d, device="cpu")
    commands = []
    for stage, (reach, weight) in enumerate(((h / 2, h / 6), (h / 2, h / 3), (h, h / 3), (0.0, h / 6))):
        at = (there, speed) if stage else (position, velocity)
        settings = [stage, reach, weight, model.drag, inverse_mass, gravity]
        commands.append(wp.launch(pull_springs, m, [*springs, *at, force], device="cpu", record_cmd=True))
        commands.append(wp.launch(move_nodes, n, [*settings, *arrays], device="cpu", record_cmd=True))

    def restart() -> None:
        wp.copy(position, start)
        velocity.zero_()
        force.zero_()

    def advance(n_steps: int) -> None:
        for _ in range(n_steps):
            for command in commands:
                command.launch()

    return Stepper(restart, advance, position.numpy)
