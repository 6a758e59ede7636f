"""How a long job goes: a bar on a terminal, now and then a line elsewhere."""

import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

LINE_INTERVAL = 15.0
"""Least time between two lines where there is no terminal [s]."""


class ProgressReport:
    """Show a fraction done, the time left, and a text that changes."""

    def __init__(self, console: Console, title: str) -> None:
        """Prepare; the context starts the display."""
        self._console, self._title = console, title
        columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[text]}"))
        self._bar = Progress(*columns, console=console, transient=True) if console.is_terminal else None
        self._started, self._shown, self._from = time.perf_counter(), -float("inf"), 0.0

    def __enter__(self) -> Self:
        """Show the bar."""
        if self._bar:
            self._bar.start()
            self._task = self._bar.add_task(self._title, total=1.0, text="")
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Take the bar away."""
        if self._bar:
            self._bar.stop()

    def begin_at(self, fraction: float) -> None:
        """Say what was done before this job took over, so that the time left is told by its own pace."""
        self._from = fraction

    def update(self, fraction: float, text: str) -> None:
        """Show how far the job is."""
        fraction = min(fraction, 1.0)
        now = time.perf_counter()
        pace = (now - self._started) / max(fraction - self._from, 1e-9)
        left = time.strftime("%M:%S", time.gmtime(min(pace * (1.0 - fraction), 3599.0)))
        if self._bar:
            self._bar.update(self._task, completed=fraction, text=f"{left} left  {text}")
        elif now - self._shown >= LINE_INTERVAL:
            self._shown = now
            self._console.print(f"{self._title} {fraction:4.0%}  {left} left  {text}", highlight=False, soft_wrap=True)

    def note(self, text: str) -> None:
        """Leave a line that stays."""
        self._console.print(text, highlight=False, soft_wrap=True)
