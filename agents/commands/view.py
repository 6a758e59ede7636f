"""`gmapspring view`: a body in the browser, to be cut by hand, watched and played back."""

import argparse
import pathlib
from dataclasses import fields

from rich.console import Console

from agents.commands.command import Command, count


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments; what is left out comes from the recording, or else from the policy's own scene."""
    parser.add_argument("--scene", help="a shipped scene or a scene file [the recording's or policy's own, or box-108]")
    parser.add_argument("--split", help="train, validation or test [train]")
    parser.add_argument("--mask", help="all, reachable or focus [all]")
    parser.add_argument("--scene-seed", type=count, metavar="SEED", help="which scene, by its seed [the first]")
    parser.add_argument("--index", type=count, help="which scene, by its place in the split")
    parser.add_argument("--policy", help="who gives hints: any name or file that evaluate takes [lookahead]")
    parser.add_argument("--play", type=pathlib.Path, metavar="RECORDING", help="play back a recorded episode")
    parser.add_argument("--recordings", type=pathlib.Path, metavar="FOLDER", help="where to keep recordings [runs/recordings]")
    parser.add_argument("--host", help="address to serve at [127.0.0.1: this machine alone]")
    parser.add_argument("--port", type=count, help="port to serve at, 0 for any that is free [8080]")
    parser.add_argument("--seed", type=count, help="of what is random in policies [0]")


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Serve the page until Ctrl-C."""
    from agents.page import ViewOptions, serve

    given = {each.name: getattr(parsed, each.name) for each in fields(ViewOptions)}
    return serve(ViewOptions(**{name: value for name, value in given.items() if value is not None}))


COMMAND = Command(
    "cut a body in the browser, see what policies would do, play episodes back, record your own",
    "view --scene liver\nview --policy runs/box-108/best.zip\nview --play runs/recordings/box-108-train-0-1.json --port 0",
    add_arguments,
    run,
)
