"""Pages that stand alone: one file of HTML with its pictures inside, and the same in Markdown; all text is escaped."""

import base64
import html
import re
from collections.abc import Sequence
from typing import NamedTuple

from agents.report_tables import Table
from agents.table import as_markdown

STYLE = """
:root { color-scheme: light dark; --paper: #fbfbfa; --ink: #1d2329; --faint: #5d6873; --line: #dcdfe2; --card: #f1f2f1;
  --accent: #0f766e; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #15191d; --ink: #e4e7ea; --faint: #98a3ad; --line: #333b43; --card: #1f252b; --accent: #5eead4; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 68rem; padding: 3rem 1.5rem 5rem; background: var(--paper); color: var(--ink);
  font: 1rem/1.6 system-ui, "Segoe UI", "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 2rem; line-height: 1.2; letter-spacing: -0.02em; margin: 0 0 1rem; }
h2 { font-size: 1.3rem; letter-spacing: -0.01em; margin: 3rem 0 0.75rem; padding-top: 1rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: 0.75rem 0; }
p.remark { border-left: 3px solid #d9773a; padding: 0.3rem 0 0.3rem 0.9rem; }
code { font: 0.9em ui-monospace, "SF Mono", Menlo, Consolas, monospace; background: var(--card); padding: 0.1em 0.3em;
  border-radius: 4px; }
dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); gap: 0.75rem; margin: 1.5rem 0; }
dl div { background: var(--card); border-radius: 8px; padding: 0.8rem 1rem; }
dt { color: var(--faint); font-size: 0.8rem; } dd { margin: 0; font-size: 1.35rem; font-weight: 600; }
.wide { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: 0.88rem; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: 0.35rem 1.1rem 0.35rem 0; border-bottom: 1px solid var(--line);
  overflow-wrap: break-word; }
th { color: var(--faint); font-weight: 600; vertical-align: bottom; line-height: 1.3; border-bottom-color: var(--faint); }
td:first-child { white-space: nowrap; }
td.number, th.number { text-align: right; }
figure { margin: 1.5rem 0; } figcaption { color: var(--faint); font-size: 0.88rem; max-width: 46rem; margin-top: 0.4rem; }
figure svg { display: block; width: 100%; height: auto; } svg * { stroke-linejoin: round; stroke-linecap: butt; }
.strip { display: flex; flex-wrap: wrap; gap: 0.6rem; }
.strip div { flex: 1 1 8rem; max-width: 13rem; color: var(--faint); font-size: 0.8rem; }
.strip img { display: block; width: 100%; border-radius: 8px; }
summary { cursor: pointer; color: var(--accent); margin: 0.35rem 0; }
"""
"""Light or dark, as the reader's system has it."""

NUMBER = re.compile(r"[-+−]?[\d.,]+(e[-+]?\d+)?( ?%| s)?|[-–]|nan")
"""What makes a column of numbers, which is set to the right."""


class Heading(NamedTuple):
    """The title of a section."""

    title: str


class Text(NamedTuple):
    """A paragraph; a remark is one that stands out."""

    words: str
    is_remark: bool = False


class Facts(NamedTuple):
    """A few figures in large type."""

    pairs: Sequence[tuple[str, str]]
    """(what, how much) each."""


class Folded(NamedTuple):
    """A table that is seen once its title is clicked on."""

    title: str
    table: Table


class Figure(NamedTuple):
    """A drawing."""

    svg: str
    """The element, from `<svg` on; it is not escaped."""
    caption: str


class Strip(NamedTuple):
    """Pictures in a row."""

    frames: Sequence[tuple[bytes, str]]
    """(PNG file, what is under it) each."""
    caption: str


Block = Heading | Text | Facts | Table | Folded | Figure | Strip


def as_page(title: str, blocks: Sequence[Block]) -> str:
    """Return a page of HTML that needs no other file and no network."""
    body = "\n".join(_element(block) for block in blocks)
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{html.escape(title)}</title>\n'
        f"<style>{STYLE}</style>\n</head>\n<body>\n<h1>{html.escape(title)}</h1>\n{body}\n</body>\n</html>\n"
    )


def as_markdown_page(title: str, blocks: Sequence[Block]) -> str:
    """Return the words and tables of a page as Markdown; of pictures only what stands under them."""
    parts = [f"# {_plain(title)}", *(_paragraph(block) for block in blocks)]
    return "\n\n".join(part.strip() for part in parts if part) + "\n"


def _element(block: Block) -> str:
    """Return a block as HTML."""
    match block:
        case Heading(title):
            return f"<h2>{html.escape(title)}</h2>"
        case Text(words, is_remark):
            kind = ' class="remark"' if is_remark else ""
            return f"<p{kind}>{_inline(words)}</p>"
        case Facts(pairs):
            items = (f"<div><dt>{html.escape(what)}</dt><dd>{html.escape(value)}</dd></div>" for what, value in pairs)
            return f"<dl>{''.join(items)}</dl>"
        case Folded(title, table):
            return f"<details><summary>{html.escape(title)}</summary>{_table(table)}</details>"
        case Figure(svg, caption):
            return f"<figure>{svg}<figcaption>{_inline(caption)}</figcaption></figure>"
        case Strip(frames, caption):
            shown = "".join(_image(*frame) for frame in frames)
            return f'<figure><div class="strip">{shown}</div><figcaption>{_inline(caption)}</figcaption></figure>'
        case _:
            return _table(block)


def _image(png: bytes, label: str) -> str:
    """Return a picture with its label, the file inside."""
    words = html.escape(label)
    return f'<div><img alt="{words}" src="data:image/png;base64,{base64.b64encode(png).decode()}">{words}</div>'


def _table(table: Table) -> str:
    """Return a table; columns of numbers are set to the right."""
    columns = list(zip(*table.rows, strict=True))
    marks = [' class="number"' if all(NUMBER.fullmatch(cell) for cell in column) else "" for column in columns]
    marks = marks or [""] * len(table.headers)
    head = "".join(f"<th{mark}>{_inline(cell)}</th>" for mark, cell in zip(marks, table.headers, strict=True))
    lines = ("".join(f"<td{mark}>{_inline(cell)}</td>" for mark, cell in zip(marks, row, strict=True)) for row in table.rows)
    body = "".join(f"<tr>{line}</tr>\n" for line in lines)
    return f'<div class="wide"><table><thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>'


def _inline(words: str) -> str:
    """Return escaped words, with code between backticks."""
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(words))


def _paragraph(block: Block) -> str:
    """Return a block as Markdown."""
    match block:
        case Heading(title):
            return f"## {_plain(title)}"
        case Text(words, is_remark):
            return f"{'> ' if is_remark else ''}{_plain(words)}"
        case Facts(pairs):
            return "\n".join(f"- {_plain(what)}: {_plain(value)}" for what, value in pairs)
        case Folded(title, table):
            return f"{_plain(title)}:\n\n{_paragraph(table)}"
        case Figure(_, caption) | Strip(_, caption):
            return f"*{_plain(caption)}*"
        case _:
            return as_markdown([_plain(cell) for cell in block.headers], [[_plain(cell) for cell in row] for row in block.rows])


def _plain(words: str) -> str:
    """Return words in one line, as Markdown that holds neither HTML nor the bars of a table."""
    return " ".join(words.replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").split())
