"""The hard cases: what a body must survive, in a table of functions case(scheme, dtype) -> Verdict, one file for each theme.

To add one: write the function, which says in words what it expects and derives its limits, and enter it in its file's CASES.
"""

from collections.abc import Callable
from typing import Any

from tests.stability.cases import certificate, cutting, falling, limits, loads, materials, numbers, starts
from tests.stability.cases.verdict import Check, Verdict

__all__ = ["CASES", "LONG_CASES", "Check", "Verdict"]

Case = Callable[[str, Any], Verdict]

CASES: dict[str, Case] = {
    **limits.CASES, **materials.CASES, **starts.CASES, **cutting.CASES, **falling.CASES, **loads.CASES, **numbers.CASES,
    **certificate.CASES,
}  # fmt: skip
"""Cases by name."""
LONG_CASES: dict[str, Case] = {**falling.LONG_CASES, **certificate.LONG_CASES}
"""The same at greater length: minutes."""
