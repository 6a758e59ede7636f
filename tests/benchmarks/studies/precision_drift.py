"""What an undamped body must keep, and how far each scheme keeps it: energy, momentum and angular momentum."""

import math
from typing import Any

import numpy as np

from gmapspring import Simulation, measure
from gmapspring.integrators import INTEGRATORS
from tests.benchmarks.studies.precision_rows import DTYPES
from tests.benchmarks.studies.precision_scenes import Scene

SHARES = (1.0, 0.25)
"""Of the default step."""
N_LOOKS = 20
"""How often the energy is looked at."""


def drift_rows(scene: Scene) -> list[dict[str, Any]]:
    """Return how far each scheme keeps what it should; NaN for one without a stable step."""
    return [
        {"scheme": scheme, "precision": np.dtype(dtype).name, "share of default step": share}
        | drift(scene.build(scheme, dtype), share, scene.seconds)
        for scheme in INTEGRATORS
        for dtype in DTYPES
        for share in SHARES
    ]


def drift(simulation: Simulation, share: float, seconds: float) -> dict[str, float]:
    """Return the largest change of energy on the way, and the changes of momenta at the end, all relative."""
    if simulation.default_step == 0.0:
        return dict.fromkeys(("energy", "momentum", "angular momentum"), math.nan)
    body = simulation.body
    energy, momentum, angular = energy_of(simulation), measure.momentum(body), measure.angular_momentum(body)
    # The momentum itself is 0: it is compared with what all nodes carry.
    carried = float(body.nodes.mass @ np.linalg.norm(body.nodes.velocity, axis=1))
    changes = []
    for _ in range(N_LOOKS):
        simulation.advance(seconds / N_LOOKS, share * simulation.default_step)
        changes.append(abs(energy_of(simulation) / energy - 1.0))
    return {
        "energy": max(changes),
        "momentum": float(np.linalg.norm(measure.momentum(body) - momentum)) / carried,
        "angular momentum": float(np.linalg.norm(measure.angular_momentum(body) - angular) / np.linalg.norm(angular)),
    }


def energy_of(simulation: Simulation) -> float:
    """Return kinetic and elastic energy [J]."""
    return measure.kinetic_energy(simulation.body) + measure.elastic_energy(simulation.body)
