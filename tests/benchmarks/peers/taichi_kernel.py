"""Taichi: one serial kernel that takes all steps."""

import numpy as np
import taichi as ti

from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.timing import Stepper


def prepare(case: Case, model: IndexedModel) -> Stepper:
    """Return the body in Taichi, float64, compiled for the CPU and one thread."""
    ti.init(arch=ti.cpu, default_fp=ti.f64, cpu_max_num_threads=1, log_level=ti.ERROR, offline_cache=False)
    n, m = model.position.shape[0], len(model.endpoints)
    position, velocity, there, speed, moved, gained, force, gravity = (ti.Vector.field(3, ti.f64, n) for _ in range(8))
    inverse_mass = ti.field(ti.f64, n)
    ends = ti.Vector.field(2, ti.i32, m)
    stiffness, tension, damping = (ti.field(ti.f64, m) for _ in range(3))
    gravity.from_numpy(model.gravity)
    inverse_mass.from_numpy(model.inverse_mass)
    ends.from_numpy(model.endpoints.astype(np.int32))
    stiffness.from_numpy(model.stiffness)
    tension.from_numpy(model.stiffness * model.rest_length)
    damping.from_numpy(model.damping)
    drag, step = float(model.drag), float(case.step)

    @ti.kernel
    def run(n_steps: ti.i32):
        ti.loop_config(serialize=True)
        for t in range(4 * n_steps):
            stage = t % 4
            for s in range(m):
                i, j = ends[s][0], ends[s][1]
                d, dv = position[j] - position[i], velocity[j] - velocity[i]
                if stage > 0:
                    d, dv = there[j] - there[i], speed[j] - speed[i]
                inverse = 1.0 / ti.sqrt(d.dot(d))
                pull = (stiffness[s] - tension[s] * inverse + damping[s] * d.dot(dv) * inverse * inverse) * d
                # Written out, since += is an atomic operation.
                force[i] = force[i] + pull
                force[j] = force[j] - pull
            weight = step / 6.0 if stage == 0 or stage == 3 else step / 3.0
            reach = step / 2.0 if stage < 2 else step
            for i in range(n):
                slope = velocity[i]
                if stage > 0:
                    slope = speed[i]
                acceleration = inverse_mass[i] * force[i] + gravity[i] - drag * slope
                force[i] = ti.Vector([0.0, 0.0, 0.0])
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

    def restart() -> None:
        position.from_numpy(model.position)
        velocity.fill(0.0)
        force.fill(0.0)

    return Stepper(restart, lambda n_steps: run(n_steps), position.to_numpy)
