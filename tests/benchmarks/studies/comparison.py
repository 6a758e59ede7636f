"""Springs against the continuum: displacement fields of a problem, how far they are apart, and what would bring them closer."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from gmapspring import meshes
from tests.benchmarks.studies.elasticity import Continuum
from tests.benchmarks.studies.statics import Problem, point_volumes, spring_displacement

SLENDERNESS = 4
"""Length of the cantilever over its height, which is 1 m."""
N_RATIOS = 91
"""Poisson ratios among which the least wrong one is sought."""
WHOLE, ALONG = "whole", "along the load"


def cantilever(cells: int) -> Problem:
    """Return a beam along x that is clamped at one end and sags by its weight; cells: cubes across its height."""
    mesh = meshes.box((SLENDERNESS * cells, cells, cells), spacing=1.0 / cells)
    return Problem("cantilever", mesh, mesh.points[:, 0] == 0.0, weight=(0.0, 0.0, -1.0))


def block(cells: int, is_mirrored: bool = False) -> Problem:
    """Return a cube of 1 m that is clamped at its bottom and pressed evenly on its top; cells: cubes along an edge."""
    mesh = meshes.box((cells, cells, cells), 1.0 / cells, is_mirrored)
    top = mesh.points[:, 2] == mesh.points[:, 2].max()
    name = "mirrored block" if is_mirrored else "block"
    return Problem(name, mesh, mesh.points[:, 2] == 0.0, stress=np.diag([0.0, 0.0, -1.0]), is_loaded=top)


def mirrored_block(cells: int) -> Problem:
    """Return the same of cubes that are mirror images of their neighbours."""
    return block(cells, is_mirrored=True)


def liver() -> Problem:
    """Return the organ, hanging by its anchor."""
    mesh = meshes.liver()
    return Problem("liver", mesh, mesh.point_regions["anchor"], weight=(0.0, 0.0, -1.0))


class Comparison(NamedTuple):
    """Displacements [m] of one problem at its points, at a Young's modulus of 1 Pa; all axes, or the one of the load."""

    problem: Problem
    part: str
    """WHOLE or ALONG: which axes."""
    ratios: np.ndarray
    """Poisson ratios of the continuum, (n_ratios,)."""
    springs: np.ndarray
    """Of our model, which has no Poisson ratio to choose, (n_points, n_axes)."""
    linear: np.ndarray
    """Of the continuum in linear elements on the same mesh, (n_ratios, n_points, n_axes)."""
    reference: np.ndarray
    """Of the continuum in quadratic elements, (n_ratios, n_points, n_axes)."""

    @property
    def label(self) -> dict[str, str | int]:
        """What a row of a table begins with."""
        return {"body": self.problem.name, "tetrahedra": self.problem.mesh.n_tetrahedra}

    def along_load(self) -> "Comparison":
        """Return the same of the displacement along z alone, where all loads point."""
        return self._replace(
            part=ALONG, springs=self.springs[:, 2:], linear=self.linear[..., 2:], reference=self.reference[..., 2:]
        )

    def error(self, field: np.ndarray, reference: np.ndarray) -> float:
        """Return the RMS over the body of the distance of two fields, over the RMS of the reference."""
        volume = point_volumes(self.problem.mesh)[:, None]
        return float(np.sqrt(np.sum(volume * (field - reference) ** 2) / np.sum(volume * reference**2)))

    def best_scale(self, reference: np.ndarray) -> float:
        """Return by what to multiply the springs' stiffness so that their error is the least.

        Displacements are divided by it: minimising |u / c - r|^2 gives c = u.u / u.r.
        """
        volume = point_volumes(self.problem.mesh)[:, None]
        return float(np.sum(volume * self.springs**2) / np.sum(volume * self.springs * reference))

    def scaled_error(self, reference: np.ndarray, scale: float | None = None) -> float:
        """Return the error of springs whose stiffness is multiplied by a scale, or by the best one."""
        return self.error(self.springs / (scale or self.best_scale(reference)), reference)

    def reference_at(self, ratio: float) -> np.ndarray:
        """Return the reference at any Poisson ratio within those solved for, by a cubic spline (n_points, n_axes)."""
        return CubicSpline(self.ratios, self.reference)(ratio)


def least_wrong(comparisons: Sequence[Comparison], is_scaled: bool) -> tuple[float, float]:
    """Return the Poisson ratio of the continuum that springs come closest to, and the RMS of the errors of all bodies there.

    is_scaled: let the best scale for each ratio and body be free too.
    """
    ratios = np.linspace(*comparisons[0].ratios[[0, -1]], N_RATIOS)
    squares = np.zeros(N_RATIOS)
    for comparison in comparisons:
        references = (comparison.reference_at(ratio) for ratio in ratios)
        squares += [comparison.scaled_error(reference, None if is_scaled else 1.0) ** 2 for reference in references]
    best = int(np.argmin(squares))
    return float(ratios[best]), float(np.sqrt(squares[best] / len(comparisons)))


def compare(problem: Problem, reference: Continuum, ratios: np.ndarray) -> Comparison:
    """Solve a problem by all models; reference: the same problem in elements that have all points of the mesh as nodes."""
    points, linear = problem.mesh.points, Continuum(problem, degree=1)
    return Comparison(
        problem, WHOLE, ratios, spring_displacement(problem),
        np.array([linear.displacement(ratio, points) for ratio in ratios]),
        np.array([reference.displacement(ratio, points) for ratio in ratios]),
    )  # fmt: skip


def tip_deflection(comparison: Comparison, field: np.ndarray) -> float:
    """Return how far the free end of the cantilever sinks, averaged over its face [m]."""
    is_tip = comparison.problem.mesh.points[:, 0] == SLENDERNESS
    return -float(np.mean(field[is_tip, 2]))


def apparent_modulus(comparison: Comparison, field: np.ndarray) -> float:
    """Return pressure over mean shortening of the block, over Young's modulus."""
    return -1.0 / float(np.mean(field[comparison.problem.is_loaded, 2]))


def beam_tip(poisson_ratio: float, has_shear: bool = True) -> float:
    """Return the tip deflection of the cantilever [m] by Timoshenko's theory, or without shear by Euler's and Bernoulli's.

    q L^4 / 8 E I + q L^2 / 2 G A k; k for rectangles by Cowper, "The shear coefficient in Timoshenko's beam theory", 1966.
    """
    bending = SLENDERNESS**4 / (8.0 / 12.0)
    shape = 10.0 * (1.0 + poisson_ratio) / (12.0 + 11.0 * poisson_ratio)
    return bending + (SLENDERNESS**2 * (1.0 + poisson_ratio) / shape if has_shear else 0.0)
