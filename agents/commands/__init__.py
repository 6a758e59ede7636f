"""The commands of `gmapspring` and `python -m agents`, a file each."""

from agents.commands import (
    bench,
    certify,
    demo,
    evaluate,
    mesh,
    report,
    simulate,
    study,
    train,
    view,
)
from agents.commands.command import Command

COMMANDS: dict[str, Command] = {
    "train": train.COMMAND,
    "evaluate": evaluate.COMMAND,
    "view": view.COMMAND,
    "report": report.COMMAND,
    "study": study.COMMAND,
    "certify": certify.COMMAND,
    "mesh": mesh.COMMAND,
    "simulate": simulate.COMMAND,
    "bench": bench.COMMAND,
    "demo": demo.COMMAND,
}
"""By name, in the order in which help lists them."""
