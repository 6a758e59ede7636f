"""The time-stepping schemes, one file each. To add one: write its file and enter it here; the tests run over this table."""

from gmapspring.integrators.integrator import Integrator
from gmapspring.integrators.rk4 import RK4
from gmapspring.integrators.symplectic_euler import SYMPLECTIC_EULER

__all__ = ["INTEGRATORS", "Integrator"]

INTEGRATORS: dict[str, Integrator] = {"rk4": RK4, "symplectic_euler": SYMPLECTIC_EULER}
"""Schemes by name."""
