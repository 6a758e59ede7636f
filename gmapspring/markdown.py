"""Tables of generated pages: rows of numbers and words as Markdown."""

import math
from collections.abc import Mapping, Sequence
from typing import Any


def as_markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return rows as a Markdown table; NaN is shown as such."""
    if not rows:
        return ""
    lines = [f"| {' | '.join(rows[0])} |", f"|{'---|' * len(rows[0])}"]
    lines += [f"| {' | '.join(cell(value) for value in row.values())} |" for row in rows]
    return "\n".join(lines)


def cell(value: Any) -> str:
    """Return a value as it stands in a table: numbers with three digits that matter."""
    if isinstance(value, float):
        if not math.isfinite(value):
            return str(value)
        return f"{value:.3g}" if value == 0 or 1e-3 <= abs(value) < 1e5 else f"{value:.2e}"
    return str(value).replace("|", "\\|").replace("\n", " ")
