"""Threads for kernels, which hold no interpreter lock: off unless asked for, and made when they are first needed."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np


class Threads:
    """Run a function over chunks of rows, in so many threads."""

    def __init__(self, n_threads: int = 1):
        """Start none yet."""
        if isinstance(n_threads, bool) or not isinstance(n_threads, int | np.integer) or n_threads < 1:
            raise ValueError(f"n_threads must be a whole number above 0, not {n_threads!r}")
        self.n_threads = int(n_threads)
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def __getstate__(self) -> dict[str, Any]:
        """Return the number alone: a copy starts threads of its own."""
        return {"n_threads": self.n_threads, "_pool": None, "_process": 0}

    def run(self, function: Callable[[np.ndarray], Any], rows: np.ndarray) -> None:
        """Call function(some of the rows) until all have had their turn; return when all are done."""
        n_chunks = min(self.n_threads, len(rows))
        if n_chunks < 2:
            if n_chunks:
                function(rows)
            return
        # The pool of a process from which this one was forked has no threads here.
        if self._pool is None or self._process != os.getpid():
            self._pool, self._process = ThreadPoolExecutor(self.n_threads, "gmapspring"), os.getpid()
        for _ in self._pool.map(function, np.array_split(rows, n_chunks)):
            pass
