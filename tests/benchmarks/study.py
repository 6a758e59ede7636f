"""What a study of accuracy says: paragraphs, tables and pictures, written to a folder of its own as soon as it is done."""

import csv
import io
import pathlib
import shutil
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from gmapspring.markdown import as_markdown
from gmapspring.paths import write_atomically

SECTION = "section.md"
"""Text of a finished study, in its folder."""


class Table(NamedTuple):
    """Rows under a caption."""

    caption: str
    """One sentence: what the rows are."""
    rows: Sequence[Mapping[str, Any]]
    """Equal keys, which head the columns; numbers are rounded for the page, and whole in the CSV."""


class Study(NamedTuple):
    """One section of the report."""

    title: str
    text: str
    """Markdown: what was measured and how, and what comes out; every figure in it is formatted from a measured number."""
    tables: Sequence[Table] = ()
    figures: Mapping[str, Figure] = {}
    """Pictures by a short name of their own."""
    hidden: Mapping[str, Sequence[Mapping[str, Any]]] = {}
    """Rows too many for the page, for the CSV alone, by a short name."""


class Plan(NamedTuple):
    """What all studies need to know of the run."""

    is_quick: bool
    """Coarse and short: to see that everything runs, in a minute or two; its figures are not for the page."""
    say: Callable[[str], None]
    """Show a line of progress."""
    folder: pathlib.Path = pathlib.Path("runs/accuracy")
    """Where studies that are done lie, each in a folder of its name: one may go on from another's rows."""


Run = Callable[[Plan], Study]
"""A function that makes a study."""


def write_study(folder: pathlib.Path, key: str, study: Study, about: str) -> None:
    """Write section, CSV files and pictures of a study into folder/key, in place of what was there; about: date and machine."""
    place = folder / key
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    parts = [f"## {study.title}", f"*{about}*", study.text.strip()]
    for name, figure in study.figures.items():
        file = f"accuracy-{key}-{name}.png"
        content = io.BytesIO()
        figure.savefig(content, format="png", dpi=100)
        plt.close(figure)
        write_atomically(place / file, content.getvalue())
        parts.append(f"![{name.replace('-', ' ')}]({file})")
    for number, table in enumerate(study.tables, 1):
        write_atomically(place / f"table-{number}.csv", as_csv(table.rows).encode())
        parts += [table.caption, as_markdown(table.rows)]
    for name, rows in study.hidden.items():
        write_atomically(place / f"{name}.csv", as_csv(rows).encode())
    # Last, so that a section that is there is a whole one.
    write_atomically(place / SECTION, ("\n\n".join(part for part in parts if part) + "\n").encode())


def as_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows with all their digits."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(rows[0]) if rows else ["nothing"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
