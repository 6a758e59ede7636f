"""`python -m tests.benchmarks.speed`: measure every row, print it, write the table and the picture.

Exit codes: 0 done, whatever was reached; 2 wrong arguments; 130 interrupted, with what was measured kept.
"""

import argparse
import pathlib
import shlex
import sys
import time
from collections.abc import Sequence

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from gmapspring import machine
from tests.benchmarks import report
from tests.benchmarks.registry import GROUPS, TITLES
from tests.benchmarks.rows import Plan, Row, failed, reason_of

DOCS = pathlib.Path(__file__).parents[2] / "docs"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the groups that are asked for and return the exit code."""
    parsed = parser().parse_args(arguments)
    command = shlex.join(["python", "-m", "tests.benchmarks.speed", *(sys.argv[1:] if arguments is None else arguments)])
    names = parsed.rows or list(GROUPS)
    rows: list[Row] = []
    is_whole = run_groups(names, rows, parsed, command)
    if is_whole and parsed.publish:
        publish(rows, command)
    return 0 if is_whole else 130


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.speed",
        description="Measure how fast everything is, in turns with what it is compared with.",
        epilog="example: python -m tests.benchmarks.speed --rows kernel cuts --quick",
    )
    result.add_argument("--rows", nargs="+", choices=list(GROUPS), metavar="NAME", help=f"only these: {', '.join(GROUPS)}")
    result.add_argument("--quick", action="store_true", help="small bodies and few rounds: under two minutes")
    result.add_argument("--out", type=pathlib.Path, default=pathlib.Path("runs/bench"), help="folder [runs/bench]")
    result.add_argument("--publish", action="store_true", help="write docs/speed.md and docs/speed.png as well")
    return result


def run_groups(names: Sequence[str], rows: list[Row], parsed: argparse.Namespace, command: str) -> bool:
    """Measure groups one after the other, writing the report after each; return whether all were done."""
    console, about = Console(), machine.describe()
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("speed", total=len(names))

        def say(text: str) -> None:
            progress.update(task, description=f"{text[:60]}")

        for name in names:
            say(name)
            begin = time.perf_counter()
            try:
                for row in measured_rows(name, Plan(parsed.quick, say)):
                    rows.append(row)
                    show(progress.console, row)
            except KeyboardInterrupt:
                write_out(parsed.out, rows, about, command)
                progress.console.print(f"interrupted in {name}; what was measured is in {parsed.out}")
                return False
            progress.console.print(f"  {name} took {time.perf_counter() - begin:.0f} s", style="dim", highlight=False)
            progress.advance(task)
            report.write_all(parsed.out, rows, about, command, TITLES)
    write_out(parsed.out, rows, about, command)
    console.print(f"the table is {parsed.out / 'speed.md'}, the picture {parsed.out / 'speed.png'}", highlight=False)
    return True


def measured_rows(name: str, plan: Plan):
    """Yield the rows of a group under its name; an error becomes a row that says so, and the run goes on."""
    try:
        for row in GROUPS[name](plan):
            yield named(row, name)
    except Exception as error:
        yield failed(f"{TITLES[name]}: the rest of this group", reason_of(error), group=name)


def named(row: Row, group: str) -> Row:
    """Return a row with its group."""
    return Row(**{**vars(row), "group": group})


def show(console: Console, row: Row) -> None:
    """Print a row as one line."""
    name, asked, measured, spread, verdict, error, _ = report.cells_of(row)
    extra = [part for part in (f"({spread})" if spread else "", f"asked {asked}" if asked else "", verdict.replace("*", ""),
                               f"error {error}" if error else "") if part]  # fmt: skip
    reason = f"  {row.note}" if row.verdict == "not measured" else ""
    console.print(f"{name}: {measured} {'; '.join(extra)}{reason}", highlight=False, markup=False, soft_wrap=True)


def write_out(folder: pathlib.Path, rows: Sequence[Row], about: dict, command: str) -> None:
    """Write the table, and the picture where there is something to draw."""
    report.write_all(folder, rows, about, command, TITLES)
    if any(row.series for row in rows):
        from tests.benchmarks.plot import write_plot

        write_plot(folder / "speed.png", rows)


def publish(rows: Sequence[Row], command: str) -> None:
    """Write the page and the picture of the documentation."""
    from gmapspring.paths import write_atomically
    from tests.benchmarks.plot import write_plot

    text = report.markdown(rows, machine.describe(), command, TITLES)
    write_atomically(DOCS / "speed.md", text.encode())
    write_plot(DOCS / "speed.png", rows)


if __name__ == "__main__":
    sys.exit(main())
