"""What a benchmark says: rows of asked, measured, error and reference."""

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

NAN = math.nan


class Limit(NamedTuple):
    """What a row has to reach."""

    sense: str
    """"at most" or "at least"."""
    value: float
    """The bound, in the row's unit."""

    def holds(self, measured: float) -> bool:
        """Tell whether a value is on the right side; NaN never is."""
        return measured <= self.value if self.sense == "at most" else measured >= self.value

    def __str__(self) -> str:
        """Write it as the table shows it."""
        return f"{'≤' if self.sense == 'at most' else '≥'} {self.value:.4g}"


def at_most(value: float) -> Limit:
    """Return an upper bound."""
    return Limit("at most", value)


def at_least(value: float) -> Limit:
    """Return a lower bound."""
    return Limit("at least", value)


@dataclass(frozen=True)
class Row:
    """One measurement of the table."""

    name: str
    """What was measured, on which body, in which precision."""
    measured: float
    """The value, NaN where it could not be measured; `note` then says why."""
    unit: str = ""
    """Unit of measured, low, high and the limit; empty for a ratio."""
    low: float = NAN
    """Lower end of the spread over rounds: the median of a time, the 10th percentile of a ratio or rate."""
    high: float = NAN
    """90th percentile over rounds."""
    asked: Limit | None = None
    """What it has to reach, None for a row that only informs."""
    error: float = NAN
    """How far the result of what was timed lies from the reference, NaN where there is nothing to compare."""
    tolerated: float = NAN
    """Largest error that counts as the same result."""
    error_means: str = ""
    """What the error is."""
    reference: str = ""
    """Figures of others, for comparison; not measured in this run."""
    note: str = ""
    """What limits the row, what differs, or why it is NaN."""
    group: str = ""
    """Key of `registry.GROUPS` that measured it."""
    n_tetrahedra: int = 0
    """Size of the body, for the plot; 0 where the row is not plotted."""
    series: str = ""
    """Curve of the plot that the row is a point of."""

    @property
    def is_right(self) -> bool:
        """Tell whether the error is tolerated; true where none is known."""
        return math.isnan(self.tolerated) or self.error <= self.tolerated

    @property
    def verdict(self) -> str:
        """Return "reached", "not reached", "wrong result", or "" where nothing is asked."""
        if math.isnan(self.measured):
            return "not measured"
        if not self.is_right:
            return "wrong result"
        if self.asked is None:
            return ""
        return "reached" if self.asked.holds(self.measured) else "not reached"

    def as_plain(self) -> dict[str, Any]:
        """Return the row as numbers and text."""
        return asdict(self) | {"asked": str(self.asked) if self.asked else "", "verdict": self.verdict}


class Plan(NamedTuple):
    """What all groups need to know of the run."""

    is_quick: bool
    """Leave out the large bodies and take fewer rounds."""
    say: Callable[[str], None]
    """Show a line of progress."""

    @property
    def rounds(self) -> int:
        """Return how often each contestant is timed."""
        return 25 if self.is_quick else 101


Group = Callable[[Plan], Iterator[Row]]
"""A function that measures related rows and yields each as soon as it is known."""


def failed(name: str, reason: str, **fields: Any) -> Row:
    """Return the row of a measurement that did not come about."""
    return Row(name=name, measured=NAN, note=reason, **fields)


def reason_of(error: BaseException) -> str:
    """Return an error as one short line."""
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return text if len(text) <= 200 else text[:197] + "..."
