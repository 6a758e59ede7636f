"""The main job on real input: cut a liver, train a policy, compare it with the scripted ones."""

import pathlib
import shutil
import sys
import time

from rich.console import Console

from agents.choice import make_policy
from agents.demo_cut import cut_liver
from agents.evaluation import Episode, Summary, episodes_as_csv, evaluate, summarise
from agents.progress import ProgressReport
from agents.scripted import POLICIES
from agents.table import HEADERS, as_markdown, print_table, summary_rows
from agents.training import Trainer, TrainingResult
from agents.training_config import TrainingConfig
from envs.resect import ResectEnv
from gmapspring.config import load_config
from gmapspring.paths import configs_folder, write_atomically

CONFIG = "box-108"
"""Training configuration of the demo."""
LEARNED, AHEAD = "PPO", "foresight:100:"
"""What the table calls the learned policy, and what stands before that where it may also look ahead."""


def run_demo(folder: pathlib.Path, train_seconds: float, seed: int, console: Console) -> int:
    """Run the three parts; everything lands in the folder. Return the exit code."""
    folder.mkdir(parents=True, exist_ok=True)
    config = load_config(configs_folder() / "train" / f"{CONFIG}.yaml", TrainingConfig).replaced(seed, train_seconds)
    _head(console, "1. A liver is cut")
    cut_liver(folder, console)
    _head(console, f"2. A policy is trained on {config.scenes[0]}, for {train_seconds:.0f} CPU seconds")
    result = _train(folder / "training", config, console)
    if result.signal is not None:
        print(f"interrupted: what was learnt is in {folder / 'training'}", file=sys.stderr)
        return 128 + result.signal
    _head(console, "3. It plays scenes that it has never seen, beside the scripted policies")
    compare(folder, config, seed, console)
    return 0


def compare(folder: pathlib.Path, config: TrainingConfig, seed: int, console: Console) -> None:
    """Evaluate the trained policy, alone and looking ahead, and all scripted ones on the test scenes; write the table."""
    best = str(folder / "training" / "best.zip")
    names = {LEARNED: best, AHEAD + LEARNED: AHEAD + best} | {name: name for name in POLICIES}
    env = ResectEnv(config.scenes[0], "test", config.mask)
    episodes: list[Episode] = []
    summaries: list[Summary] = []
    with ProgressReport(console, "evaluating") as report:
        for shown, name in names.items():
            played = evaluate(make_policy(name, env, seed), env, name=shown, seed=seed)
            episodes += played
            summaries.append(summarise(played))
            report.update(len(summaries) / len(names), shown)
    summaries.sort(key=lambda summary: -summary.total_return.mean)
    rows = summary_rows(summaries)
    print_table(console, f"{config.scenes[0]}, test scenes: mean ± standard error (standard deviation)", HEADERS, rows)
    write_atomically(folder / "table.md", as_markdown(HEADERS, rows).encode())
    write_atomically(folder / "table.csv", episodes_as_csv(episodes).encode())
    places = f"The table: {folder / 'table.md'}; every episode: {folder / 'table.csv'}"
    console.print(places, highlight=False, soft_wrap=True)


def _train(run: pathlib.Path, config: TrainingConfig, console: Console) -> TrainingResult:
    """Train from scratch; what an earlier demo left is deleted."""
    if (run / "config.yaml").exists():
        shutil.rmtree(run)
    trainer = Trainer(config, run, cpu_start=time.process_time())
    with ProgressReport(console, "training") as report:
        result = trainer.run(report)
    done = f"{result.n_steps} steps in {result.cpu_seconds:.0f} CPU seconds; everything about it: {run}"
    console.print(done, highlight=False, soft_wrap=True)
    return result


def _head(console: Console, title: str) -> None:
    """Print the title of a part."""
    console.print(f"\n[bold]{title}[/bold]\n", highlight=False)
