"""`gmapspring study`: train and evaluate all that a study lists."""

import argparse
import os
import pathlib

from rich.console import Console

from agents.choice import require_torch
from agents.commands.command import Command, count, counts


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("study", help="a study: a file, or the name of a shipped one")
    parser.add_argument("--out", type=pathlib.Path, help="folder [runs/NAME]")
    parser.add_argument("--jobs", type=count, default=os.cpu_count() or 1, help="processes at once [as many as cores]")
    parser.add_argument("--only", nargs="+", default=[], metavar="ROW", help="rows, and what they start from; or 'scripts'")
    parser.add_argument("--seeds", type=counts, default=[], help="only these, as in 0,1 [all]")


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Do what a study lists."""
    require_torch()
    from agents.study import Choice, run_study
    from agents.study_config import load_study

    study = load_study(parsed.study)
    out = parsed.out or pathlib.Path("runs") / study.name
    code = run_study(study, out, Choice(parsed.only, parsed.seeds), max(parsed.jobs, 1), console)
    console.print(f"everything is in {out}; gmapspring report {out} writes the page", highlight=False, soft_wrap=True)
    return code


COMMAND = Command(
    "train and evaluate all that a study lists; what is done is kept, what was stopped goes on",
    "study results --jobs 2 --only level-1 --seeds 0,1",
    add_arguments,
    run,
)
