"""What the baseline must reach: level 1, held-out scenes, one core, 200 CPU seconds, in each of three seeds."""

import time

import pytest
from rich.console import Console

from agents.choice import make_policy
from agents.evaluation import evaluate, summarise
from agents.progress import ProgressReport
from agents.training import Trainer
from agents.training_config import TrainingConfig
from envs.resect import ResectEnv
from gmapspring.config import load_config
from gmapspring.paths import configs_folder

CPU_SECONDS = 200.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_the_baseline_learns_level_1(seed, tmp_path, capsys):
    config = load_config(configs_folder() / "train" / "box-108.yaml", TrainingConfig).replaced(seed, CPU_SECONDS)
    trainer = Trainer(config, tmp_path / "run", cpu_start=time.process_time())
    with ProgressReport(Console(), f"seed {seed}") as report:
        trainer.run(report)
    env = ResectEnv(config.scene, "test", config.mask)
    summary = summarise(evaluate(make_policy(str(tmp_path / "run" / "best.zip"), env, seed), env, name="PPO", seed=seed))
    with capsys.disabled():
        print(f"\nseed {seed}: return {summary.total_return.mean:.3f}, success {summary.success.mean:.3f}")
    assert summary.total_return.mean >= 0.55
    assert summary.success.mean >= 0.80
