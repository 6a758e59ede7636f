"""`gmapspring report`: write the page of a study."""

import argparse
import pathlib

from rich.console import Console

from agents.commands.command import Command
from gmapspring.errors import ConfigError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("folder", type=pathlib.Path, help="the study's folder")
    parser.add_argument("--publish", action="store_true", help="write the page and its pictures to docs/ as well")


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Write the page of a study."""
    from agents.report import DOCS, write_report

    if parsed.publish and not DOCS.is_dir():
        raise ConfigError(f"there is no {DOCS} to publish to; publish from a clone")
    path = write_report(parsed.folder, DOCS if parsed.publish else None)
    console.print(f"the page is {path}", highlight=False, soft_wrap=True)
    return 0


COMMAND = Command("write the page of a study", "report runs/results", add_arguments, run)
