"""The paper's own way to step a body: by walking darts. Three ways to run over all cells, one physics.

Each dart is a record with its four involutions; node and spring are found through the dart.
- marks: every dart is visited, and the orbit of each unmarked one is marked, so that each cell is met once;
- flags: one dart of each cell bears a flag, all darts are run over, no orbit is walked;
- list: the flagged darts alone are run over.
Source: Meseure, Darles, Skapin, "A Topology-Based Mass/Spring System", CASA 2010, section 3.
"""

import math
from typing import NamedTuple

import numba
import numpy as np

from gmapspring.topology import gmap as topology
from gmapspring.topology.build import build_gmap
from gmapspring.topology.coverage import cover_by_representatives
from gmapspring.topology.darts import CORNER_OF_DART
from tests.benchmarks.bodies import Case, IndexedModel
from tests.benchmarks.indexed import Work, fast
from tests.benchmarks.timing import Stepper

MARKS, FLAGS, LIST = range(3)
"""Ways to run over all cells."""
WAYS = {"marks": MARKS, "representative darts, flagged": FLAGS, "representative darts, listed": LIST}
"""The ways by the names that the table gives them."""


inlined = numba.njit(inline="always", fastmath=True, error_model="numpy", boundscheck=False)
"""For what is called once per dart: the records of darts are many arrays, which would all be handed over each time."""


class Darts(NamedTuple):
    """All darts, and what each leads to."""

    image: np.ndarray
    """The four involutions of each dart, uint32 (n_darts, 4)."""
    node_of: np.ndarray
    """Node of each dart, uint32 (n_darts,)."""
    spring_of: np.ndarray
    """Spring of each dart, uint32 (n_darts,)."""
    has_node: np.ndarray
    """Whether the dart stands for its vertex, uint8 (n_darts,)."""
    has_spring: np.ndarray
    """Whether the dart stands for its edge, uint8 (n_darts,)."""
    of_node: np.ndarray
    """The darts that stand for vertices, uint32 (n_nodes,)."""
    of_spring: np.ndarray
    """The darts that stand for edges, uint32 (n_springs,)."""
    mark: np.ndarray
    """Scratch, uint8 (n_darts,)."""
    waiting: np.ndarray
    """Scratch, uint32 (n_darts,)."""


def spell_out(case: Case, model: IndexedModel) -> Darts:
    """Return every dart of an uncut body as a record, from the map's public functions."""
    gmap = build_gmap(case.mesh.tetrahedra, case.mesh.n_points)
    darts = np.arange(24 * case.mesh.n_tetrahedra)
    image = np.stack([topology.alpha(gmap, i, darts) for i in range(4)], axis=1).astype(np.uint32)
    node_of = case.mesh.tetrahedra[darts // 24, CORNER_OF_DART[darts % 24]].astype(np.uint32)
    here, other = node_of.astype(np.int64), node_of[image[:, 0]].astype(np.int64)
    # Springs are sorted by their ends, so a dart's spring is found by its two nodes.
    n = case.mesh.n_points
    keys = model.endpoints[:, 0].astype(np.int64) * n + model.endpoints[:, 1]
    spring_of = np.searchsorted(keys, np.minimum(here, other) * n + np.maximum(here, other)).astype(np.uint32)
    stands, flags = [cover_by_representatives(gmap, dimension).astype(np.uint32) for dimension in (0, 1)], []
    for chosen in stands:
        flags.append(np.zeros(len(darts), np.uint8))
        flags[-1][chosen] = 1
    scratch = np.zeros(len(darts), np.uint8), np.zeros(len(darts), np.uint32)
    return Darts(image, node_of, spring_of, *flags, *stands, *scratch)


def walking(darts: Darts, model: IndexedModel, way: int) -> Stepper:
    """Return the body stepped by walking darts; advance takes (step, n_steps)."""
    work = Work(model)
    springs = (model.stiffness, model.stiffness * model.rest_length, model.damping)

    def advance(step: float, n_steps: int) -> None:
        run(n_steps, step, way, darts, *springs, model.inverse_mass, model.gravity, model.drag, *work.arrays)

    return Stepper(restart=lambda: work.restart(model), advance=advance, positions=lambda: work.position)


@inlined
def mark_orbit(image, mark, waiting, start, first, second, third):
    """Mark the orbit of a dart under three involutions."""
    waiting[0] = start
    mark[start] = 1
    n_waiting = 1
    while n_waiting > 0:
        n_waiting -= 1
        dart = waiting[n_waiting]
        for i in (first, second, third):
            reached = image[dart, i]
            if mark[reached] == 0:
                mark[reached] = 1
                waiting[n_waiting] = reached
                n_waiting += 1


@inlined
def pull(darts, dart, stiffness, tension, damping, position, velocity, force):
    """Add the pull of a dart's spring to its two nodes, all found through the dart."""
    s, i, j = darts.spring_of[dart], darts.node_of[dart], darts.node_of[darts.image[dart, 0]]
    dx = position[j, 0] - position[i, 0]
    dy = position[j, 1] - position[i, 1]
    dz = position[j, 2] - position[i, 2]
    du = velocity[j, 0] - velocity[i, 0]
    dv = velocity[j, 1] - velocity[i, 1]
    dw = velocity[j, 2] - velocity[i, 2]
    inverse = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
    amount = stiffness[s] - tension[s] * inverse + damping[s] * (dx * du + dy * dv + dz * dw) * inverse * inverse
    force[i, 0] += amount * dx
    force[i, 1] += amount * dy
    force[i, 2] += amount * dz
    force[j, 0] -= amount * dx
    force[j, 1] -= amount * dy
    force[j, 2] -= amount * dz


@fast
def pull_all(way, darts, stiffness, tension, damping, position, velocity, force):
    """Run over all edges."""
    mark = darts.mark
    if way == MARKS:
        for dart in range(len(mark)):
            if mark[dart] == 0:
                pull(darts, dart, stiffness, tension, damping, position, velocity, force)
                mark_orbit(darts.image, mark, darts.waiting, dart, 0, 2, 3)
        mark[:] = 0
    elif way == FLAGS:
        for dart in range(len(mark)):
            if darts.has_spring[dart] == 1:
                pull(darts, dart, stiffness, tension, damping, position, velocity, force)
    else:
        for dart in darts.of_spring:
            pull(darts, dart, stiffness, tension, damping, position, velocity, force)


@inlined
def move(stage, reach, weight, i, inverse_mass, gravity, drag, position, velocity, there, speed, moved, gained, force):
    """Take one node through one stage."""
    for axis in range(3):
        slope = velocity[i, axis] if stage == 0 else speed[i, axis]
        acceleration = inverse_mass[i] * force[i, axis] + gravity[i, axis] - drag * slope
        force[i, axis] = 0.0
        moved[i, axis] = (0.0 if stage == 0 else moved[i, axis]) + weight * slope
        gained[i, axis] = (0.0 if stage == 0 else gained[i, axis]) + weight * acceleration
        if stage < 3:
            there[i, axis] = position[i, axis] + reach * slope
            speed[i, axis] = velocity[i, axis] + reach * acceleration
        else:
            position[i, axis] += moved[i, axis]
            velocity[i, axis] += gained[i, axis]


@fast
def move_all(way, darts, stage, reach, weight, inverse_mass, gravity, drag,
             position, velocity, there, speed, moved, gained, force):
    """Run over all vertices."""
    mark = darts.mark
    if way == MARKS:
        for dart in range(len(mark)):
            if mark[dart] == 0:
                move(stage, reach, weight, darts.node_of[dart], inverse_mass, gravity, drag,
                     position, velocity, there, speed, moved, gained, force)
                mark_orbit(darts.image, mark, darts.waiting, dart, 1, 2, 3)
        mark[:] = 0
    elif way == FLAGS:
        for dart in range(len(mark)):
            if darts.has_node[dart] == 1:
                move(stage, reach, weight, darts.node_of[dart], inverse_mass, gravity, drag,
                     position, velocity, there, speed, moved, gained, force)
    else:
        for dart in darts.of_node:
            move(stage, reach, weight, darts.node_of[dart], inverse_mass, gravity, drag,
                     position, velocity, there, speed, moved, gained, force)


@fast
def run(n_steps, step, way, darts, stiffness, tension, damping, inverse_mass, gravity, drag,
        position, velocity, there, speed, moved, gained, force):
    """Take Runge-Kutta steps."""
    arrays = (position, velocity, there, speed, moved, gained, force)
    for _ in range(n_steps):
        pull_all(way, darts, stiffness, tension, damping, position, velocity, force)
        move_all(way, darts, 0, step / 2, step / 6, inverse_mass, gravity, drag, *arrays)
        for stage in range(1, 4):
            pull_all(way, darts, stiffness, tension, damping, there, speed, force)
            reach = step / 2 if stage == 1 else step
            weight = step / 6 if stage == 3 else step / 3
            move_all(way, darts, stage, reach, weight, inverse_mass, gravity, drag, *arrays)
