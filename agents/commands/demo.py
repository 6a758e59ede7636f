"""`gmapspring demo`: the main job, from the mesh of an organ to a trained policy."""

import argparse
import pathlib

from rich.console import Console

from agents.choice import require_torch
from agents.commands.command import Command, count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/demo"), help="folder [runs/demo]")
    parser.add_argument("--train-seconds", type=float, default=180.0, help="CPU time of training [180]")
    parser.add_argument("--seed", type=count, default=0, help="of training [0]")


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Show the whole system at work."""
    require_torch()
    from agents.demo import run_demo

    return run_demo(parsed.out, parsed.train_seconds, parsed.seed, console)


COMMAND = Command("cut a liver, train, compare", "demo --train-seconds 60", add_arguments, run)
