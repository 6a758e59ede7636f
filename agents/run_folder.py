"""The folder of a training run: what was asked, with what it was made, how it went, and what was learnt.

config.yaml   versions.json   progress.csv   tensorboard/   checkpoints/step-*.zip   best.zip   last.zip
"""

import csv
import io
import json
import os
import pathlib
import platform
import subprocess
from collections.abc import Iterator, Mapping
from importlib import metadata
from typing import Any

import yaml

from agents.training_config import TrainingConfig
from gmapspring.config import read_yaml
from gmapspring.errors import GmapspringError
from gmapspring.paths import write_atomically

PACKAGES = ("gmapspring", "numpy", "numba", "scipy", "gymnasium", "torch", "stable-baselines3", "sb3-contrib")
"""Packages whose versions a run keeps."""


class RunFolderError(GmapspringError, ValueError):
    """A run folder that cannot be used as asked."""


class RunFolder:
    """Read and write the files of one run; every file but progress.csv, which grows, is replaced in one go."""

    def __init__(self, path: pathlib.Path) -> None:
        """Name the folder; nothing is touched yet."""
        self.path = path
        self.best, self.last = path / "best.zip", path / "last.zip"
        self.checkpoints, self.tensorboard = path / "checkpoints", path / "tensorboard"
        self._progress = path / "progress.csv"

    def open(self, config: TrainingConfig, resume: bool) -> None:
        """Start a run, or check that the run that lies here may be resumed under a configuration.

        Raises:
            RunFolderError: there is a run already, there is none to resume, or it had another configuration.
        """
        there = self.path / "config.yaml"
        is_empty = not self.path.exists() or not any(self.path.iterdir())
        if not is_empty and not self.last.exists():
            raise RunFolderError(f"{self.path} holds files and no run to resume; delete it, or choose another --out")
        if resume and is_empty:
            raise RunFolderError(f"{self.path} holds no run to resume; leave out --resume, or give its --out")
        if not resume and not is_empty:
            raise RunFolderError(f"{self.path} is not empty; add --resume to go on with its run, or choose another --out")
        asked = config.model_dump(mode="json")
        if resume and (changes := list(_differences(read_yaml(there), asked))):
            raise RunFolderError(
                f"{self.path} was started with another configuration ({'; '.join(changes)}); choose another --out"
            )
        self.checkpoints.mkdir(parents=True, exist_ok=True)
        write_atomically(there, yaml.safe_dump(asked, sort_keys=False).encode())
        self._write_versions()

    def _write_versions(self) -> None:
        """Note with what the run goes on and, where that was otherwise before, with what it came so far ("before")."""
        path, made = self.path / "versions.json", versions()
        try:
            earlier = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else made
        except ValueError:
            raise RunFolderError(f"{path} is damaged; delete it to go on without what it says of the run so far") from None
        kept = earlier if earlier | made == earlier else made | {"before": earlier}
        write_atomically(path, (json.dumps(kept, indent=1) + "\n").encode())

    def write_progress(self, row: Mapping[str, Any]) -> None:
        """Add a line to progress.csv."""
        is_new = not self._progress.exists()
        with self._progress.open("a", newline="") as stream:
            writer = csv.DictWriter(stream, list(row), lineterminator="\n")
            if is_new:
                writer.writeheader()
            writer.writerow(row)

    def forget_progress_after(self, n_steps: int) -> None:
        """Drop the lines of progress.csv past a step: a resumed run writes them again."""
        if not self._progress.exists():
            return
        with self._progress.open(newline="") as stream:
            reader = csv.DictReader(stream)
            kept = [row for row in reader if int(row["steps"]) <= n_steps]
            fields = reader.fieldnames or []
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, fields, lineterminator="\n")
        writer.writeheader()
        writer.writerows(kept)
        write_atomically(self._progress, text.getvalue().encode())

    def checkpoint(self, n_steps: int) -> pathlib.Path:
        """Return the file of the checkpoint at a step."""
        return self.checkpoints / f"step-{n_steps:010d}.zip"

    def prune(self, n_kept: int) -> None:
        """Delete all but the newest checkpoints."""
        for path in sorted(self.checkpoints.glob("step-*.zip"))[:-n_kept]:
            path.unlink()


def _differences(old: Any, new: Any, path: str = "") -> Iterator[str]:
    """Yield what differs between two configurations, the rule for stopping aside: a resumed run may go on for longer."""
    if path == "stop":
        return
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            yield from _differences(old.get(key), new.get(key), f"{path}.{key}" if path else str(key))
    elif old != new:
        yield f"{path} was {old!r}, now {new!r}"


def versions() -> dict[str, Any]:
    """Return what a result depends on beside its configuration: packages, source revision, machine."""
    found: dict[str, Any] = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = None
    found["revision"] = _revision()
    found["machine"] = {
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
    }
    return found


def _revision() -> str | None:
    """Return the git revision of the source, with + if it was changed since; None outside a clone."""
    folder = pathlib.Path(__file__).resolve().parent
    try:
        command = ["git", "-C", str(folder), "describe", "--always", "--dirty=+", "--exclude=*"]
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _processor() -> str:
    """Return the name of the processor."""
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
