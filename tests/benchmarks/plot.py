"""The picture: size of the body against time per step, with the floors that the machine sets."""

import io
import math
import pathlib
from collections.abc import Callable, Sequence
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from gmapspring.paths import write_atomically
from tests.benchmarks.compiled import NotAvailable, peak_rate
from tests.benchmarks.machine import bandwidth, matrix_rate
from tests.benchmarks.rows import Row

EVALUATIONS = 4
"""Force evaluations of a Runge-Kutta step."""
FLOPS_PER_SPRING = 42
"""Differences 6, square and dot product 10, root and quotient 2, coefficient 6, force 3, sums 6, and 9 to recompute what the
second pass needs; a root or quotient counts as one, which flatters the floor."""
FLOPS_PER_NODE = (20 + 20 + 76 + 12) / EVALUATIONS + 8
"""In rows of four: the four stages, and drag in each."""
BYTES_PER_SPRING = 8 + 4 * 8
"""Two endpoints, stiffness, tension, damping, coefficient; read or written once in each evaluation, float64."""
BYTES_PER_NODE = 8 * ((12 + 16 + 24 + 4) / EVALUATIONS + (8 + 4 + 8 + 4) / EVALUATIONS + 4 + 4 + 4 + 2)
"""State and stages, of which the second's velocity is kept, read and written in the four stages; force read and written, constant
force, mass and drag in each; float64."""
SPRINGS_PER_TETRAHEDRON, NODES_PER_TETRAHEDRON = 1.25, 0.2
"""Of large boxes; small bodies have more, for their surface."""
SIZES = np.geomspace(1e3, 2e6, 12)


class Roofline(NamedTuple):
    """How fast a step could be on this machine, by size of the body."""

    by_arithmetic: np.ndarray
    """Seconds that the arithmetic takes at the measured peak rate, float64, (sizes,)."""
    by_memory: np.ndarray
    """Seconds that the traffic takes at the bandwidth measured for a working set of that size, (sizes,)."""


def roofline(peak: float, bandwidth_of: Callable[[int], float]) -> Roofline:
    """Return the floors of one Runge-Kutta step in float64, at all SIZES."""
    springs, nodes = SPRINGS_PER_TETRAHEDRON * SIZES, NODES_PER_TETRAHEDRON * SIZES
    flops = EVALUATIONS * (FLOPS_PER_SPRING * springs + FLOPS_PER_NODE * nodes)
    traffic = BYTES_PER_SPRING * springs + BYTES_PER_NODE * nodes
    measured = np.array([bandwidth_of(int(size)) for size in traffic])
    # A smaller working set is at least as fast as a larger one: where it was not, something else was running.
    fastest = np.maximum.accumulate(measured[::-1])[::-1]
    return Roofline(flops / peak, EVALUATIONS * traffic / fastest)


def write_plot(path: pathlib.Path, rows: Sequence[Row]) -> None:
    """Draw all rows that belong to a series, and write a PNG in one go."""
    try:
        peak = peak_rate()
    except NotAvailable:
        # A matrix product comes near the peak too.
        peak = matrix_rate()
    figure = draw(rows, roofline(peak, bandwidth))
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110)
    plt.close(figure)
    write_atomically(path, content.getvalue())


def draw(rows: Sequence[Row], floors: Roofline) -> Figure:
    """Return the figure."""
    figure, axes = plt.subplots(figsize=(8.0, 5.5), layout="constrained")
    for number, (name, points) in enumerate(series_of(rows).items()):
        sizes, times = np.array(sorted(points)).T
        style = {"linewidth": 2.5, "zorder": 3} if name.startswith("ours") else {"linewidth": 1.2}
        marker = "o" if len(points) > 1 else "DsX^v<>P*"[number % 9]
        axes.loglog(sizes, times, marker=marker, markersize=5, label=name, **style)
    axes.loglog(SIZES, 1e6 * floors.by_arithmetic, "k--", linewidth=1, label="floor: arithmetic at peak rate")
    axes.loglog(SIZES, 1e6 * floors.by_memory, "k:", linewidth=1, label="floor: memory traffic")
    axes.set(xlabel="tetrahedra", ylabel="µs per RK4 step", title="Time per step against size of the body")
    axes.grid(True, which="major", alpha=0.3)
    axes.legend(fontsize=7, ncols=2)
    return figure


def series_of(rows: Sequence[Row]) -> dict[str, list[tuple[float, float]]]:
    """Return (tetrahedra, microseconds) of each curve, ours first."""
    found: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if row.series and row.n_tetrahedra and not math.isnan(row.measured):
            found.setdefault(row.series, []).append((row.n_tetrahedra, row.measured))
    return dict(sorted(found.items(), key=lambda item: not item[0].startswith("ours")))
