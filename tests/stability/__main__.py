"""`python -m tests.stability`: run every hard case with every scheme in both precisions, and write docs/stability.md.

Exit codes: 0 all as expected; 1 something is not; 2 wrong arguments; 130 interrupted, with nothing written.
"""

import argparse
import pathlib
import sys
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from gmapspring import machine
from gmapspring.integrators import INTEGRATORS
from gmapspring.paths import write_atomically
from tests.benchmarks.report import number
from tests.stability.cases import CASES, LONG_CASES, Case, Check, Verdict
from tests.stability.page import Outcome, markdown

PAGE = pathlib.Path(__file__).parents[2] / "docs" / "stability.md"
DTYPES = {"float64": np.float64, "float32": np.float32}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases that are asked for and return the exit code."""
    parsed = parser().parse_args(arguments)
    cases = {**CASES, **LONG_CASES}
    try:
        outcomes = run({name: cases[name] for name in parsed.cases or cases}, Console())
    except KeyboardInterrupt:
        print("interrupted; nothing is written", file=sys.stderr)
        return 130
    if not parsed.cases:
        write_atomically(parsed.out, markdown(outcomes, machine.describe(), "python -m tests.stability").encode())
        print(f"the page is {parsed.out}")
    return 0 if all(outcome.verdict.passed for outcome in outcomes) else 1


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    result = argparse.ArgumentParser(
        prog="python -m tests.stability",
        description="Run every hard case with every integrator in both precisions: about ten minutes.",
        epilog='example: python -m tests.stability --cases slivers "a million substeps"',
    )
    names = [*CASES, *LONG_CASES]
    result.add_argument("--cases", nargs="+", choices=names, metavar="NAME",
                        help=f"only these, and write no page: {', '.join(names)}".replace("%", "%%"))  # fmt: skip
    result.add_argument("--out", type=pathlib.Path, default=PAGE, help="the page to write [docs/stability.md]")
    return result


def run(cases: dict[str, Case], console: Console) -> list[Outcome]:
    """Run cases one after the other, printing a line for each verdict."""
    outcomes = []
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task("stability", total=len(cases) * len(INTEGRATORS) * len(DTYPES))
        for name, case in cases.items():
            progress.update(task, description=name)
            for scheme in INTEGRATORS:
                for precision in DTYPES:
                    begin = time.perf_counter()
                    outcome = Outcome(name, scheme, precision, verdict_of(case, scheme, precision))
                    outcomes.append(outcome)
                    show(progress.console, outcome, time.perf_counter() - begin)
                    progress.advance(task)
    return outcomes


def verdict_of(case: Case, scheme: str, precision: str) -> Verdict:
    """Run a case; an error becomes a verdict that says so, and the run goes on."""
    try:
        return case(scheme, DTYPES[precision])
    except Exception as error:
        return Verdict("no error", (Check(f"{type(error).__name__}: {error}", np.nan, 0.0),))


def show(console: Console, outcome: Outcome, seconds: float) -> None:
    """Print a verdict as one line."""
    check = outcome.verdict.tightest
    word = "as expected" if outcome.verdict.passed else "NOT AS EXPECTED"
    text = f"{outcome.case}, {outcome.scheme}, {outcome.precision}: {word}; {check.figure} {number(check.worst)}, at most "
    console.print(f"{text}{number(check.limit)} ({seconds:.1f} s)", highlight=False, markup=False, soft_wrap=True)


if __name__ == "__main__":
    sys.exit(main())
