"""When a body collapses: what attached healthy tissue bears, and the reasons for which it gives way."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

SEPARATED = "separated"
"""Outcome of a target that hangs on nothing any more; the others are the reasons of a collapse."""


class Tissue(NamedTuple):
    """State of the attached tissue in a few numbers; or, for many bodies at once, in as many arrays (n,)."""

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

    is_touched: bool
    """Whether a cut has laid open a vessel, or a part of one has come loose."""


CollapseRule = Callable[[Tissue, Any, Any], Any]

COLLAPSE_RULES: dict[str, CollapseRule] = {
    "numerical": lambda tissue, healthy_share, limits: np.logical_not(tissue.is_finite),
    "vessel": lambda tissue, healthy_share, limits: tissue.is_touched,
    "volume": lambda tissue, healthy_share, limits: healthy_share < limits.healthy_share,
    "tear": lambda tissue, healthy_share, limits: tissue.healthy_strain > limits.strain,
    "inverted": lambda tissue, healthy_share, limits: tissue.lowest_volume_ratio < limits.volume_ratio,
}
"""Reasons of a collapse, the first that holds is reported: (tissue, attached healthy volume over the start's, limits) -> bool,
of numbers or of arrays (n,) alike; limits have the fields of `scene_config.Limits`."""


def collapse_reason(tissue: Tissue, healthy_share: float, limits: Any) -> str | None:
    """Return why the body has collapsed, or None where it stands."""
    return next((name for name, rule in COLLAPSE_RULES.items() if rule(tissue, healthy_share, limits)), None)


def collapse_reasons(tissue: Tissue, healthy_share: np.ndarray, limits: Any) -> np.ndarray:
    """Return the same for many bodies, an object array (n,)."""
    reasons = np.full(len(healthy_share), None, dtype=object)
    # Backwards, so that the first rule has the last word.
    for name, rule in reversed(COLLAPSE_RULES.items()):
        reasons[rule(tissue, healthy_share, limits)] = name
    return reasons
