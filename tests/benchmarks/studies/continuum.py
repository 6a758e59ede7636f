"""How far springs are from the elastic continuum that they stand for, and which one they come closest to."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh

from tests.benchmarks.studies import continuum_tables as tables
from tests.benchmarks.studies import continuum_text as text
from tests.benchmarks.studies.comparison import Comparison, block, cantilever, compare, liver, mirrored_block
from tests.benchmarks.studies.elasticity import Continuum, refined
from tests.benchmarks.studies.statics import Problem, body_of, factorised, spring_stiffness
from tests.benchmarks.study import Plan, Study, Table

RATIOS = {False: np.array([0.0, 0.1, 0.2, 0.25, 0.3, 0.4, 0.45]), True: np.array([0.0, 0.25, 0.45])}
"""Poisson ratios, by whether the study is quick."""
CELLS = {False: (2, 4, 8), True: (1, 2, 4)}
"""Cubes across a box, each half the size of those before; quadratic elements on the middle one have the last one's points."""


def run(plan: Plan) -> Study:
    """Compare deflections, fit Poisson ratio and stiffness, and check the reference, linear theory and directions."""
    ratios = RATIOS[plan.is_quick]
    bodies, checks = {}, []
    for make in (cantilever, block, mirrored_block, liver):
        plan.say(make.__name__)
        comparisons, check = compare_body(make, ratios, plan.is_quick)
        bodies[comparisons[0].problem.name] = comparisons
        checks.append(check)
    plan.say("directions, settling")
    finest = [comparisons[-1] for comparisons in bodies.values()]
    every = in_parts([comparison for comparisons in bodies.values() for comparison in comparisons])
    held_out, directions = tables.held_out_rows(finest), tables.direction_rows(CELLS[plan.is_quick])
    settled = tables.settled_rows(cantilever(min(CELLS[False])))
    return Study(
        "The model against the continuum",
        "\n\n".join((
            text.METHOD, text.error_text(bodies), text.ratio_text(finest), text.scale_text(bodies, held_out),
            text.direction_text(directions), text.rest_text(checks, settled),
        )),
        tables=(
            Table("RMS error of the displacement, relative to that of the continuum with Poisson ratio ν.",
                  tables.error_rows(every)),
            Table("The Poisson ratio ν of the continuum that springs come closest to, without and with a scale of stiffness, c.",
                  tables.ratio_rows(every)),
            Table("The scale of stiffness, c, that leaves the least error, on the finest meshes and the liver's own; all meshes: "
                  "`scales.csv`.", tables.scale_rows(in_parts([*finest, bodies["liver"][0]]))),
            Table("Errors with a scale found on another body, on the finest meshes.", held_out),
            Table("Stiffness as one number: the sinking of the cantilever's tip, over Timoshenko's beam; the block's apparent "
                  "Young's modulus, over that of the material.", tables.stiffness_rows(bodies)),
            Table("Young's modulus of Kuhn boxes by direction, over that of the material: by the theory of lattices, and "
                  "measured on a cube that is pulled at along the direction; mirrored: each small cube is "
                  "the image of its neighbours.", directions),
            Table("A simulation of a coarse cantilever let come to rest, against linear theory of the same springs.", settled),
            Table("Checks: how far the reference is from quadratic elements twice as large, at most over ν; the least eigenvalue "
                  "of the springs' stiffness matrix, over that of linear elements.", checks),
        ),
        figures={"error": draw(bodies)},
        hidden={"scales": tables.scale_rows(every)},
    )  # fmt: skip


def in_parts(comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Return each comparison as a whole and along the load."""
    return [part for whole in comparisons for part in (whole, whole.along_load())]


def compare_body(make: Callable[..., Problem], ratios: np.ndarray, is_quick: bool) -> tuple[list[Comparison], dict[str, Any]]:
    """Return comparisons from the coarsest mesh to the finest, and a row of checks."""
    problems = [liver(), refined(liver())] if make is liver else [make(cells) for cells in CELLS[is_quick]]
    # Quadratic elements on the mesh before the finest have all its points as nodes, but the liver hangs by so little that
    # they are too coarse there. On its finest mesh they take as long as all the rest together.
    place = len(problems) - (1 if make is liver and not is_quick else 2)
    reference = Continuum(problems[place], degree=2)
    comparisons = [compare(problem, reference, ratios) for problem in problems]
    check = {"body": problems[0].name, "tetrahedra of the reference": problems[place].mesh.n_tetrahedra, "moved by": math.nan}
    if place > 0:
        check["moved by"] = largest_change(problems[place - 1], comparisons[place - 1])
    return comparisons, check | {"least eigenvalue ratio": softness(problems[-2])}


def largest_change(problem: Problem, comparison: Comparison) -> float:
    """Return how far quadratic elements twice as large are from the reference, the largest error over Poisson ratios."""
    coarse = Continuum(problem, degree=2)
    fields = (coarse.displacement(ratio, problem.mesh.points) for ratio in comparison.ratios)
    return max(comparison.error(*pair) for pair in zip(fields, comparison.reference, strict=True))


def softness(problem: Problem) -> float:
    """Return the least eigenvalue of the springs' stiffness over that of linear elements; 0 if springs let something swing."""
    linear, is_free = Continuum(problem, degree=1), np.repeat(~problem.is_clamped, 3)
    return least_eigenvalue(spring_stiffness(body_of(problem.mesh)), is_free) / least_eigenvalue(
        linear.stiffness(tables.CAUCHY_RATIO), linear.is_free
    )


def least_eigenvalue(stiffness: sparse.csc_array, is_free: np.ndarray) -> float:
    """Return the least eigenvalue of a stiffness matrix over what is free [N/m]."""
    matrix = stiffness[is_free][:, is_free].tocsc()
    inverse = LinearOperator(matrix.shape, factorised(matrix).solve, dtype=np.float64)
    start = np.random.default_rng(0).standard_normal(len(matrix.indptr) - 1)
    return float(eigsh(matrix, k=1, sigma=0.0, OPinv=inverse, v0=start, return_eigenvectors=False)[0])


def draw(bodies: Mapping[str, Sequence[Comparison]]) -> Figure:
    """Return a picture of errors against the Poisson ratio, one panel for each body."""
    figure, panels = plt.subplots(1, len(bodies), figsize=(13.0, 4.2), layout="constrained", sharey=True)
    for axes, (name, comparisons) in zip(panels, bodies.items(), strict=True):
        for color, each in enumerate(comparisons):
            curves = {
                ("springs", "-"): tables.spring_errors(each),
                ("springs, along the load", "-."): tables.spring_errors(each.along_load()),
                ("linear elements", ":"): tables.linear_errors(each),
            }
            for (label, style), values in curves.items():
                entry = f"{each.problem.mesh.n_tetrahedra} tets, {label}"
                axes.semilogy(each.ratios, values, style, color=f"C{color}", marker=".", label=entry)
        axes.set(title=name, xlabel="Poisson ratio of the continuum", ylim=(1e-3, 2.0))
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(fontsize=6)
    panels[0].set_ylabel("relative RMS error of displacement")
    return figure
