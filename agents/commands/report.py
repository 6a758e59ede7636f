"""`gmapspring report`: write the page of a study, or of training runs."""

import argparse
import pathlib

from rich.console import Console

from agents.commands.command import Command, positive
from agents.progress import ProgressReport
from gmapspring.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folders", nargs="+", type=pathlib.Path, metavar="FOLDER", help="a study, or one or more training runs")
    parser.add_argument("--publish", action="store_true", help="write a study's page and its pictures to docs/ as well")
    parser.add_argument("--out", type=pathlib.Path, metavar="HTML", help="page of runs [report.html in the folder they share]")
    parser.add_argument("--episodes", type=positive, help="test scenes that each run's best policy plays for the page [16]")
    parser.add_argument("--all-episodes", action="store_true", help="let it play all of them")


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Write the page."""
    from agents.study_jobs import STUDY_FILE

    studies = [folder for folder in parsed.folders if (folder / STUDY_FILE).is_file()]
    if studies and len(parsed.folders) > 1:
        raise ConfigError(f"{studies[0]} holds a study, which has a page of its own: give it alone, or leave it out")
    for folder in parsed.folders:
        if not studies and not (folder / "config.yaml").is_file():
            raise ConfigError(f"{folder} holds no study and no training run; give the --out of gmapspring study or train")
    path = _study_page(parsed) if studies else _run_page(parsed, console)
    console.print(f"the page is {path}", highlight=False, soft_wrap=True)
    return 0


def _study_page(parsed: argparse.Namespace) -> pathlib.Path:
    """Write the page of a study."""
    from agents.report import DOCS, write_report

    if parsed.publish and not DOCS.is_dir():
        raise ConfigError(f"there is no {DOCS} to publish to; publish from a clone")
    return write_report(parsed.folders[0], DOCS if parsed.publish else None)


def _run_page(parsed: argparse.Namespace, console: Console) -> pathlib.Path:
    """Write the page of training runs."""
    from agents.run_episodes import N_EPISODES
    from agents.run_report import write_run_report

    if parsed.publish:
        raise ConfigError("--publish is for studies; the page of runs stays with them")
    n_episodes = None if parsed.all_episodes else parsed.episodes or N_EPISODES
    with ProgressReport(console, "playing") as report:
        return write_run_report(parsed.folders, parsed.out, n_episodes, on_progress=report.update)


COMMAND = Command(
    "write the page of a study, or one self-contained page about training runs",
    "report runs/results\nreport runs/box-108\nreport runs/box-108-seed-0 runs/box-108-seed-1 --out runs/both.html",
    add_arguments,
    run,
)
