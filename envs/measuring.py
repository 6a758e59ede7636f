"""What is measured of a body once it has settled: strains and volumes of its tissue, in one pass."""

import math

import numpy as np

from envs.arrays import HEALTHY_STRAIN, HEALTHY_VOLUME, IS_FINITE, LOWEST_RATIO, TARGET_STRAIN, TARGET_VOLUME, read_task
from gmapspring.jit import kernel, part
from gmapspring.matter import N_SPRINGS


@kernel
def measure(table, rows, real):
    """Measure the attached tissue of rows of a table: Play.strain, volume_ratio, and the numbers of `collapse.Tissue`."""
    for row in rows:
        task = read_task(table, row, real)
        strain_springs(task)
        measure_tissue(task)


@part
def strain_springs(task):
    """Set l / l0 - 1 of every spring, in float64 whatever the state's precision."""
    state, springs, strain = task.body.matter.nodes.state, task.body.matter.springs, task.play.spring_strain
    endpoints, rest_length = springs.endpoints, springs.rest_length
    for spring in range(task.body.matter.counts[N_SPRINGS]):
        x, y, z = side(state, endpoints[spring, 0], endpoints[spring, 1])
        strain[spring] = math.sqrt(x * x + y * y + z * z) / np.float64(rest_length[spring]) - 1.0


@part
def measure_tissue(task):
    """Measure every attached tetrahedron; what is not attached has strain and volume ratio 0."""
    play, rules, gmap, state = task.play, task.rules, task.body.gmap, task.body.matter.nodes.state
    strain, volume_ratio, is_attached, spring_strain = play.strain, play.volume_ratio, play.is_attached, play.spring_strain
    volume, is_target, edge_of, vertex_of = rules.volume, rules.is_target, gmap.edge_of, gmap.vertex_of
    largest_healthy, largest_target, lowest_ratio = 0.0, 0.0, math.inf
    healthy_volume, target_volume, doubt = 0.0, 0.0, 0.0
    for tet in range(len(strain)):
        largest, ratio = 0.0, 0.0
        if is_attached[tet]:
            largest, ratio = -1.0, present_volume(state, vertex_of, tet) / volume[tet]
            for edge in range(6):
                largest = max(largest, spring_strain[np.uint64(edge_of[tet, edge])])
            doubt += (largest - largest) + (ratio - ratio)  # 0, or not a number
            if is_target[tet]:
                target_volume += volume[tet]
                largest_target = max(largest_target, largest)
            else:
                healthy_volume += volume[tet]
                largest_healthy = max(largest_healthy, largest)
                lowest_ratio = min(lowest_ratio, ratio)
        strain[tet], volume_ratio[tet] = largest, ratio
    numbers = play.numbers
    numbers[HEALTHY_STRAIN], numbers[TARGET_STRAIN] = largest_healthy, largest_target
    numbers[LOWEST_RATIO] = lowest_ratio if healthy_volume > 0.0 else 1.0
    numbers[HEALTHY_VOLUME], numbers[TARGET_VOLUME] = healthy_volume, target_volume
    play.whole[IS_FINITE] = doubt == 0.0


@part
def present_volume(state, vertex_of, tet):
    """Return the signed volume of one tetrahedron [m^3]."""
    corner = vertex_of[tet, 0]
    ax, ay, az = side(state, corner, vertex_of[tet, 1])
    bx, by, bz = side(state, corner, vertex_of[tet, 2])
    cx, cy, cz = side(state, corner, vertex_of[tet, 3])
    return (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6.0


@part
def side(state, start, end):
    """Return the vector from one node to another [m], in float64."""
    i, j = np.uint64(start), np.uint64(end)
    return (
        np.float64(state[j, 0]) - np.float64(state[i, 0]),
        np.float64(state[j, 1]) - np.float64(state[i, 1]),
        np.float64(state[j, 2]) - np.float64(state[i, 2]),
    )
