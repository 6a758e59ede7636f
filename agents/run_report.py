"""The page of one or several training runs: how they learnt, how their best policies play, and with what they were made."""

import os
import pathlib
from collections.abc import Callable, Sequence

import yaml

from agents import run_tables as tables
from agents.html import Block, Facts, Figure, Folded, Heading, Strip, Text, as_markdown_page, as_page
from agents.report_tables import NOTHING, number
from agents.run_episodes import N_EPISODES, SPLIT, Played, best_and_worst, film, play
from agents.run_plots import Group, learning_curves, outcomes, update_curves
from agents.run_record import Run, RunRecordError, read_runs
from gmapspring.paths import write_atomically

PAGE = "report.html"
"""Name of the page, unless another is given; the Markdown beside it ends in .md."""


def write_run_report(
    folders: Sequence[pathlib.Path],
    out: pathlib.Path | None = None,
    n_episodes: int | None = N_EPISODES,
    on_progress: Callable[[float, str], None] = lambda share, text: None,
) -> pathlib.Path:
    """Write the page of some training runs, and the same in Markdown beside it; return the page.

    Args:
        folders: of the runs, one or more.
        out: the page to write, a name that ends in .html; by default report.html in the folder of the run, or in the folder that
            all runs lie in.
        n_episodes: test scenes that each best policy plays; None for all.
        on_progress: called with the share that is done, and with what is being done.

    Raises:
        RunRecordError: a folder holds no run, or its files are damaged, or the page cannot lie there.
    """
    runs = read_runs(folders)
    path = out or pathlib.Path(os.path.commonpath([run.folder for run in runs])) / PAGE
    if path.suffix != ".html":
        raise RunRecordError(f"{path} is no name for a page; give one that ends in .html")
    played = []
    for count, run in enumerate(runs):
        on_progress(count / len(runs), f"{run.label} plays {SPLIT} scenes")
        played.append(play(run, n_episodes))
    title, blocks = contents(runs, played)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, as_page(title, blocks).encode())
    write_atomically(path.with_suffix(".md"), as_markdown_page(title, blocks).encode())
    return path


def contents(runs: Sequence[Run], played: Sequence[Played]) -> tuple[str, list[Block]]:
    """Return the title and the blocks of the page."""
    groups = groups_of(runs)
    scenes = " + ".join(dict.fromkeys(pathlib.Path(scene).stem for run in runs for scene in run.scenes))
    title = f"{len(runs)} training runs on {scenes}" if len(runs) > 1 else f"Training on {scenes}, {runs[0].label}"
    parts: list[Block] = [Text(_opening(groups)), Facts(_figures(runs, played))]
    for run in runs:
        parts += [Text(f"{run.label}: {remark}" if len(runs) > 1 else remark, is_remark=True) for remark in run.remarks]
    parts += [*_episodes(groups, played), *_learning(groups), Heading("Configuration")]
    parts += tables.compared([(run.label, run.config) for run in runs], "setting")
    parts += [Heading("Versions"), *tables.compared([(run.label, run.versions) for run in runs], "what")]
    return title, parts


def groups_of(runs: Sequence[Run]) -> list[Group]:
    """Return runs by configuration, the seed left out, in the order in which they were given."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        key = yaml.safe_dump({name: value for name, value in run.config.items() if name != "seed"}, sort_keys=True)
        groups.setdefault(key, []).append(run)
    return [Group(_group_label(members), members) for members in groups.values()]


def _group_label(members: Sequence[Run]) -> str:
    """Return what to call runs of one configuration: the folder that they lie in, unless it is but one run."""
    parents = list(dict.fromkeys(run.folder.parent.name for run in members))
    if len(members) == 1:
        return members[0].label
    return parents[0] if len(parents) == 1 else f"{members[0].label} and alike"


def _opening(groups: Sequence[Group]) -> str:
    """Return what the page is about."""
    n_runs = sum(len(group.runs) for group in groups)
    if n_runs == 1:
        run = groups[0].runs[0]
        return f"This page is generated from the folder `{run.label}`; it needs no other file."
    names = "; ".join(f"{group.label} ({len(group.runs)})" for group in groups)
    return (
        f"This page compares {n_runs} runs of {len(groups)} configuration{'s' * (len(groups) > 1)}: {names}. Runs that differ "
        "in their seeds alone count as one configuration. It is generated from their folders and needs no other file."
    )


def _figures(runs: Sequence[Run], played: Sequence[Played]) -> list[tuple[str, str]]:
    """Return the figures at the head of the page."""
    episodes = [episode for one in played for episode in one.episodes]
    pairs = []
    if episodes:
        pairs += [("success on test scenes", f"{sum(e.is_success for e in episodes) / len(episodes):.0%}"),
                  ("mean return, at most 1", number(sum(e.total_return for e in episodes) / len(episodes)))]  # fmt: skip
    best = [float(run.validated["validation_return"].max()) for run in runs if len(run.validated["steps"])]
    seconds = sum(float(run.progress["cpu_seconds"][-1]) for run in runs if len(run.progress["steps"]))
    steps = sum(int(run.progress["steps"][-1]) for run in runs if len(run.progress["steps"]))
    pairs.append(("best validation return", number(max(best)) if best else NOTHING))
    return [*pairs, ("steps of training", f"{steps:,}"), ("CPU time of training", f"{seconds:,.0f} s")]


def _episodes(groups: Sequence[Group], played: Sequence[Played]) -> list[Block]:
    """Return how the best policies play."""
    parts: list[Block] = [Heading("How the best policy plays" if len(played) == 1 else "How the best policies play")]
    parts += [Text(f"{one.label} does not play: {one.problem}", is_remark=True) for one in played if one.problem]
    present = [one for one in played if one.episodes]
    chosen = best_and_worst(present)
    if chosen is None:
        return [*parts, Text("No episodes have been played.")]
    counts = ", ".join(dict.fromkeys(f"{len(one.episodes)} of {one.n_scenes}" for one in present))
    parts += [
        Text(f"The policy with the best validation return plays {SPLIT} scenes, which nothing was learnt from nor chosen by: the "
             f"first {counts}, each once and without chance."),
        tables.outcome_table(groups, present),
        Figure(outcomes(present), f"How the episodes ended. {tables.MEANINGS}"),
    ]  # fmt: skip
    best, worst = chosen
    parts += [Strip(film(*best), _caption("Of highest return", *best))]
    if best != worst:
        parts += [Strip(film(*worst), _caption("Of lowest return", *worst))]
    return [*parts, *(Folded(f"Episodes of {one.label}", tables.episode_table(one)) for one in present)]


def _caption(what: str, played: Played, which: int) -> str:
    """Return what stands under the frames of an episode."""
    episode = played.episodes[which]
    return (
        f"{what}: {played.label}, scene `{episode.scene}`, seed {episode.scene_seed} ({SPLIT}), return "
        f"{number(episode.total_return)}, {episode.n_steps} cuts, cost {episode.cost_ratio:.2f} J*, ended by: {episode.reason}. "
        "The target is teal, raw cuts are pale."
    )


def _learning(groups: Sequence[Group]) -> list[Block]:
    """Return how the runs learnt."""
    runs = [run for group in groups for run in group.runs if len(run.progress["steps"])]
    parts: list[Block] = [Heading("Learning")]
    if not runs:
        return [*parts, Text("No update has been made.")]
    alive = [Group(group.label, [run for run in group.runs if run in runs]) for group in groups]
    alive = [group for group in alive if group.runs]
    lines = "Thin lines are seeds, the thick one is their median." if len(runs) > len(alive) else ""
    parts += [
        tables.efficiency_table(alive),
        Figure(learning_curves(alive), f"Return and success on validation scenes. {lines}".strip()),
        Figure(update_curves(alive), "What the learner tells of its updates; longer runs are averaged over stretches of them."),
    ]
    return [*parts, *(Folded(f"Validations of {run.label}", tables.curve_table(run)) for run in runs)]

