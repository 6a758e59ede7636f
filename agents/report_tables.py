"""The tables of a study's page, each made of what was found and of nothing else."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.evaluation import Episode
from agents.results import Array, Curve, Group, Results, found_for, gap_by_seed, means_by_seed
from agents.statistics import estimate, estimate_difference, estimate_share, interquartile_mean
from agents.study_config import Row
from agents.study_jobs import DONE
from envs.collapse import COLLAPSE_RULES, SEPARATED

STRUCTURAL = ("tear", "inverted", "volume")
"""Reasons of a collapse that lie in the tissue."""
LEVELS = (0.5, 0.8, 0.9, 0.95)
"""Validation success whose first time is told."""
VERDICTS = {"not reached": "**not reached**", "not measured": "**not measured**", "seeds missing": "**seeds missing**"}
N_HARD_SCENES = 5
"""Scenes that most seeds fail on, listed for each row."""
NOTHING = "–"


class Table(NamedTuple):
    """Rows under headers."""

    headers: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def aims(results: Results) -> Table:
    """Return what was aimed at beside what was found."""
    rows = []
    for row in results.study.rows:
        for reach in row.reach:
            for found in found_for(results, row, reach):
                sign = "≤" if found.quantity == "gap" else "≥"
                asked = f"{found.quantity} {sign} {found.asked:g}{' in every seed' if found.in_every_seed else ''}"
                seeds = ", ".join(f"{seed}: {value:.3f}" for seed, value in found.by_seed.items()) or NOTHING
                if found.missing:
                    seeds += f"; missing: {', '.join(map(str, found.missing))}"
                verdict = VERDICTS.get(found.verdict, found.verdict)
                others = [number(found.figure_with(wrapper)) for wrapper in results.study.wrappers]
                rows.append((row.name, reach.aim, reach.scene, asked, number(found.figure), seeds, *others, verdict))
    headers = ("row", "aim", "test scenes of", "asked", "measured", "by seed")
    return Table((*headers, *(f"with {wrapper}" for wrapper in results.study.wrappers), ""), rows)


def remarks(results: Results) -> Iterator[str]:
    """Yield what limits the aims that are not reached, as the study tells it; what is said of several is said once."""
    missed: dict[str, list[str]] = {}
    for row in results.study.rows:
        for reach in row.reach:
            quantities = [found.quantity for found in found_for(results, row, reach) if found.verdict == "not reached"]
            if reach.remarks and quantities:
                missed.setdefault(reach.remarks, []).append(f"**{row.name}**, {reach.aim} ({', '.join(quantities)})")
    for text, aims_missed in missed.items():
        yield f"{'; '.join(aims_missed)}: {text}"


def unfinished(results: Results) -> Table:
    """Return the jobs that are not done, those of a row that stand alike in one line."""
    jobs: dict[tuple[str, str, str], list[str]] = {}
    for job, outcome, message in results.states:
        if outcome != DONE:
            jobs.setdefault((job.row, outcome, message.replace("|", "/")), []).append(job.name)
    rows = [(row, outcome, str(len(names)), message) for (row, outcome, message), names in jobs.items()]
    return Table(("row", "state", "jobs", ""), rows)


def policies(results: Results, scene: str) -> Table:
    """Return a line for each policy on the test scenes of a scene, the best first."""
    groups = [group for group in results.groups if (group.scene, group.split) == (scene, "test")]
    groups.sort(key=lambda group: -float(group.values("total_return").mean()))
    headers = ("policy", "seeds x scenes", "interquartile mean return", "mean return", "success", "set regret", "order regret",
               "other ends", "simulated steps", "steps/s", "training CPU s")  # fmt: skip
    return Table(headers, [_policy_row(group, results.curves.get(group.name.split(":")[-1], {})) for group in groups])


def _policy_row(group: Group, curves: dict[int, Curve]) -> tuple[str, ...]:
    """Return the figures of one policy."""
    returns, reasons = group.values("total_return"), group.values("reason")
    regrets = [episode.cost_ratio - 1.0 for episode in group.episodes if episode.reason == SEPARATED]
    training = [curve.total_cpu_seconds for curve in curves.values()]
    return (
        f"**{group.name}**" if group.is_learned else group.name,
        f"{returns.shape[0]} x {returns.shape[1]}",
        str(estimate(returns, interquartile_mean)),
        number(returns.mean()),
        str(estimate_share(group.values("is_success"))),
        number(np.mean(regrets)) if regrets else NOTHING,
        number(np.isin(reasons, list(COLLAPSE_RULES)).mean()),
        ends(group.episodes),
        f"{group.values('n_simulated').mean():.0f}",
        f"{(group.values('n_steps') / group.values('seconds')).mean():.0f}",
        f"{np.median(training):.0f}" if training else NOTHING,
    )


def ends(episodes: Sequence[Episode]) -> str:
    """Return what ended the episodes that did not separate the target, as shares of all."""
    shares = {reason: count / len(episodes) for reason, count in Counter(e.reason for e in episodes).most_common()}
    shares.pop(SEPARATED, None)
    structural = {reason: share for reason, share in shares.items() if reason in STRUCTURAL}
    parts = [f"{reason} {share:.1%}" for reason, share in shares.items() if reason not in STRUCTURAL]
    if structural:
        inner = ", ".join(f"{reason} {share:.1%}" for reason, share in structural.items())
        parts.insert(0, f"structural {sum(structural.values()):.1%} ({inner})")
    return ", ".join(parts) or NOTHING


def gaps(results: Results) -> Table:
    """Return by how much training scenes go better than test scenes, where a row was evaluated on both."""
    rows = []
    for group in results.groups:
        by_seed = gap_by_seed(results, group.name, group.scene)
        if group.split != "test" or not by_seed:
            continue
        test = means_by_seed(group, "total_return")
        on_test = np.mean([test[seed] for seed in by_seed])
        gap = np.mean(list(by_seed.values()))
        cells = ", ".join(f"{seed}: {value:+.3f}" for seed, value in by_seed.items())
        rows.append((group.name, group.scene, number(on_test + gap), number(on_test), f"{gap:+.3f}", cells))
    return Table(("row", "scene", "training return", "test return", "gap", "by seed"), rows)


def thinking(results: Results) -> Table:
    """Return what policies that simulate ahead reach, and at what price, the cheapest first."""
    rows = []
    for scene in test_scenes(results):
        thinkers = [group for group in test_groups(results, scene) if group.values("n_simulated").any()]
        for group in sorted(thinkers, key=lambda group: float(group.values("n_simulated").mean())):
            episode_seconds = group.values("seconds").mean()
            success = estimate_share(group.values("is_success"))
            rows.append((scene, group.name, f"{group.values('n_simulated').mean():.0f}", f"{episode_seconds:.2f}", str(success),
                         str(estimate(group.values("total_return")))))  # fmt: skip
    return Table(("scene", "policy", "simulated steps per episode", "s per episode", "success", "mean return"), rows)


def efficiency(results: Results) -> Table:
    """Return after how many steps and CPU seconds validation success first reached some levels: medians over seeds."""
    rows = []
    for name, curves in results.curves.items():
        cells = [_first_times(list(curves.values()), level) for level in LEVELS]
        trained = (f"{np.median([curve.total_steps for curve in curves.values()]):.0f}",
                   f"{np.median([curve.total_cpu_seconds for curve in curves.values()]):.0f}")  # fmt: skip
        rows.append((name, str(len(curves)), *cells, *trained))
    return Table(("row", "seeds", *(f"success {level:g}" for level in LEVELS), "steps in all", "CPU s in all"), rows)


def _first_times(curves: Sequence[Curve], level: float) -> str:
    """Return the medians over the seeds that reach a level, and how many do."""
    reaching = [(curve, int((curve.success >= level).argmax())) for curve in curves if (curve.success >= level).any()]
    first = [(curve.steps[at], curve.cpu_seconds[at]) for curve, at in reaching]
    if not first:
        return "in no seed"
    steps, seconds = np.median(np.array(first), axis=0)
    return f"{steps:.0f} steps, {seconds:.0f} s ({len(first)} of {len(curves)} seeds)"


def ablations(results: Results) -> Table:
    """Return how much worse or better a row does with something left out."""
    rows = []
    for row in results.study.rows:
        if row.ablates is None:
            continue
        for played in results.study.evaluations_of(row):
            ours, base = (results.group(name, played.scene, played.split) for name in (row.name, row.ablates))
            if played.split != "test" or ours is None or base is None:
                continue
            differences = [estimate_difference(*(each.values(field).astype(float) for each in (ours, base)))
                           for field in ("total_return", "is_success")]  # fmt: skip
            rows.append((row.name, row.ablates, played.scene, f"{len(ours.by_seed)} / {len(base.by_seed)}",
                         *(f"{d.value:+.3f} [{d.low:+.3f}, {d.high:+.3f}]" for d in differences)))  # fmt: skip
    return Table(("row", "less", "scene", "seeds", "difference of mean return", "difference of success"), rows)


def worst_seeds(results: Results) -> Table:
    """Return the worst seed of each row and scene, what ended its episodes, and the scenes that are hardest for all seeds."""
    rows = []
    for group in (group for group in results.groups if group.is_learned and group.split == "test"):
        returns, success = group.values("total_return"), group.values("is_success")
        worst = int(returns.mean(axis=1).argmin())
        seed, episodes = list(group.by_seed.items())[worst]
        rows.append((group.name, group.scene, str(seed), number(returns[worst].mean()), number(returns.mean()),
                     number(success[worst].mean()), ends(episodes), _hard_scenes(success, episodes)))  # fmt: skip
    headers = ("row", "scene", "worst seed", "its mean return", "that of all seeds", "its success", "its other ends",
               "hardest test scenes")  # fmt: skip
    return Table(headers, rows)


def _hard_scenes(success: Array, episodes: Sequence[Episode]) -> str:
    """Return the seeds of the scenes that most runs fail on, and how many do."""
    failures = (~success).sum(axis=0)
    order = [place for place in np.argsort(-failures, kind="stable")[:N_HARD_SCENES] if failures[place]]
    return ", ".join(f"{episodes[place].scene_seed} ({failures[place]} of {len(success)})" for place in order) or NOTHING


def rows_trained(results: Results) -> Table:
    """Return what each row is."""
    return Table(("row", "trained by", "starts from", "ablates", "runs done"), list(map(tuple, _row_lines(results))))


def _row_lines(results: Results) -> Iterator[list[str]]:
    """Yield the cells of each row."""
    for row in results.study.rows:
        n_done, n_asked = len(results.curves.get(row.name, {})), len(results.study.seeds_of(row))
        count = f"{n_done} of {n_asked}"
        yield [row.name, f"`agents train {row.train}`", row.start_from or NOTHING, row.ablates or NOTHING,
               count if n_done == n_asked else f"**{count}**"]  # fmt: skip


def test_scenes(results: Results) -> list[str]:
    """Return the scenes whose test scenes were played, in the order of the study."""
    return list(dict.fromkeys(group.scene for group in results.groups if group.split == "test"))


def test_groups(results: Results, scene: str) -> list[Group]:
    """Return all policies that played the test scenes of a scene."""
    return [group for group in results.groups if (group.scene, group.split) == (scene, "test")]


def number(value: Any) -> str:
    """Return a figure as it stands in a table."""
    return NOTHING if np.isnan(value) else f"{value:.3f}"


def row_family(results: Results, row: Row) -> list[Row]:
    """Return a row with its ablations."""
    return [row, *(each for each in results.study.rows if each.ablates == row.name)]
