"""What a command is: what it is for, an example that can be run, its arguments and what it does; and kinds of arguments."""

import argparse
import json
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from rich.console import Console


class Command(NamedTuple):
    """One command; it imports what it needs, such as torch, only when it runs."""

    description: str
    """What it does, in a line."""
    examples: str
    """Commands that can be run, one on each line, without the program's name."""
    add_arguments: Callable[[argparse.ArgumentParser], None]
    """Declare the arguments."""
    run: Callable[[argparse.Namespace, Console], int]
    """Do it; return the exit code."""


def count(text: str) -> int:
    """Return a whole number from 0 up."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 0 up")
    return int(text)


def positive(text: str) -> int:
    """Return a whole number from 1 up."""
    if not count(text):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return int(text)


def counts(text: str) -> list[int]:
    """Return whole numbers from 0 up, parted by commas."""
    return [count(part) for part in text.split(",")]


def number(text: str) -> float:
    """Return a finite number from 0 up."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number from 0 up")
    return value


def add_json(parser: argparse.ArgumentParser) -> None:
    """Let a command print its result for a script to read."""
    parser.add_argument("--json", action="store_true", help="print the result as JSON, and nothing else on standard output")


def say(parsed: argparse.Namespace) -> Console:
    """Return where a command that may print JSON tells how it goes: standard error where it does."""
    return Console(stderr=parsed.json, emoji=False)


def print_json(result: Any) -> None:
    """Print a result as JSON; what is not a number there is null."""
    print(json.dumps(_without_nan(result), indent=1))


def _without_nan(value: Any) -> Any:
    """Return a value in which no number is NaN or infinite, which JSON does not know."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
