"""What a study has found so far: episodes and learning curves, read from its folder; what is missing is known to be missing."""

import csv
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple, get_type_hints

import numpy as np

from agents.evaluation import Episode
from agents.study_config import Evaluation, Reach, Row, StudyConfig, wrapped
from agents.study_jobs import DONE, Job, jobs_of, read_stamp, state_of

Array = np.ndarray[Any, Any]


class Group(NamedTuple):
    """All episodes of one row, or of one scripted policy, on the scenes of one split."""

    name: str
    """Of the row, after that of its wrapper if it has one, or of the scripted policy."""
    scene: str
    split: str
    by_seed: dict[int, list[Episode]]
    """In the order of the seeds, each with all scenes in the same order; 0 is the only seed of a scripted policy."""
    is_learned: bool

    @property
    def episodes(self) -> list[Episode]:
        """Return the episodes of all seeds."""
        return [episode for episodes in self.by_seed.values() for episode in episodes]

    def values(self, field: str) -> Array:
        """Return one field of all episodes, (seeds, scenes)."""
        return np.array([[getattr(episode, field) for episode in episodes] for episodes in self.by_seed.values()])


class Curve(NamedTuple):
    """Validations of one training run, and what the run took in all."""

    steps: Array
    """(validations,), as the next three."""
    cpu_seconds: Array
    returns: Array
    success: Array
    total_steps: int
    total_cpu_seconds: float


class Results(NamedTuple):
    """All that there is to report."""

    study: StudyConfig
    states: list[tuple[Job, str, str]]
    """Every job, how it stands, and what went wrong."""
    groups: list[Group]
    curves: dict[str, dict[int, Curve]]
    """By row, then seed; runs that are not done are left out."""
    made: list[dict[str, Any]]
    """With what the results were made: date, versions and machine of every job that is done."""

    def group(self, name: str, scene: str, split: str = "test") -> Group | None:
        """Return the episodes of a row or a scripted policy, None where there are none."""
        wanted = (name, scene, split)
        return next((group for group in self.groups if (group.name, group.scene, group.split) == wanted), None)


def read_results(study: StudyConfig, folder: pathlib.Path) -> Results:
    """Read what is done of a study; only what still fits its stamp counts."""
    states = [(job, *state_of(job)) for job in jobs_of(study, folder)]
    done = [job for job, outcome, _ in states if outcome == DONE]
    curves: dict[str, dict[int, Curve]] = {}
    for job in done:
        if job.played is None and job.seed is not None:
            curves.setdefault(job.row, {})[job.seed] = read_curve(job.place / "progress.csv")
    stamps = (read_stamp(job) for job in done)
    return Results(study, states, _groups([job for job in done if job.played]), curves, [s.made for s in stamps if s])


def _groups(jobs: Sequence[Job]) -> list[Group]:
    """Return evaluations by policy and scenes."""
    groups: dict[tuple[str, str, str], Group] = {}
    for job in jobs:
        assert job.played is not None
        wrapper = job.played.wrapper if isinstance(job.played, Evaluation) else None
        key = (wrapped(wrapper, job.row), job.played.scene, job.played.split)
        group = groups.setdefault(key, Group(*key, {}, job.seed is not None))
        group.by_seed[job.seed or 0] = read_episodes(job.output)
    return list(groups.values())


def read_episodes(path: pathlib.Path) -> list[Episode]:
    """Return the episodes in a file that `agents.evaluation.episodes_as_csv` wrote."""
    parse = {name: (lambda text: text == "True") if kind is bool else kind for name, kind in get_type_hints(Episode).items()}
    with path.open(newline="", encoding="utf-8") as stream:
        return [Episode(**{name: parse[name](text) for name, text in row.items()}) for row in csv.DictReader(stream)]


def read_curve(path: pathlib.Path) -> Curve:
    """Return the validations in the progress.csv of a run."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    validated = [row for row in rows if row["validation_return"]]

    def column(name: str) -> Array:
        return np.array([float(row[name]) for row in validated])

    return Curve(
        column("steps"), column("cpu_seconds"), column("validation_return"), column("validation_success"),
        int(rows[-1]["steps"]), float(rows[-1]["cpu_seconds"]),
    )  # fmt: skip


ABOVE_SCRIPTS = "success less the best script's"
KNOWS_THE_ANSWER = "certificate"
"""The scripted policy that learned ones are not held against."""


class Found(NamedTuple):
    """What was found where something was aimed at."""

    quantity: str
    """Return, success, gap, or ABOVE_SCRIPTS."""
    asked: float
    by_seed: dict[int, float]
    missing: list[int]
    """Seeds that lack a figure."""
    in_every_seed: bool
    by_wrapper: dict[str, dict[int, float]]
    """The same of the same policies in each wrapper of the study, by seed, where they were played so; no aim is reached by it."""

    @property
    def figure(self) -> float:
        """Return what is held against the aim: the mean over seeds, or the worst of them; NaN where there is none."""
        return self._figure(self.by_seed)

    def figure_with(self, wrapper: str) -> float:
        """Return that figure of the policies in a wrapper."""
        return self._figure(self.by_wrapper[wrapper])

    def is_whole_with(self, wrapper: str) -> bool:
        """Return whether the policies of all seeds were played in a wrapper."""
        return len(self.by_wrapper[wrapper]) == len(self.by_seed) + len(self.missing) > 0

    def _figure(self, by_seed: dict[int, float]) -> float:
        """Return the mean over seeds, or the worst of them; NaN where there is none."""
        if not by_seed:
            return float("nan")
        values = np.array(list(by_seed.values()))
        if not self.in_every_seed:
            return float(values.mean())
        return float(values.max() if self.quantity == "gap" else values.min())

    def is_met_by(self, figure: float) -> bool:
        """Return whether a figure would reach the aim."""
        return figure <= self.asked if self.quantity == "gap" else figure >= self.asked

    @property
    def verdict(self) -> str:
        """Return whether the aim is reached."""
        if not self.by_seed:
            return "not measured"
        is_reached = self.is_met_by(self.figure)
        # A worst seed that fails is known to fail; all else waits for the seeds that are missing.
        if self.missing and (is_reached or not self.in_every_seed):
            return "seeds missing"
        return "reached" if is_reached else "not reached"


def found_for(results: Results, row: Row, reach: Reach) -> list[Found]:
    """Return one item for each figure that is aimed at."""
    figures = figures_of(results, row.name, reach.scene)
    others = {wrapper: figures_of(results, wrapped(wrapper, row.name), reach.scene) for wrapper in results.study.wrappers}
    above = 0.0 if reach.is_above_scripts else None
    asked = {"return": reach.mean_return, "success": reach.success, "gap": reach.gap, ABOVE_SCRIPTS: above}
    seeds = results.study.seeds_of(row)
    return [
        Found(
            name, limit, figures[name], [seed for seed in seeds if seed not in figures[name]], reach.in_every_seed,
            {wrapper: found[name] for wrapper, found in others.items()},
        )
        for name, limit in asked.items()
        if limit is not None
    ]


def figures_of(results: Results, name: str, scene: str) -> dict[str, dict[int, float]]:
    """Return all that can be aimed at, by quantity and seed, of a group on test scenes."""
    test = results.group(name, scene)
    return {
        "return": means_by_seed(test, "total_return"),
        "success": means_by_seed(test, "is_success"),
        "gap": gap_by_seed(results, name, scene),
        ABOVE_SCRIPTS: above_scripts(results, test, scene),
    }


def means_by_seed(group: Group | None, field: str) -> dict[int, float]:
    """Return the mean of a field over the scenes, for each seed."""
    return {} if group is None else dict(zip(group.by_seed, group.values(field).mean(axis=1).tolist(), strict=True))


def above_scripts(results: Results, test: Group | None, scene: str) -> dict[int, float]:
    """Return success less that of the best scripted policy that neither simulates ahead nor knows the answer, for each seed.

    Nothing as long as a scripted policy has yet to play: it might be the best.
    """
    scripts = [(job.played.scene, outcome) for job, outcome, _ in results.states if job.played and job.seed is None]
    if any(played == scene and outcome != DONE for played, outcome in scripts):
        return {}
    blind = [
        float(group.values("is_success").mean())
        for group in results.groups
        if (group.scene, group.split, group.is_learned) == (scene, "test", False)
        and group.name != KNOWS_THE_ANSWER
        and not group.values("n_simulated").any()
    ]
    return {seed: value - max(blind) for seed, value in means_by_seed(test, "is_success").items()} if blind else {}


def gap_by_seed(results: Results, name: str, scene: str) -> dict[int, float]:
    """Return mean return on training scenes less that on test scenes, for each seed that played both."""
    test, train = (means_by_seed(results.group(name, scene, split), "total_return") for split in ("test", "train"))
    return {seed: train[seed] - value for seed, value in test.items() if seed in train}
