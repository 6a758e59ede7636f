"""The tables of a training run's page."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from agents.evaluation import Episode
from agents.html import Block, Folded
from agents.report_tables import NOTHING, Table, number
from agents.run_episodes import Played
from agents.run_plots import Group, reasons_of
from agents.run_record import Run, share_done

MEANINGS = (
    "separated: the target came free and nothing collapsed. Collapses: tear (healthy tissue was strained too far), inverted (a "
    "tetrahedron turned inside out), volume (too much healthy tissue came off), vessel (one was laid open), numerical. budget: "
    "the episode cost more than it may."
)
LEVELS = (0.5, 0.8, 0.9)
"""Validation success whose first time is told."""
N_LINES = 14
"""Validations that a learning table lists at most."""


def outcome_table(groups: Sequence[Group], played: Sequence[Played]) -> Table:
    """Return a line for each run, and one for all seeds of a configuration: means, and how often each reason ended an episode."""
    by_label = {one.label: one for one in played}
    reasons = reasons_of(played)
    rows = []
    for group in groups:
        members = [by_label[run.label] for run in group.runs if run.label in by_label]
        rows += [_outcome_row(one.label, one.episodes, reasons) for one in members]
        if len(members) > 1:
            rows.append(_outcome_row(f"all of {group.label}", [e for one in members for e in one.episodes], reasons))
    return Table(("run", "episodes", "mean return", "cuts", "cost/J* of successes", *reasons), rows)


def _outcome_row(label: str, episodes: Sequence[Episode], reasons: Sequence[str]) -> tuple[str, ...]:
    """Return the line of some episodes."""
    costs = [episode.cost_ratio for episode in episodes if episode.is_success]
    return (
        label,
        str(len(episodes)),
        number(np.mean([episode.total_return for episode in episodes])),
        f"{np.mean([episode.n_steps for episode in episodes]):.1f}",
        number(np.mean(costs)) if costs else NOTHING,
        *(f"{np.mean([episode.reason == reason for episode in episodes]):.1%}" for reason in reasons),
    )


def episode_table(played: Played) -> Table:
    """Return every episode of a run."""
    rows = [(e.scene, str(e.scene_seed), number(e.total_return), e.reason, f"{e.cost_ratio:.3f}", str(e.n_steps))
            for e in played.episodes]  # fmt: skip
    return Table(("scene", "seed", "return", "ended by", "cost/J*", "cuts"), rows)


def efficiency_table(groups: Sequence[Group]) -> Table:
    """Return for each run how far it came, and when its validation success first reached some levels."""
    rows = []
    for group in groups:
        for run in group.runs:
            valid = run.validated
            best = int(valid["validation_return"].argmax()) if len(valid["steps"]) else None
            rows.append((
                run.label,
                group.label if len(group.runs) > 1 else NOTHING,
                f"{run.progress['steps'][-1]:.0f}",
                f"{run.progress['cpu_seconds'][-1]:.0f} s",
                f"{share_done(run):.0%}",
                NOTHING if best is None else number(valid["validation_return"][best]),
                NOTHING if best is None else f"{valid['steps'][best]:.0f}",
                *(_first_time(valid, level) for level in LEVELS),
            ))  # fmt: skip
    headers = ("run", "configuration", "steps", "CPU time", "done", "best validation return", "at step",
               *(f"success {level:g} after" for level in LEVELS))  # fmt: skip
    return Table(headers, rows)


def _first_time(validated: dict[str, Any], level: float) -> str:
    """Return the CPU seconds after which validation success first reached a level."""
    reached = np.flatnonzero(validated["validation_success"] >= level)
    return f"{validated['cpu_seconds'][reached[0]]:.0f} s" if len(reached) else NOTHING


def curve_table(run: Run) -> Table:
    """Return some validations of a run, evenly spread, with the first, the best and the last among them."""
    valid = run.validated
    n_validations = len(valid["steps"])
    if not n_validations:
        return Table(("step",), [])
    best = int(valid["validation_return"].argmax())
    shown = np.linspace(0, n_validations - 1, min(N_LINES, n_validations)).round().astype(int)
    columns = ("validation_return", "validation_success", "return", "success")
    rows = [
        (f"{valid['steps'][at]:.0f}", f"{valid['cpu_seconds'][at]:.0f}", *(number(valid[name][at]) for name in columns),
         "the best" if at == best else "")
        for at in np.unique([*shown, best])
    ]  # fmt: skip
    return Table(("step", "CPU s", "validation return", "validation success", "training return", "training success", ""), rows)


def compared(named: Sequence[tuple[str, dict[str, Any]]], what: str) -> list[Block]:
    """Return what several trees of settings differ in, and what they share."""
    flat = [(label, dict(_leaves(tree))) for label, tree in named]
    keys = list(dict.fromkeys(key for _, leaves in flat for key in leaves))
    values = {key: [leaves.get(key, NOTHING) for _, leaves in flat] for key in keys}
    shared = [(key, found[0]) for key, found in values.items() if len(set(found)) == 1]
    differing = [(key, *found) for key, found in values.items() if len(set(found)) > 1]
    parts: list[Block] = []
    if differing:
        parts.append(Table((what, *(label for label, _ in flat)), differing))
    if shared:
        table = Table((what, "value"), shared)
        parts.append(Folded("What all share", table) if len(flat) > 1 else table)
    return parts


def _leaves(tree: dict[str, Any], path: str = "") -> Iterator[tuple[str, str]]:
    """Yield every setting of a tree with its dotted path, as text."""
    for key, value in tree.items():
        if isinstance(value, dict) and value:
            yield from _leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}", value if isinstance(value, str) else json.dumps(value, default=str)
