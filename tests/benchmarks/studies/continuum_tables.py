"""Tables of the study of the continuum."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gmapspring import meshes
from tests.benchmarks.studies import anisotropy
from tests.benchmarks.studies.comparison import (
    ALONG,
    SLENDERNESS,
    WHOLE,
    Comparison,
    apparent_modulus,
    beam_tip,
    least_wrong,
    tip_deflection,
)
from tests.benchmarks.studies.settling import settled_displacement
from tests.benchmarks.studies.statics import Problem, body_of, mean_elasticity, spring_displacement

CAUCHY_RATIO, SOFT_TISSUE = 0.25, 0.45
"""Poisson ratio of isotropic materials held together by central forces (Love, 1892, note B), and one of soft tissue."""
LOADS = (1e-3, 0.1)
"""Deflections of the cantilever over its length, in the simulation."""

Rows = list[dict[str, Any]]


def spring_errors(each: Comparison) -> list[float]:
    """Return the errors of springs by Poisson ratio."""
    return [each.error(each.springs, reference) for reference in each.reference]


def linear_errors(each: Comparison) -> list[float]:
    """Return the errors of linear elements by Poisson ratio."""
    return [each.error(*fields) for fields in zip(each.linear, each.reference, strict=True)]


def by_ratio(ratios: np.ndarray, values: Sequence[float]) -> dict[str, float]:
    """Return values under their Poisson ratios."""
    return {f"ν={ratio:g}": value for ratio, value in zip(ratios, values, strict=True)}


def error_rows(comparisons: Sequence[Comparison]) -> Rows:
    """Return errors of springs and of linear elements."""
    rows = []
    for each in comparisons:
        errors = {
            "springs": spring_errors(each),
            "linear elements": linear_errors(each),
        }
        rows += [{**each.label, "displacement": each.part, "model": model} | by_ratio(each.ratios, values)
                 for model, values in errors.items()]  # fmt: skip
    return rows


def ratio_rows(comparisons: Sequence[Comparison]) -> Rows:
    """Return least wrong Poisson ratios."""
    rows = []
    for each in comparisons:
        plain, error = least_wrong([each], is_scaled=False)
        ratio, scaled_error = least_wrong([each], is_scaled=True)
        scale = each.best_scale(each.reference_at(ratio))
        rows.append({**each.label, "displacement": each.part, "ν at c = 1": plain, "error at c = 1": error, "ν with c": ratio,
                     "c": scale, "error with c": scaled_error})  # fmt: skip
    return rows


def scale_rows(comparisons: Sequence[Comparison]) -> Rows:
    """Return the best scale by Poisson ratio, and the error before and after."""
    rows = []
    for each in comparisons:
        values = {
            "c": [each.best_scale(reference) for reference in each.reference],
            "error before": [each.scaled_error(reference, 1.0) for reference in each.reference],
            "error after": [each.scaled_error(reference) for reference in each.reference],
        }
        rows += [{**each.label, "displacement": each.part, "quantity": name} | by_ratio(each.ratios, row)
                 for name, row in values.items()]  # fmt: skip
    return rows


def held_out_rows(finest: Sequence[Comparison]) -> Rows:
    """Return the errors of all bodies by the body that the scale was found on."""
    rows = []
    for ratio in (CAUCHY_RATIO, SOFT_TISSUE):
        for part in (WHOLE, ALONG):
            chosen = {each.problem.name: each if part == WHOLE else each.along_load() for each in finest}
            references = {name: each.reference_at(ratio) for name, each in chosen.items()}
            scales = {"none": 1.0} | {name: each.best_scale(references[name]) for name, each in chosen.items()}
            for source, scale in scales.items():
                errors = {f"error, {name}": each.scaled_error(references[name], scale) for name, each in chosen.items()}
                rows.append({"ν": ratio, "displacement": part, "found on": source, "c": scale} | errors)
    return rows


def stiffness_rows(bodies: Mapping[str, Sequence[Comparison]]) -> Rows:
    """Return tip deflections and apparent moduli of all models."""

    def row(each: Comparison, model: str, quantity: str, values: Sequence[float]) -> dict[str, Any]:
        return {**each.label, "model": model, "quantity": quantity} | by_ratio(each.ratios, values)

    rows = []
    beams = bodies["cantilever"]
    theory = np.array([beam_tip(ratio) for ratio in beams[0].ratios])
    for name, comparisons, measure, unit in (
        ("tip", beams, tip_deflection, theory), ("modulus", bodies["block"], apparent_modulus, np.ones(len(theory)))
    ):  # fmt: skip
        for each in comparisons:
            rows.append(row(each, "springs", name, measure(each, each.springs) / unit))
            rows.append(row(each, "linear elements", name, [measure(each, field) for field in each.linear] / unit))
        rows.append(row(each, "reference", name, [measure(each, field) for field in each.reference] / unit))
    bending = [beam_tip(ratio, has_shear=False) for ratio in beams[0].ratios]
    return [*rows, row(beams[-1], "Euler-Bernoulli beam", "tip", bending / theory)]


def direction_rows(cells: Sequence[int]) -> Rows:
    """Return Young's modulus by direction."""
    lattices = {f"{n} cubes across": meshes.box((n, n, n), 1.0 / n) for n in cells}
    lattices |= {f"mirrored, {n} across": meshes.box((n, n, n), 1.0 / n, is_mirrored=True) for n in cells[-1:]}
    elasticity = mean_elasticity(body_of(meshes.box((1, 1, 1))))
    rows = []
    for label, direction in anisotropy.DIRECTIONS.items():
        along = anisotropy.unit(direction)
        measured = {name: anisotropy.measured_modulus(mesh, along) for name, mesh in lattices.items()}
        rows.append({"direction": label, "theory": anisotropy.directional_modulus(elasticity, along)} | measured)
    return rows


def settled_rows(problem: Problem) -> Rows:
    """Return how far simulations of the cantilever at rest are from linear theory."""
    linear = spring_displacement(problem)
    largest = np.max(np.linalg.norm(linear, axis=1))
    rows = []
    for share in LOADS:
        settled = settled_displacement(problem, share * SLENDERNESS / largest)
        difference = np.linalg.norm(settled - linear) / np.linalg.norm(linear)
        rows.append({"deflection over length": share, "relative difference, RMS": float(difference)})
    return rows
