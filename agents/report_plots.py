"""The pictures of a study's page: learning curves, and what thinking buys."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator, ScalarFormatter

from agents.choice import SEARCH
from agents.png import figure_as_png
from agents.report_tables import row_family, test_groups, test_scenes
from agents.results import Array, Curve, Results
from agents.study_config import Row

N_POINTS = 200
"""Points of a median curve."""


def pictures(results: Results) -> dict[str, bytes]:
    """Return all pictures as PNG files, by name."""
    figures = {f"curves-{row.name}": learning_curves(results, row) for row in results.study.rows if row.ablates is None}
    figures["thinking"] = success_against_thinking(results)
    return {name: figure_as_png(figure) for name, figure in figures.items() if figure is not None}


def learning_curves(results: Results, row: Row) -> Figure | None:
    """Return validation return against CPU seconds and steps for a row and its ablations; None where no run is done."""
    family = [each.name for each in row_family(results, row) if each.name in results.curves]
    if not family:
        return None
    figure = Figure(figsize=(9.0, 3.6), layout="constrained")
    for panel, label in zip(figure.subplots(1, 2, sharey=True), ("CPU seconds", "steps"), strict=True):
        for number, name in enumerate(family):
            _draw_curves(panel, list(results.curves[name].values()), label, f"C{number}", name)
        panel.set_xlabel(label)
        panel.grid(alpha=0.3)
    figure.axes[0].set_ylabel("validation return")
    figure.axes[1].legend(fontsize=8, loc="lower right")
    return figure


def _draw_curves(panel: Axes, curves: Sequence[Curve], label: str, colour: str, name: str) -> None:
    """Draw each seed thin and the median over seeds thick."""
    lines = [(curve.cpu_seconds if label == "CPU seconds" else curve.steps, curve.returns) for curve in curves]
    for at, returns in lines:
        panel.plot(at, returns, color=colour, linewidth=0.7, alpha=0.4)
    grid, median = median_curve(lines)
    panel.plot(grid, median, color=colour, linewidth=2.2, label=f"{name}, median of {len(curves)} seeds")


def median_curve(lines: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the median of curves (x, y) at points where all of them are known, straight between their own points."""
    known = [line for line in lines if len(line[0])]
    if not known:
        return np.empty(0), np.empty(0)
    grid = np.linspace(max(at[0] for at, _ in known), min(at[-1] for at, _ in known), N_POINTS)
    return grid, np.median([np.interp(grid, at, values) for at, values in known], axis=0)


def success_against_thinking(results: Results) -> Figure | None:
    """Return success against simulated steps, a panel for each scene where a policy simulates; None where none does."""
    scenes = [scene for scene in test_scenes(results)
              if any(group.values("n_simulated").any() for group in test_groups(results, scene))]  # fmt: skip
    if not scenes:
        return None
    figure = Figure(figsize=(max(4.5, 3.4 * len(scenes)), 3.8), layout="constrained")
    for panel, scene in zip(figure.subplots(1, len(scenes), squeeze=False)[0], scenes, strict=True):
        _draw_thinking(panel, results, scene)
    return figure


def _draw_thinking(panel: Axes, results: Results, scene: str) -> None:
    """Draw a point for each policy that simulates, joined within a family, and a level for each learned one that does not."""
    families: dict[str, list[tuple[float, float]]] = {}
    for group in test_groups(results, scene):
        simulated, success = float(group.values("n_simulated").mean()), float(group.values("is_success").mean())
        if simulated:
            families.setdefault(SEARCH if group.name.startswith(f"{SEARCH}:") else group.name, []).append((simulated, success))
        elif group.is_learned:
            label, colour = f"{group.name}, without", f"C{len(panel.lines)}"
            panel.axhline(success, linestyle="--", linewidth=1.2, color=colour, label=label)
    for name, points in families.items():
        panel.plot(*np.array(sorted(points)).T, marker="o", color=f"C{len(panel.lines)}", label=name)
    panel.set(title=scene, xlabel="simulated steps per episode", ylabel="success", xscale="log", ylim=(-0.03, 1.03))
    # Plain numbers, few enough to be read side by side.
    panel.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    panel.xaxis.set_major_formatter(ScalarFormatter())
    panel.xaxis.set_minor_locator(NullLocator())
    panel.grid(alpha=0.3)
    panel.legend(fontsize=7)
