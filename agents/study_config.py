"""The form of a study: which configurations are trained with which seeds, what they are judged on, and what was aimed at."""

import pathlib
from typing import Annotated, Self

from pydantic import AfterValidator, Field, NonNegativeInt, field_validator, model_validator

from agents.choice import FORESIGHT, SHIELD, home_of, is_saved, is_wrapper
from agents.training_config import MaskName, TrainingConfig
from envs.library import load_scenes
from envs.scene_config import SplitName
from gmapspring.config import Config, closest, load_config
from gmapspring.errors import ConfigError
from gmapspring.paths import config_file, configs_folder

SCRIPTS = "scripts"
"""What stands for all scripted policies where rows are chosen by name."""


def _known_training(name: str) -> str:
    """Return the name of a training configuration, or raise."""
    if not config_file("train", name).is_file():
        known = [path.stem for path in (configs_folder() / "train").glob("*.yaml")]
        raise ValueError(f"there is no training configuration {name!r}; {closest(name, known)}")
    try:
        load_training(name)
    except ConfigError as error:
        raise ValueError(str(error)) from None
    return name


def load_training(name: str) -> TrainingConfig:
    """Return a training configuration by its name or file."""
    return load_config(config_file("train", name), TrainingConfig)


def _known_policy(name: str) -> str:
    """Return the name of a scripted policy, or raise."""
    if is_saved(name):
        raise ValueError(f"{name!r} is no scripted policy; a learned one is evaluated by the row that trains it")
    try:
        home_of(name)
    except ConfigError as error:
        raise ValueError(str(error)) from None
    return name


def _known_wrapper(name: str) -> str:
    """Return the name of what a policy can be wrapped in, or raise."""
    try:
        if is_wrapper(name):
            return name
    except ConfigError as error:
        raise ValueError(str(error)) from None
    raise ValueError(f"{name!r} wraps no policy; give {SHIELD!r} or {FORESIGHT + ':BUDGET'!r}")


def _unique_seeds(seeds: list[int]) -> list[int]:
    """Return seeds, or raise where one is given twice: it would count as two runs."""
    if len(set(seeds)) < len(seeds):
        raise ValueError("a seed is given twice")
    return seeds


Name = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9.-]*$")]
"""What a folder can be called anywhere."""
Seeds = Annotated[list[NonNegativeInt], Field(min_length=1), AfterValidator(_unique_seeds)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class PlayedScenes(Config):
    """Name the scenes that policies are judged on."""

    scene: str
    """Name of a shipped scene, or a scene file."""
    split: SplitName = "test"

    @model_validator(mode="after")
    def _scenes_exist(self) -> Self:
        try:
            load_scenes(self.scene, self.split)
        except ConfigError as error:
            raise ValueError(str(error)) from None
        return self

    @property
    def title(self) -> str:
        """Return scene and split as one word, for files and headings."""
        return f"{pathlib.Path(self.scene).stem}-{self.split}"


class Evaluation(PlayedScenes):
    """Judge every run of a row on the scenes of a split: all test scenes, and as many of another split."""

    mask: MaskName | None = None
    """What counts as legal; what the policy was trained with, if left out."""
    wrapper: Annotated[str, AfterValidator(_known_wrapper)] | None = None
    """What asks the simulator before the policy's cuts are made, `shield` or `foresight:BUDGET`; by default nothing does."""

    @property
    def title(self) -> str:
        """Return scene, split and wrapper as one word, for files and headings; a file's name may hold no colon everywhere."""
        return super().title + (f"-{self.wrapper.replace(':', '-')}" if self.wrapper else "")


class Scripts(PlayedScenes):
    """Let scripted policies play the scenes of a split."""

    mask: MaskName = "all"
    policies: Annotated[list[Annotated[str, AfterValidator(_known_policy)]], Field(min_length=1)]


class Reach(Config):
    """Say what is aimed at: figures over the test scenes of one scene."""

    aim: str
    """In words, for the page."""
    scene: str
    """One that the row is evaluated on."""
    mean_return: Annotated[float | None, Field(alias="return", le=1.0)] = None
    """Least mean return."""
    success: Share | None = None
    """Least share of episodes that free the target and let nothing collapse."""
    gap: Annotated[float | None, Field(ge=0.0)] = None
    """Largest mean return on training scenes less that on test scenes."""
    is_above_scripts: bool = False
    """Whether success must be no less than that of any scripted policy that plays the scene without simulating ahead."""
    in_every_seed: bool = False
    """Whether every seed must reach it, rather than the mean over seeds."""
    remarks: str = ""
    """What was tried and what limits it, for the page, where it is not reached."""

    @model_validator(mode="after")
    def _asks_for_something(self) -> Self:
        if self.mean_return is None and self.success is None and self.gap is None and not self.is_above_scripts:
            raise ValueError("give return, success, gap or is_above_scripts")
        return self


class Row(Config):
    """Train one configuration, once for each seed."""

    name: Name
    train: Annotated[str, AfterValidator(_known_training)]
    """Name of a shipped training configuration, or a file."""
    start_from: str | None = None
    """Row whose best policy, of the same seed, training begins with; a fresh one if left out."""
    ablates: str | None = None
    """Row that this one is, with something left out: alone, it is evaluated on the same scenes and compared with it."""
    seeds: Seeds | None = None
    """Those of the study, if left out."""
    evaluate: list[Evaluation] = []
    reach: list[Reach] = []


class StudyConfig(Config):
    """Describe a study."""

    name: Name
    """Name of the page and its pictures."""
    title: str
    seeds: Seeds
    rows: Annotated[list[Row], Field(min_length=1)]
    """In the order in which they are trained."""
    scripts: list[Scripts] = []

    @field_validator("rows")
    @classmethod
    def _rows_fit_together(cls, rows: list[Row]) -> list[Row]:
        mistakes = [f"{row.name}: {mistake}" for number, row in enumerate(rows) for mistake in _mistakes(row, rows[:number])]
        if mistakes:
            raise ValueError("; ".join(mistakes))
        return rows

    @model_validator(mode="after")
    def _starts_have_the_seeds(self) -> Self:
        for row in self.rows:
            start = self.row(row.start_from or row.name)
            if lacking := set(self.seeds_of(row)) - set(self.seeds_of(start)):
                raise ValueError(f"rows: {row.name} starts from {start.name}, which lacks its seeds {sorted(lacking)}")
        return self

    @model_validator(mode="after")
    def _policies_are_told_apart(self) -> Self:
        names = {row.name for row in self.rows}
        played = [(scripts.title, policy) for scripts in self.scripts for policy in scripts.policies]
        if clash := names & {policy for _, policy in played}:
            raise ValueError(f"scripts: {sorted(clash)} are names of rows too")
        if len(set(played)) < len(played):
            raise ValueError("scripts: a policy plays the same scenes twice")
        return self

    def row(self, name: str) -> Row:
        """Return a row by its name."""
        return next(row for row in self.rows if row.name == name)

    def seeds_of(self, row: Row) -> list[int]:
        """Return the seeds that a row is trained with."""
        return self.seeds if row.seeds is None else row.seeds

    def evaluations_of(self, row: Row) -> list[Evaluation]:
        """Return what a row is evaluated on: an ablation on what the row is that it ablates, always alone."""
        if row.ablates is None:
            return row.evaluate
        return [played for played in self.row(row.ablates).evaluate if played.wrapper is None]

    @property
    def wrappers(self) -> list[str]:
        """Return what policies are wrapped in, in the order in which the rows name it."""
        return list(dict.fromkeys(played.wrapper for row in self.rows for played in row.evaluate if played.wrapper))

    def needed_by(self, names: list[str]) -> set[str]:
        """Return names of rows with those of all rows that they start from.

        Raises:
            ConfigError: there is no such row.
        """
        known = {row.name: row.start_from for row in self.rows} | {SCRIPTS: None}
        for name in names:
            if name not in known:
                raise ConfigError(f"study {self.name!r} has no row {name!r}; {closest(name, known)}")
        needed: set[str] = set()
        for name in names:
            step: str | None = name
            while step is not None:
                needed.add(step)
                step = known[step]
        return needed


def _mistakes(row: Row, earlier: list[Row]) -> list[str]:
    """Return what is wrong with a row, given the rows before it: only to those may it refer."""
    names = {each.name: each for each in earlier}
    found = []
    if row.name in names or row.name == SCRIPTS:
        found.append("the name is taken; choose another")
    for key, name in (("start_from", row.start_from), ("ablates", row.ablates)):
        if name is not None and name not in names:
            found.append(f"{key} names {name!r}, which is no earlier row; {closest(name, names)}")
    if row.ablates is None and not row.evaluate:
        found.append("it is evaluated on nothing; give evaluate")
    if row.ablates is not None and row.evaluate:
        found.append("an ablation is evaluated as the row that it ablates; leave out evaluate")
    if row.ablates in names and names[row.ablates].ablates is not None:
        found.append(f"{row.ablates!r} is an ablation itself")
    titles = [played.title for played in row.evaluate]
    if len(set(titles)) < len(titles):
        found.append("scenes are evaluated on twice")
    plain = {(played.scene, played.split) for played in row.evaluate if played.wrapper is None}
    for reach in row.reach:
        wanted = ["test", "train"] if reach.gap is not None else ["test"]
        found += [f"reach asks for {reach.scene!r}, which is not evaluated on split {split!r}" for split in wanted
                  if (reach.scene, split) not in plain]  # fmt: skip
    return found


def wrapped(wrapper: str | None, name: str) -> str:
    """Return the name of a policy in a wrapper, if there is one."""
    return name if wrapper is None else f"{wrapper}:{name}"


def load_study(name: str) -> StudyConfig:
    """Return a study: a shipped one by its name, or one's own by its file."""
    path = config_file("studies", name)
    if not path.is_file() and path.parent == configs_folder() / "studies":
        known = [each.stem for each in path.parent.glob("*.yaml")]
        raise ConfigError(f"there is no study {name!r}; {closest(name, known)} (or give the path of a .yaml file)")
    return load_config(path, StudyConfig)
