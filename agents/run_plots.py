"""The drawings of a training run's page, as SVG that goes into the page and takes its colours of ink and paper."""

import io
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.report_plots import median_curve
from agents.run_episodes import Played
from agents.run_record import Run
from envs.collapse import SEPARATED

Array = np.ndarray[Any, Any]
Lines = list[tuple[Array, Array]]

COLORS = ("#3b82c4", "#d9773a", "#3f9e6b", "#b0569b", "#a58a1f", "#d1495b", "#4aa3b8", "#8a7bd1")
"""Colours of lines, to be told apart on white and on black."""
REASON_COLORS = {SEPARATED: "#3f9e6b", "tear": "#d1495b", "inverted": "#d9773a", "volume": "#a58a1f", "vessel": "#b0569b",
                 "budget": "#3b82c4", "numerical": "#7d8790"}  # fmt: skip
INK, GRID = "#010203", "#040506"
"""Stand for the page's colours of text and lines until the drawing is in the page."""
N_POINTS = 160
"""Points of a line at most: the rest would make the file larger and not be seen."""
OF_UPDATES = {"approx_kl": "KL divergence of updates", "entropy_loss": "entropy of choices", "explained_variance":
              "explained variance", "steps_per_second": "steps per second"}  # fmt: skip
"""What else is drawn of updates, by column of progress.csv."""


class Group(NamedTuple):
    """Runs of one configuration that differ in their seeds alone."""

    label: str
    runs: list[Run]


def learning_curves(groups: Sequence[Group]) -> str:
    """Return validation return and success against CPU seconds and steps: seeds thin, their median thick."""
    figure = _figure(2, 2, 6.2)
    for row, quantity in enumerate(("return", "success")):
        for column, at in enumerate(("cpu_seconds", "steps")):
            panel = figure.axes[2 * row + column]
            _draw_groups(panel, groups, partial(_validations, at, f"validation_{quantity}"))
            if sum(len(group.runs) for group in groups) == 1:
                run = groups[0].runs[0]
                panel.plot(*_thinned(run.progress[at], run.progress[quantity]), color=COLORS[0], linewidth=0.7, alpha=0.5,
                           zorder=1, label="training, last 100 episodes")  # fmt: skip
            panel.set_xlabel("CPU seconds" if column == 0 else "steps")
            panel.set_ylabel(f"validation {quantity}" if column == 0 else "")
    figure.axes[1].legend(loc="lower right", frameon=False, fontsize=8)
    return as_svg(figure, "learning")


def update_curves(groups: Sequence[Group]) -> str:
    """Return what PPO tells of its updates, against steps."""
    names = [name for name in OF_UPDATES if all(name in run.progress for group in groups for run in group.runs)]
    figure = _figure(1, max(len(names), 1), 2.5)
    for panel, name in zip(figure.axes, names, strict=False):
        _draw_groups(panel, groups, partial(_updates, name))
        panel.set_title(OF_UPDATES[name], fontsize=9, color=INK)
        panel.set_xlabel("steps")
        panel.locator_params(nbins=4)
    return as_svg(figure, "updates")


def _validations(at: str, name: str, run: Run) -> tuple[Array, Array]:
    """Return a column of a run's validations against another."""
    return run.validated[at], run.validated[name]


def _updates(name: str, run: Run) -> tuple[Array, Array]:
    """Return a column of a run's updates against steps; the loss of entropy is turned back into entropy."""
    return run.progress["steps"], run.progress[name] * (-1.0 if name == "entropy_loss" else 1.0)


def reasons_of(played: Sequence[Played]) -> list[str]:
    """Return why episodes ended, in one order on every page."""
    found = dict.fromkeys(episode.reason for one in played for episode in one.episodes)
    known = [reason for reason in REASON_COLORS if reason in found]
    return [*known, *(reason for reason in found if reason not in REASON_COLORS)]


def outcomes(played: Sequence[Played]) -> str:
    """Return for each run a bar of how its episodes ended."""
    figure = _figure(1, 1, 0.9 + 0.32 * len(played))
    panel, names = figure.axes[0], [_plain(one.label) for one in played]
    left = np.zeros(len(played))
    reasons = reasons_of(played)
    for reason in reasons:
        shares = np.array([np.mean([e.reason == reason for e in one.episodes]) for one in played])
        panel.barh(names, shares, left=left, height=0.62, color=REASON_COLORS.get(reason, INK), label=reason)
        left += shares
    panel.invert_yaxis()
    panel.set(xlim=(0.0, 1.0), xlabel="share of episodes")
    panel.grid(visible=False)
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=len(reasons), frameon=False, fontsize=8)
    return as_svg(figure, "outcomes")


def _figure(n_rows: int, n_columns: int, height: float) -> Figure:
    """Return a figure of panels without paper of its own."""
    figure = Figure(figsize=(10.0, height), layout="constrained")
    for panel in figure.subplots(n_rows, n_columns, squeeze=False).ravel():
        panel.patch.set_alpha(0.0)
        panel.grid(color=GRID, linewidth=0.8)
        panel.set_axisbelow(True)
        panel.tick_params(colors=INK, labelsize=8, length=0)
        panel.xaxis.label.set(color=INK, fontsize=9)
        panel.yaxis.label.set(color=INK, fontsize=9)
        for side, spine in panel.spines.items():
            spine.set(color=GRID, visible=side in ("left", "bottom"))
    return figure


def _plain(name: str) -> str:
    """Return a folder's name as matplotlib shows it letter by letter: no formula, and no hidden entry of a legend."""
    return "\u200b" * name.startswith("_") + name.replace("$", r"\$")


def _draw_groups(panel: Axes, groups: Sequence[Group], curve_of: Callable[[Run], tuple[Array, Array]]) -> None:
    """Draw each run thin and the median of each group thick; a run alone is as thick as a median."""
    for number, group in enumerate(groups):
        color = COLORS[number % len(COLORS)]
        lines: Lines = [_thinned(*curve_of(run)) for run in group.runs]
        for at, values in lines if len(lines) > 1 else []:
            panel.plot(at, values, color=color, linewidth=0.8, alpha=0.65)
        label = _plain(group.label)
        if len(lines) > 1:
            label += f", median of {len(lines)} seeds"
        middle = median_curve(lines) if len(lines) > 1 else lines[0]
        panel.plot(*middle, color=color, linewidth=1.8, label=label, marker="o" if len(middle[0]) == 1 else None)


def _thinned(at: Array, values: Array) -> tuple[Array, Array]:
    """Return means over stretches of a line that has too many points; points without a value are left out."""
    is_known = ~np.isnan(values)
    at, values = at[is_known], values[is_known]
    if len(at) <= N_POINTS:
        return at, values
    parts = np.array_split(np.arange(len(at)), N_POINTS)
    return np.array([at[part].mean() for part in parts]), np.array([values[part].mean() for part in parts])


def as_svg(figure: Figure, name: str) -> str:
    """Return a figure as an element of a page; the same figure gives the same text, and its ids begin with its name."""
    for legend in (panel.get_legend() for panel in figure.axes):
        for entry in legend.get_texts() if legend else []:
            entry.set_color(INK)
    stream = io.StringIO()
    with mpl.rc_context({"svg.hashsalt": name, "svg.fonttype": "none"}):
        figure.savefig(stream, format="svg", metadata={"Date": None}, transparent=True)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"\s*<metadata>.*?</metadata>|\s*<style.*?</style>", "", text, flags=re.DOTALL)
    used = set(re.findall(r"#([\w.-]+)", text))
    text = re.sub(r' id="([\w.-]+)"', lambda found: f' id="{name}-{found[1]}"' if found[1] in used else "", text)
    text = re.sub(r'(href="|url\()#', rf"\1#{name}-", text)
    # Words take the page's own font.
    text = re.sub(r"font: ([\d.]+px)[^;\"]*", r"font-size: \1", text)
    return text.replace(INK, "currentColor").replace(GRID, "var(--line)")
