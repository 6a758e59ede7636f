"""The jobs of a study, one command each; what they depend on, and how they stand.

A study's folder:

    study.yaml                                   what was asked
    ROW/seed-S/                                  run folder of a training, see `agents.run_folder`
    ROW/seed-S.json  .log                        stamp of the training, and what it printed
    ROW/seed-S/evaluation/SCENE-SPLIT.csv        a line per episode of its best policy
    scripts/POLICY/SCENE-SPLIT.csv               the same of a scripted one
    .../SCENE-SPLIT.json  .log                   stamp of an evaluation, and what it printed

A stamp holds all that a result depends on, with a hash of every file that was read: a result counts only while its stamp still
fits, so that a policy that was trained further is evaluated anew, and nothing is done twice.
"""

import hashlib
import json
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

from agents.study_config import SCRIPTS, Evaluation, PlayedScenes, Row, Scripts, StudyConfig, load_training, wrapped
from envs.library import certificate_path, load_scene_config, load_scenes
from gmapspring.paths import write_atomically

STUDY_FILE = "study.yaml"
DONE, FAILED, UNFINISHED, OUTDATED, MISSING = "done", "failed", "unfinished", "outdated", "missing"
"""How a job may stand; outdated: done, but what it depends on has changed since."""
USUAL_SECONDS = 60.0
"""How long a job is taken to last where nothing says so, for the bar alone [s]."""


class Job(NamedTuple):
    """One command of a study."""

    row: str
    """Name of the row, or of the scripted policy."""
    seed: int | None
    """Of a training and its evaluations; None for a scripted policy."""
    played: PlayedScenes | None
    """What is evaluated on, None for a training."""
    arguments: tuple[str, ...]
    """After `python -m agents`."""
    output: pathlib.Path
    """What it is for: the file without which it is not done."""
    place: pathlib.Path
    """Stamp and log lie here, with .json and .log at the end."""
    facts: dict[str, Any]
    """What the result depends on beside files."""
    files: tuple[pathlib.Path, ...]
    """Files that the result depends on."""
    needs: str | None = None
    """Name of the job that must be done before."""
    seconds: float = USUAL_SECONDS
    """How long it may last, for the bar alone [s]."""

    @property
    def name(self) -> str:
        """Return a name that no other job of the study has."""
        start = f"{SCRIPTS}/{self.row}" if self.seed is None else f"{self.row}/seed-{self.seed}"
        return f"{start}/{self.played.title}" if self.played else start

    @property
    def log(self) -> pathlib.Path:
        """Return the file of what it prints."""
        return self.place.with_name(self.place.name + ".log")

    @property
    def stamp(self) -> pathlib.Path:
        """Return the file of its stamp."""
        return self.place.with_name(self.place.name + ".json")


class Stamp(NamedTuple):
    """What is written down about a job."""

    inputs: dict[str, Any]
    """What the result depends on."""
    outcome: str
    """Done, failed or unfinished."""
    message: str
    """What went wrong, else empty."""
    made: dict[str, Any]
    """Date, versions and machine."""


def jobs_of(study: StudyConfig, folder: pathlib.Path) -> list[Job]:
    """Return all jobs of a study, in the order in which they are done."""
    jobs: list[Job] = []
    for row in study.rows:
        for seed in study.seeds_of(row):
            training = _training(row, seed, folder)
            jobs += [training, *(_judging(training, played) for played in study.evaluations_of(row))]
    for scripts in study.scripts:
        for policy in scripts.policies:
            # A folder's name may hold no colon everywhere.
            csv = folder / SCRIPTS / policy.replace(":", "-") / f"{scripts.title}.csv"
            jobs.append(_evaluation(policy, policy, None, scripts, csv))
    return jobs


def _training(row: Row, seed: int, folder: pathlib.Path) -> Job:
    """Return the training of a row with a seed."""
    place = folder / row.name / f"seed-{seed}"
    config = load_training(row.train)
    arguments = ["train", row.train, "--seed", str(seed), "--out", str(place)]
    start = folder / row.start_from / f"seed-{seed}" if row.start_from else None
    if start:
        arguments += ["--start-from", str(start / "best.zip")]
    facts = {"config": config.model_dump(mode="json"), "scenes": [_facts_of(scene) for scene in config.scenes]}
    recordings = config.warm_start.recordings or () if config.warm_start else ()
    files = (*_files_of(config.scenes), *map(pathlib.Path, recordings), *((start / "best.zip",) if start else ()))
    needs, seconds = f"{row.start_from}/seed-{seed}" if start else None, config.stop.cpu_seconds or USUAL_SECONDS
    return Job(row.name, seed, None, tuple(arguments), place / "best.zip", place, facts, files, needs, seconds)


def _facts_of(scene: str) -> dict[str, Any]:
    """Return what a result depends on of a scene's configuration; where its files lie does not matter."""
    return load_scene_config(scene).model_dump(mode="json", exclude={"splits": True, "mesh": {"path"}}, exclude_unset=True)


def _files_of(scenes: Sequence[str]) -> tuple[pathlib.Path, ...]:
    """Return the files that scenes are made of beside their configurations."""
    configs = [load_scene_config(scene) for scene in scenes]
    meshes = [pathlib.Path(path) for config in configs if (path := getattr(config.mesh, "path", None))]
    return (*map(certificate_path, scenes), *meshes)


def _judging(training: Job, played: Evaluation) -> Job:
    """Return an evaluation of what a training has made."""
    csv = training.place / "evaluation" / f"{played.title}.csv"
    policy = wrapped(played.wrapper, str(training.output))
    return _evaluation(training.row, policy, training, played, csv)


def _evaluation(row: str, policy: str, training: Job | None, played: Evaluation | Scripts, csv: pathlib.Path) -> Job:
    """Return the evaluation of a policy, learned (by a training) or scripted, into a file."""
    n_episodes = len(load_scenes(played.scene, played.split))
    if played.split != "test":
        # As many as there are test scenes, for a comparison of like with like.
        n_episodes = min(n_episodes, len(load_scenes(played.scene, "test")))
    facts = {
        "scene": played.scene,
        "split": played.split,
        "mask": played.mask,
        "episodes": n_episodes,
        "config": _facts_of(played.scene),
    }
    arguments = ["evaluate", policy, "--scene", played.scene, "--split", played.split, "--episodes", str(n_episodes)]
    arguments += ["--out", str(csv), *(["--mask", played.mask] if played.mask else [])]
    files = (*_files_of([played.scene]), *((training.output,) if training else ()))
    needs, seed = (training.name, training.seed) if training else (None, None)
    return Job(row, seed, played, tuple(arguments), csv, csv.with_suffix(""), facts, files, needs)


# Stamps -----------------------------------------------------------------------------------------------------------


def inputs_of(job: Job) -> dict[str, Any]:
    """Return what the result of a job depends on, as it stands now."""
    hashes = [hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else None for path in job.files]
    return {"facts": job.facts, "files": hashes}


def read_stamp(job: Job) -> Stamp | None:
    """Return the stamp of a job, None where there is none or it is not readable."""
    try:
        return Stamp(**json.loads(job.stamp.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None


def write_stamp(job: Job, stamp: Stamp) -> None:
    """Write down how a job stands."""
    job.stamp.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(job.stamp, (json.dumps(stamp._asdict(), indent=1) + "\n").encode())


def state_of(job: Job) -> tuple[str, str]:
    """Return how a job stands, one of the words above, and what went wrong."""
    stamp = read_stamp(job)
    if stamp is None or (stamp.outcome == DONE and not job.output.is_file()):
        return MISSING, ""
    if stamp.outcome != DONE:
        return stamp.outcome, stamp.message
    # By way of JSON, as the stamp is: it knows no tuples.
    is_same = stamp.inputs == json.loads(json.dumps(inputs_of(job)))
    return (DONE, "") if is_same else (OUTDATED, "")
