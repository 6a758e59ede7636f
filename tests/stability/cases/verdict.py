"""What a hard case says: what was expected in words, and the figures that were measured against their limits."""

from typing import NamedTuple

import numpy as np


class Check(NamedTuple):
    """One figure and what it may be at most."""

    figure: str
    """What was measured, in a few words."""
    worst: float
    """The worst that was found; NaN counts as beyond any limit."""
    limit: float
    """What was expected at most."""

    @property
    def passed(self) -> bool:
        """Whether the figure is within its limit."""
        return bool(self.worst <= self.limit)

    @property
    def margin(self) -> float:
        """How many times the figure fits into its limit, below 1 where it does not; infinite for a figure of 0."""
        if np.isnan(self.worst):
            return 0.0
        if self.worst == 0.0:
            return np.inf
        return float(self.limit / self.worst)


class Verdict(NamedTuple):
    """The outcome of a case for one scheme and one precision."""

    expected: str
    """What was expected, as a phrase."""
    checks: tuple[Check, ...]
    """All figures."""

    @property
    def tightest(self) -> Check:
        """The check that comes closest to its limit, or goes furthest beyond it."""
        return min(self.checks, key=lambda check: check.margin)

    @property
    def worst(self) -> float:
        """The figure of the tightest check."""
        return self.tightest.worst

    @property
    def limit(self) -> float:
        """The limit of the tightest check."""
        return self.tightest.limit

    @property
    def margin(self) -> float:
        """The margin of the tightest check."""
        return self.tightest.margin

    @property
    def passed(self) -> bool:
        """Whether all figures are within their limits."""
        return all(check.passed for check in self.checks)


def all_finite(sim) -> Check:
    """Count the entries of a state that are not finite: none may be."""
    return Check("entries of the state that are not finite", float(np.sum(~np.isfinite(sim.body.nodes.state))), 0.0)


def refused(calls, error, match: str = "") -> Check:
    """Count the calls that do not raise an error of a class whose text holds some words."""
    n_accepted = 0
    for call in calls:
        try:
            call()
            n_accepted += 1
        except error as refusal:
            n_accepted += match not in str(refusal)
    return Check("wrong calls that are not refused", float(n_accepted), 0.0)


def differing(figure: str, one, other) -> Check:
    """Count the entries of two arrays whose bits differ; arrays of different shapes differ throughout."""
    one, other = np.ascontiguousarray(one), np.ascontiguousarray(other)
    if one.shape != other.shape or one.dtype != other.dtype:
        return Check(figure, float(max(one.size, other.size)), 0.0)
    bits = f"u{one.itemsize}"
    return Check(figure, float(np.sum(one.view(bits) != other.view(bits))), 0.0)
