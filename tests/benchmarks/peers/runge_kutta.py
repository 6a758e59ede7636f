"""The classical Runge-Kutta step over whole arrays, for peers that know array operations only."""

from collections.abc import Callable
from typing import Any

Slope = Callable[[Any, Any], Any]
"""Return the acceleration [m/s^2] at a position and velocity, (n_nodes, 3) each."""


def step_arrays(position: Any, velocity: Any, step: float, slope: Slope) -> tuple[Any, Any]:
    """Return position and velocity one step later."""
    a1 = slope(position, velocity)
    v2 = velocity + 0.5 * step * a1
    a2 = slope(position + 0.5 * step * velocity, v2)
    v3 = velocity + 0.5 * step * a2
    a3 = slope(position + 0.5 * step * v2, v3)
    v4 = velocity + step * a3
    a4 = slope(position + step * v3, v4)
    return (
        position + step / 6 * (velocity + 2 * (v2 + v3) + v4),
        velocity + step / 6 * (a1 + 2 * (a2 + a3) + a4),
    )
