"""`gmapspring train`: train a policy by PPO."""

import argparse
import pathlib
import sys

from rich.console import Console

from agents.choice import require_torch
from agents.commands.command import Command, add_json, count, print_json, say
from agents.progress import ProgressReport
from gmapspring.config import load_config
from gmapspring.paths import config_file


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("config", help="a training configuration: a file, or the name of a shipped one")
    parser.add_argument("--seed", type=count, help="replaces the configuration's seed")
    parser.add_argument("--cpu-seconds", type=float, help="replaces the configuration's CPU time")
    parser.add_argument("--start-from", type=pathlib.Path, metavar="ZIP", help="begin with the weights of a saved policy")
    parser.add_argument("--warm-start", choices=("bc", "none"), help="clone the certificates before, or do not [as configured]")
    parser.add_argument("--out", type=pathlib.Path, help="run folder [runs/CONFIG-seed-SEED]")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    add_json(parser)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Train, and say where the result lies."""
    require_torch()
    from agents.training import Trainer
    from agents.training_config import TrainingConfig

    console = say(parsed)
    path = config_file("train", parsed.config)
    config = load_config(path, TrainingConfig).replaced(parsed.seed, parsed.cpu_seconds, parsed.warm_start)
    out = parsed.out or pathlib.Path("runs") / f"{path.stem}-seed-{config.seed}"
    trainer = Trainer(config, out, start=parsed.start_from, resume=parsed.resume)
    with ProgressReport(console, f"training {path.stem}") as report:
        result = trainer.run(report)
    if result.signal is not None:
        print(f"interrupted at step {result.n_steps}: what was learnt is in {out}; go on with --resume", file=sys.stderr)
        return 128 + result.signal
    if parsed.json:
        print_json(result._asdict() | {"policy": str(out / "best.zip")})
        return 0
    console.print(
        f"{result.n_steps} steps in {result.cpu_seconds:.0f} CPU seconds; best validation return "
        f"{result.best_return:.3f}; the policy is {out / 'best.zip'}",
        highlight=False,
        soft_wrap=True,
    )
    return 0


COMMAND = Command(
    "train a policy by PPO",
    "train box-108 --seed 1 --out runs/box-108\ntrain box-108 --out runs/box-108 --resume --cpu-seconds 400",
    add_arguments,
    run,
)
