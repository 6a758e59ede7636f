"""What training runs left in their folders, as far as they came; what is missing or cut off is told, not guessed."""

import csv
import io
import json
import pathlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from agents.run_folder import RunFolder
from gmapspring.config import read_yaml
from gmapspring.errors import GmapspringError

Array = np.ndarray[Any, Any]

NEEDED = ("steps", "cpu_seconds", "return", "success", "validation_return", "validation_success")
"""Columns without which a progress.csv tells too little."""
NEARLY = 0.9
"""Share of the CPU time from which a run counts as ended: it starts no update that would overrun the time."""


class RunRecordError(GmapspringError, ValueError):
    """A folder that holds no training run, or one that cannot be read."""


class Run(NamedTuple):
    """One training run."""

    folder: pathlib.Path
    label: str
    """What it is called beside others."""
    config: dict[str, Any]
    """As config.yaml has it."""
    versions: dict[str, Any]
    """As versions.json has it, empty where there is none."""
    progress: dict[str, Array]
    """Columns of progress.csv, (updates,) each; NaN where a cell is empty."""
    remarks: tuple[str, ...]
    """What is missing, and what the page therefore cannot show."""

    @property
    def best(self) -> pathlib.Path:
        """Return the file of the best policy, which may not be there."""
        return RunFolder(self.folder).best

    @property
    def scenes(self) -> list[str]:
        """Return the scenes that it was trained on."""
        scene = self.config["scene"]
        return list(scene) if isinstance(scene, list) else [scene]

    @property
    def validated(self) -> dict[str, Array]:
        """Return the columns of progress.csv at validations alone."""
        is_validated = ~np.isnan(self.progress["validation_return"])
        return {name: column[is_validated] for name, column in self.progress.items()}


def is_run(folder: pathlib.Path) -> bool:
    """Tell whether a folder holds a training run."""
    return (folder / "config.yaml").is_file() and (folder / "progress.csv").is_file()


def read_runs(folders: Sequence[pathlib.Path]) -> list[Run]:
    """Return the runs in some folders, each once, called by as much of their paths as tells them apart.

    Raises:
        RunRecordError: there is none in one of them, or its files are damaged.
    """
    paths = list(dict.fromkeys(folder.resolve() for folder in folders))
    n_parts = 1
    while len({path.parts[-n_parts:] for path in paths}) < len(paths):
        n_parts += 1
    return [_read_run(path, "/".join(path.parts[-n_parts:])) for path in paths]


def _read_run(folder: pathlib.Path, label: str) -> Run:
    """Return one run."""
    if not is_run(folder):
        missing = "config.yaml" if not (folder / "config.yaml").is_file() else "progress.csv"
        raise RunRecordError(
            f"{folder} holds no training run that has got anywhere: there is no {missing}; give the folder of "
            "`python -m agents train ... --out FOLDER`, once its first update is done"
        )
    config = read_yaml(folder / "config.yaml")
    if not isinstance(config, dict) or "scene" not in config:
        raise RunRecordError(f"{folder / 'config.yaml'} is no configuration of a training run: it names no scene")
    progress, remarks = _read_progress(folder / "progress.csv")
    versions = _read_versions(folder / "versions.json")
    run = Run(folder, label, config, versions, progress, ())
    return run._replace(remarks=(*remarks, *_shortcomings(run)))


def _read_versions(path: pathlib.Path) -> dict[str, Any]:
    """Return what versions.json holds; nothing where there is no such file."""
    try:
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (ValueError, OSError):
        raise RunRecordError(f"{path} is damaged; delete it to have the page without versions") from None
    return found if isinstance(found, dict) else {}


def _read_progress(path: pathlib.Path) -> tuple[dict[str, Array], list[str]]:
    """Return the columns of progress.csv, and what is wrong with it."""
    text, remarks = path.read_text(encoding="utf-8", errors="replace"), []
    if text and not text.endswith("\n"):
        text = text[: text.rfind("\n") + 1]
        remarks.append("The last line of `progress.csv` is cut off; it is left out here.")
    reader = csv.reader(io.StringIO(text, newline=""))
    header = next(reader, [])
    if missing := [name for name in NEEDED if header and name not in header]:
        raise RunRecordError(f"{path} is no progress of a training run: it has no column {missing[0]!r}")
    rows = [_numbers(path, number, header, row) for number, row in enumerate(reader, start=2)]
    table = np.array(rows, dtype=np.float64).reshape(-1, len(header) or len(NEEDED))
    if not len(table):
        remarks.append("`progress.csv` holds no update yet: there is no learning to show.")
    return {name: table[:, column] for column, name in enumerate(header or NEEDED)}, remarks


def _numbers(path: pathlib.Path, line: int, header: list[str], row: list[str]) -> list[float]:
    """Return a line of progress.csv as numbers."""
    if len(row) != len(header):
        raise RunRecordError(f"{path}, line {line}: {len(row)} cells under {len(header)} columns; restore the file")
    try:
        return [float(cell) if cell else np.nan for cell in row]
    except ValueError as error:
        raise RunRecordError(f"{path}, line {line}: {error}; restore the file") from None


def _shortcomings(run: Run) -> list[str]:
    """Return what is missing of a run."""
    found, share = [], share_done(run)
    if share < NEARLY:
        found.append(
            f"The run is not at its end: {share:.0%} of what its rule for stopping allows is done. It still goes on, or it was "
            "interrupted; `--resume` goes on with it."
        )
    if len(run.progress["steps"]) and not len(run.validated["steps"]):
        found.append("No validation has been made yet.")
    if not run.best.is_file():
        found.append("There is no `best.zip` yet, so no policy plays here.")
    return found


def share_done(run: Run) -> float:
    """Return how much of what the rule for stopping allows is done, from 0 to 1."""
    if not len(run.progress["steps"]):
        return 0.0
    stop, ppo = run.config.get("stop") or {}, run.config.get("ppo") or {}
    update = ppo.get("n_envs", 0) * ppo.get("n_steps", 0)
    steps, seconds = run.progress["steps"][-1], run.progress["cpu_seconds"][-1]
    shares = [0.0]
    if stop.get("steps"):
        # The last update is the one after which another would overrun.
        shares.append(1.0 if steps + update > stop["steps"] else steps / stop["steps"])
    if stop.get("cpu_seconds"):
        shares.append(seconds / stop["cpu_seconds"])
    return float(min(max(shares), 1.0))
