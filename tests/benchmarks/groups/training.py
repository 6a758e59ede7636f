"""How fast PPO trains on level 2, by the command that users call."""

import csv
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from gmapspring.paths import configs_folder
from tests.benchmarks.rows import Plan, Row, at_least, failed, reason_of

LEVEL_2 = "box-192"
N_UPDATES, N_WARM = 20, 4
"""Updates that are run, and those at the start that do not count: kernels load, and scenes are settled for the first time."""
TIME_LIMIT = 240.0
"""[s]."""


NAME, ASKED = "PPO training throughput, level 2", at_least(2000.0)


def measure_training(plan: Plan) -> Iterator[Row]:
    """Yield the median throughput of some updates of a run of `python -m agents train`."""
    try:
        rates, note = train(8 if plan.is_quick else N_UPDATES)
    except Exception as error:
        yield failed(NAME, reason_of(error), unit="steps/s", asked=ASKED)
        return
    yield Row(NAME, float(np.median(rates)), "steps/s", float(np.percentile(rates, 10)), float(np.percentile(rates, 90)), ASKED,
              reference="prototype 510 steps/s", note=note)  # fmt: skip


def train(n_updates: int) -> tuple[np.ndarray, str]:
    """Run some updates; return the steps per second of those that count, and what an update is."""
    with tempfile.TemporaryDirectory() as folder:
        config = short_config(n_updates)
        path = Path(folder) / "speed.yaml"
        path.write_text(yaml.safe_dump(config))
        command = [sys.executable, "-m", "agents", "train", str(path), "--out", str(Path(folder) / "run")]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT)
        progress = Path(folder) / "run" / "progress.csv"
        if not progress.exists():
            raise RuntimeError((done.stderr.strip().splitlines() or ["training wrote no progress.csv"])[-1])
        with progress.open(newline="") as stream:
            rates = np.array([float(row["steps_per_second"]) for row in csv.DictReader(stream)])
    counted, settings = rates[min(N_WARM, len(rates) - 1) :], config["ppo"]
    return counted, f"{len(counted)} updates of {settings['n_envs']} environments x {settings['n_steps']} steps, with learning"


def short_config(n_updates: int) -> dict[str, Any]:
    """Return the shipped training set-up of level 2, or that of level 1 on level 2's scene, for some updates only."""
    folder = configs_folder() / "train"
    shipped = folder / f"{LEVEL_2}.yaml"
    config: dict[str, Any] = yaml.safe_load((shipped if shipped.exists() else folder / "box-108.yaml").read_text())
    size = config["ppo"]["n_envs"] * config["ppo"]["n_steps"]
    config["scene"], config["stop"] = LEVEL_2, {"steps": n_updates * size}
    config["validation"] = {"every_updates": 10**6, "episodes": 1}
    return config
