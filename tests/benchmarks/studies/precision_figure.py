"""Work-precision diagrams: one panel for each scene, one curve for each scheme and precision."""

import math
from collections.abc import Sequence

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gmapspring.integrators import INTEGRATORS
from tests.benchmarks.studies.precision_rows import Row, is_explicit

N_COLUMNS = 4
STYLES = {"float64": "-", "float32": "--"}


def draw(rows: Sequence[Row], scenes: Sequence[str], quantity: str, label: str) -> Figure:
    """Return the figure; quantity: the field of rows that holds the error."""
    n_lines = math.ceil(len(scenes) / N_COLUMNS)
    figure, panels = plt.subplots(n_lines, N_COLUMNS, figsize=(12.0, 2.7 * n_lines + 0.6), layout="constrained", squeeze=False)
    for panel in panels.flat[len(scenes):]:
        panel.set_axis_off()
    for scene, panel in zip(scenes, panels.flat, strict=False):
        draw_panel(panel, [row for row in rows if row.scene == scene], quantity)
        panel.set_title(scene, fontsize=10)
    for panel in panels[:, 0]:
        panel.set_ylabel("CPU s per simulated s")
    for panel in panels[-1]:
        panel.set_xlabel(label)
    handles = [plt.Line2D([], [], color=f"C{i}", label=scheme) for i, scheme in enumerate(INTEGRATORS)]
    handles += [plt.Line2D([], [], color="k", linestyle=style, label=precision) for precision, style in STYLES.items()]
    handles.append(plt.Line2D([], [], color="k", linestyle="", marker="o", fillstyle="none", label="stable bound"))
    figure.legend(handles=handles, ncols=len(handles), loc="outside lower center", fontsize=8)
    return figure


def draw_panel(panel: Axes, rows: Sequence[Row], quantity: str) -> None:
    """Draw the curves of one scene; a ring marks a step at the stable bound."""
    for number, scheme in enumerate(INTEGRATORS):
        for precision, style in STYLES.items():
            curve = [row for row in rows if (row.scheme, row.precision) == (scheme, precision) and not row.note]
            errors, costs = [getattr(row, quantity) for row in curve], [row.cpu for row in curve]
            panel.loglog(errors, costs, style, color=f"C{number}", marker=".", markersize=4, linewidth=1)
            if curve and is_explicit(scheme):
                panel.loglog(errors[:1], costs[:1], "o", color=f"C{number}", fillstyle="none", markersize=8)
    panel.grid(True, which="major", alpha=0.3)
