"""What a cut costs: area for a face, volume for a tetrahedron, and volume for healthy tissue that comes loose.

Costs have no unit: areas count in h^2 and volumes in h^3, h the scene's unit of length.
"""

from typing import NamedTuple

import numpy as np

FACE_COST = 1.0
"""Cost of a face cut, per area / h^2."""
TETRAHEDRON_COST = 6.6
"""Cost of a tetrahedron removed, per volume / h^3: its faces come free with it."""
LOSS_COST = 1.5
"""Cost of healthy tissue that comes loose, per volume / h^3."""


class CostParts(NamedTuple):
    """What one action cost; parts that do not apply are 0."""

    face: float
    """For a face cut."""

    tetrahedron: float
    """For a tetrahedron removed."""

    loss: float
    """For healthy tissue that came loose."""

    @property
    def total(self) -> float:
        """Return the cost of the action."""
        return self.face + self.tetrahedron + self.loss


NOTHING = CostParts(0.0, 0.0, 0.0)
"""Cost of an action that changed nothing."""


def face_costs(area: np.ndarray, spacing: float) -> np.ndarray:
    """Return the cost of cutting each face, given its area [m^2] and the unit of length [m], shape (n_faces,)."""
    return FACE_COST * area / spacing**2


def tetrahedron_costs(volume: np.ndarray, spacing: float) -> np.ndarray:
    """Return the cost of removing each tetrahedron, given its volume [m^3], shape (n_tetrahedra,)."""
    return TETRAHEDRON_COST * volume / spacing**3


def loss_costs(volume: np.ndarray, is_healthy: np.ndarray, spacing: float) -> np.ndarray:
    """Return the cost of each tetrahedron coming loose: only healthy tissue counts, shape (n_tetrahedra,)."""
    return np.where(is_healthy, LOSS_COST * volume / spacing**3, 0.0)
