"""The time-stepping schemes, one file each. To add one: write its file and enter it here; the tests run over this table."""

from gmapspring.integrators.backward_euler import BACKWARD_EULER
from gmapspring.integrators.explicit_euler import EXPLICIT_EULER
from gmapspring.integrators.integrator import Integrator, Limits
from gmapspring.integrators.rk4 import RK4
from gmapspring.integrators.symplectic_euler import SYMPLECTIC_EULER
from gmapspring.integrators.velocity_verlet import VELOCITY_VERLET

__all__ = ["INTEGRATORS", "Integrator", "Limits"]

INTEGRATORS: dict[str, Integrator] = {
    scheme.name: scheme for scheme in (RK4, SYMPLECTIC_EULER, VELOCITY_VERLET, EXPLICIT_EULER, BACKWARD_EULER)
}
"""Schemes by name."""
