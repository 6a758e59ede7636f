"""The command line, `gmapspring` or `python -m agents`: one entry for all commands, with their messages and exit codes.

Exit codes: 0 done; 1 an error, told in one line; 2 wrong arguments; 130 interrupted, with what was done kept.
"""

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from typing import TextIO

from rich.console import Console

from agents.commands import COMMANDS
from agents.commands.command import Command
from gmapspring.errors import GmapspringError

PROGRAM = "gmapspring"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return the exit code."""
    parsed = _parser().parse_args(arguments)
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        return _guarded(parsed)


def _guarded(parsed: argparse.Namespace) -> int:
    """Run a command; tell an error in one line, unless its traceback is asked for."""
    try:
        # Names of policies have colons in them: foresight:100:NAME means no emoji.
        code: int = parsed.run(parsed, Console(emoji=False))
        sys.stdout.flush()
        return code
    except BrokenPipeError:
        # Whoever read has read enough, as `head` does; the interpreter's own last flush must not complain either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (GmapspringError, OSError) as error:
        if parsed.debug:
            raise
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Tell a warning in one line, without the line of source that raised it."""
    print(f"warning: {message}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        description="Bodies that can be cut exactly, and agents that learn to cut.",
        epilog=_epilog([command.examples.splitlines()[0] for command in COMMANDS.values()]),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--debug", action="store_true", help="show the traceback of an error")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        _add(commands, name, command)
    return parser


def _add(commands: "argparse._SubParsersAction[argparse.ArgumentParser]", name: str, command: Command) -> None:
    """Add the parser of a command."""
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=command.description, description=command.description, epilog=_epilog(command.examples.splitlines()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of an error")
    command.add_arguments(parser)
    parser.set_defaults(run=command.run)


def _epilog(examples: Sequence[str]) -> str:
    """Return the last lines of a help text."""
    return "\n".join(["examples:" if len(examples) > 1 else "example:", *(f"  {PROGRAM} {line}" for line in examples)])
