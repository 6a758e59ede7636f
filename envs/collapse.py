"""When a body collapses: what attached healthy tissue bears, and the reasons for which it gives way."""

import math
from collections.abc import Callable
from typing import NamedTuple

from envs.scene_config import Limits
from gmapspring.jit import kernel


class Tissue(NamedTuple):
    """State of the attached tissue in a few numbers."""

    healthy_strain: float
    """Largest edge strain of healthy tetrahedra, 0 where there are none or all are shortened."""

    target_strain: float
    """Largest edge strain of target tetrahedra, likewise."""

    lowest_volume_ratio: float
    """Smallest volume over rest volume among healthy tetrahedra, 1 where there are none."""

    healthy_volume: float
    """Rest volume of healthy tetrahedra [m^3]."""

    target_volume: float
    """Rest volume of target tetrahedra [m^3]."""

    is_finite: bool
    """Whether strains and volumes are all finite numbers."""


@kernel
def measure_tissue(gmap, state, rest_length, volume, is_target, is_attached, strain, volume_ratio):
    """Measure every attached tetrahedron and return the numbers of `Tissue`.

    Args:
        gmap: the map.
        state: nodes [x y z 0 u v w 0], shape (n_nodes or more, 8).
        rest_length: of the springs [m], shape (n_springs or more,).
        volume: rest volumes [m^3], shape (n_tetrahedra,).
        is_target: bool (n_tetrahedra,).
        is_attached: bool (n_tetrahedra,).
        strain: out, largest strain of its edges, 0 where not attached, shape (n_tetrahedra,).
        volume_ratio: out, volume over rest volume, 0 where not attached, shape (n_tetrahedra,).
    """
    largest_healthy, largest_target, lowest_ratio = 0.0, 0.0, math.inf
    healthy_volume, target_volume = 0.0, 0.0
    is_finite = True
    for tet in range(volume.shape[0]):
        strain[tet], volume_ratio[tet] = 0.0, 0.0
        if not is_attached[tet]:
            continue
        strain[tet] = _strain(gmap, state, rest_length, tet)
        volume_ratio[tet] = _volume(gmap, state, tet) / volume[tet]
        is_finite = is_finite and math.isfinite(strain[tet]) and math.isfinite(volume_ratio[tet])
        if is_target[tet]:
            target_volume += volume[tet]
            largest_target = max(largest_target, strain[tet])
        else:
            healthy_volume += volume[tet]
            largest_healthy = max(largest_healthy, strain[tet])
            lowest_ratio = min(lowest_ratio, volume_ratio[tet])
    if healthy_volume == 0.0:
        lowest_ratio = 1.0
    return largest_healthy, largest_target, lowest_ratio, healthy_volume, target_volume, is_finite


@kernel
def _strain(gmap, state, rest_length, tet):
    """Return the largest l / l0 - 1 of the edges 01 02 03 12 13 23 of one tetrahedron."""
    largest, edge = -1.0, 0
    for first in range(3):
        for second in range(first + 1, 4):
            x, y, z = _side(gmap, state, tet, first, second)
            length = math.sqrt(x * x + y * y + z * z)
            largest = max(largest, length / rest_length[gmap.edge_of[tet, edge]] - 1.0)
            edge += 1
    return largest


@kernel
def _volume(gmap, state, tet):
    """Return the signed volume of one tetrahedron [m^3]."""
    ax, ay, az = _side(gmap, state, tet, 0, 1)
    bx, by, bz = _side(gmap, state, tet, 0, 2)
    cx, cy, cz = _side(gmap, state, tet, 0, 3)
    return (ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)) / 6.0


@kernel
def _side(gmap, state, tet, first, second):
    """Return the vector from one corner to another [m], in float64 whatever the state's precision."""
    start, end = gmap.vertex_of[tet, first], gmap.vertex_of[tet, second]
    return (
        float(state[end, 0]) - float(state[start, 0]),
        float(state[end, 1]) - float(state[start, 1]),
        float(state[end, 2]) - float(state[start, 2]),
    )


CollapseRule = Callable[[Tissue, float, Limits], bool]

COLLAPSE_RULES: dict[str, CollapseRule] = {
    "numerical": lambda tissue, healthy_share, limits: not tissue.is_finite,
    "volume": lambda tissue, healthy_share, limits: healthy_share < limits.healthy_share,
    "tear": lambda tissue, healthy_share, limits: tissue.healthy_strain > limits.strain,
    "inverted": lambda tissue, healthy_share, limits: tissue.lowest_volume_ratio < limits.volume_ratio,
}
"""Reasons of a collapse, the first that holds is reported; healthy_share is attached healthy volume over the start's."""


def collapse_reason(tissue: Tissue, healthy_share: float, limits: Limits) -> str | None:
    """Return why the body has collapsed, or None where it stands."""
    return next((name for name, rule in COLLAPSE_RULES.items() if rule(tissue, healthy_share, limits)), None)
