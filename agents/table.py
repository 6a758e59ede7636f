"""Tables of results, for the terminal and for Markdown."""

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table

from agents.evaluation import Summary

HEADERS = ("policy", "episodes", "return", "success", "cost/J* of successes", "simulated steps", "steps/s", "ends")
"""Columns of the table of policies; numbers are mean ± standard error (standard deviation over episodes)."""


def summary_rows(summaries: Iterable[Summary]) -> list[tuple[str, ...]]:
    """Return a row per policy, in the order of `HEADERS`."""
    return [
        (
            summary.policy,
            str(summary.n_episodes),
            str(summary.total_return),
            str(summary.success),
            str(summary.cost_ratio),
            str(summary.n_simulated),
            str(summary.steps_per_second),
            ", ".join(f"{count} {reason}" for reason, count in summary.reasons.items()),
        )
        for summary in summaries
    ]


def as_markdown(headers: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table with aligned columns, for people who read the source."""
    table = [list(headers), *(list(row) for row in rows)]
    widths = [max(len(row[column]) for row in table) for column in range(len(headers))]
    lines = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |" for row in table]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines) + "\n"


def print_table(console: Console, title: str, headers: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: drawn on a terminal, as Markdown elsewhere."""
    if not console.is_terminal:
        console.print(f"{title}\n\n{as_markdown(headers, rows)}", highlight=False, markup=False, soft_wrap=True)
        return
    table = Table(title=title)
    for header in headers:
        table.add_column(header)
    for row in rows:
        table.add_row(*row)
    console.print(table)
