"""Which scheme, precision and step to take where only a tolerance is given.

The rules are read off runs of many bodies with every scheme, precision and step (docs/accuracy.md), with room to spare. They go
by what is known of a body before it moves: how its elements are damped. Only explicit schemes are chosen: elements bound their
steps. The error of backward Euler, at its long steps, is that of the slow motion, of which elements say nothing.
"""

from typing import NamedTuple

import numpy as np

from gmapspring.integrators import INTEGRATORS, Limits

LEAST_TOLERANCE = 1e-8
"""Below this, what tetrahedra of this size say of a body is not worth the steps."""
DAMPED = 0.5
"""Median damping ratio from which fast motions die out before they have swung once or twice."""


class Rule(NamedTuple):
    """What to take for a tolerance."""

    tolerance: float
    """The smallest one that this is meant for."""
    integrator: str
    dtype: type
    share: float
    """Step over the scheme's default one."""


LIGHT = (
    Rule(1e-1, "rk4", np.float32, 1.0),
    Rule(1e-2, "rk4", np.float32, 0.2),
    Rule(1e-3, "rk4", np.float32, 0.1),
    Rule(1e-4, "rk4", np.float64, 0.05),
)
"""For bodies whose motions go on: fast ones have to be followed, and the fourth order pays."""
HEAVY = (
    Rule(1e-2, "symplectic_euler", np.float32, 1.0),
    Rule(1e-3, "rk4", np.float32, 1.0),
    Rule(1e-4, "rk4", np.float64, 1.0),
)
"""For bodies whose fast motions die out: what is stable is exact enough."""


class Choice(NamedTuple):
    """How to simulate a body."""

    integrator: str
    dtype: type
    step: float | None
    """[s], infinite where nothing acts; None for the scheme's default."""


def choose(limits: Limits, tolerance: float) -> Choice:
    """Return how to simulate a body whose elements have these limits, arrays (n_tets,), to a tolerance.

    The tolerance is for the distance of nodes from where they should be, root mean square over the size of the body, and for the
    strain of springs, at the end of a motion as long as a few of the body's slow swings. No proof: see docs/accuracy.md.
    """
    if not LEAST_TOLERANCE <= tolerance < 1.0:
        raise ValueError(f"tolerance must be at least {LEAST_TOLERANCE:g} and less than 1, not {tolerance}")
    rule = rule_for(is_light(limits), tolerance)
    return Choice(rule.integrator, rule.dtype, rule.share * INTEGRATORS[rule.integrator].default_step(limits))


def rule_for(light: bool, tolerance: float) -> Rule:
    """Return what to take for light bodies or for others; beyond the finest rule its error follows the scheme's order."""
    rules = LIGHT if light else HEAVY
    rule = next((rule for rule in rules if rule.tolerance <= tolerance), rules[-1])
    finer = min(1.0, tolerance / rule.tolerance) ** (1.0 / INTEGRATORS[rule.integrator].order)
    return rule._replace(tolerance=tolerance, share=finer * rule.share)


def is_light(limits: Limits) -> bool:
    """Tell whether the fast motions of a body go on."""
    frequency, rate = np.asarray(limits.frequency), np.asarray(limits.damping_rate)
    is_stiff = frequency > 0.0
    return bool(is_stiff.any() and np.median(rate[is_stiff] / frequency[is_stiff]) < 2.0 * DAMPED)
