"""`gmapspring certify`: prove that scenes can be solved; the same as `python -m envs.certify`."""

import argparse

from rich.console import Console

from agents.commands.command import Command
from envs import certify


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    certify.add_arguments(parser)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Certify."""
    return certify.carry_out(parsed, console)


COMMAND = Command(
    "find the optimum of scenes, an order of cuts that survives, and the load at which it barely does",
    "certify box-48 --jobs 2\ncertify my-scene.yaml --seed 0",
    add_arguments,
    run,
)
