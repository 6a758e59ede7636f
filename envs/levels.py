"""What the shipped levels are like: `python -m envs.levels --publish` measures them and writes docs/levels.md.

Exit codes: 0 done; 2 wrong arguments or a scene without certificates; 130 interrupted, with nothing written.
"""

import argparse
import pathlib
import sys
from collections.abc import Callable, Sequence

from rich.console import Console

from envs.level_rows import Effort, Row, baseline_row, certificate_row, effort_for, level_row, order_row, sampled_scenes
from envs.library import load_scenes, shipped_scenes
from gmapspring import machine
from gmapspring.errors import GmapspringError
from gmapspring.markdown import as_markdown
from gmapspring.paths import write_atomically

DOCS = pathlib.Path(__file__).parents[1] / "docs"
PAGE = "levels.md"
LEVELS = (
    "A seed is rejected where no certificate is found; `python -m envs.certify` says how it is searched. Examined are the seeds "
    "from the first of each split up to the last that it needed."
)
CERTIFICATES = (
    "Over all splits. The load of each scene is its traction times the load factor, set so that the certificate's peak strain is "
    "κ times the limit: its spread is that of the bodies' strength. J\\* is in units of h²."
)
ORDERS = (
    "Orders of the cheapest cuts of some test scenes, drawn at random once and for all, that the body stands to the end. Where "
    "the cuts are few, all orders are counted, by dynamic programming over sets of cuts: the settled body is taken to depend on "
    "which cuts are done and not on their order. That holds up to what a settling leaves undone, and up to tissue that has more "
    "than one way to hang; so random orders are carried out cut by cut, and their strains and labels (the body stands, or not) "
    "are compared with those that were taken for the same set of cuts. Elsewhere random orders are tried. The mean over scenes "
    "comes with its standard error. The certificate's peak strain is compared with the least that any order has by that count, "
    "and with that of the order which is gentlest by it, carried out from the start: 1, up to the same errors, where no order is "
    "gentler than the certificate's."
)
BASELINES = (
    "Mean return, with its standard error over the same scenes; the certificate's is 1. *random*: any legal action; *rim-first*: "
    "the face round the target that is farthest from the middle of these; *lever-first*: the one that is farthest from the line "
    "along which the load pulls on the target, as the body hangs; *min-cut-index*: the cheapest cuts in the order of their ids."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure what is asked for and return the exit code."""
    parsed = parser().parse_args(arguments)
    console = Console()
    try:
        with console.status("levels") as status:
            text = page(parsed.scenes or shipped_scenes(), effort_for, lambda name: status.update(f"measuring {name}"))
    except GmapspringError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("interrupted; nothing is written", file=sys.stderr)
        return 130
    path = (DOCS if parsed.publish else parsed.out) / PAGE
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text.encode())
    console.print(f"the page is {path}", highlight=False, soft_wrap=True)
    return 0


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="python -m envs.levels",
        description="Measure the shipped levels: certificates, margins, how many orders of the cuts survive, what rules earn.",
        epilog="example: python -m envs.levels box-48 box-108",
    )
    result.add_argument("scenes", nargs="*", metavar="SCENE", help="only these [all that are shipped]")
    result.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/levels"), help="folder [runs/levels]")
    result.add_argument("--publish", action="store_true", help="write docs/levels.md instead; in a clone")
    return result


def page(names: Sequence[str], effort_of: Callable[[int], Effort], say: Callable[[str], None] = lambda name: None) -> str:
    """Return the page, measured now; effort_of: how much to play, by the number of tetrahedra; say: show progress."""
    sections: list[tuple[str, str, list[Row]]] = [
        ("Levels", LEVELS, []), ("Certificates", CERTIFICATES, []), ("Orders", ORDERS, []), ("Simple rules", BASELINES, []),
    ]  # fmt: skip
    for name in names:
        say(name)
        effort = effort_of(load_scenes(name, "test")[0].mesh.n_tetrahedra)
        scenes = sampled_scenes(name, effort.n_scenes)
        rows = level_row(name), certificate_row(name), order_row(name, scenes, effort), baseline_row(name, scenes)
        for (_, _, section_rows), row in zip(sections, rows, strict=True):
            section_rows.append(row)
    head = [
        "# Levels",
        "This page is generated by `python -m envs.levels --publish`; do not edit it.",
        f"{machine.in_a_line(('gmapspring', 'numpy', 'numba', 'scipy', 'gymnasium'))}.",
    ]
    parts = [part for title, text, rows in sections for part in (f"## {title}", text, as_markdown(rows))]
    return "\n\n".join([*head, *parts]) + "\n"


if __name__ == "__main__":
    sys.exit(main())
