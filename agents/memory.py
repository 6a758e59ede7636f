"""Memory that is freed and asked for again many times a second."""

import ctypes
import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of two parameters of mallopt, from glibc's malloc.h."""
_NEVER, _LARGEST = 2**31 - 1, 2**25
"""Bytes: as much as an int holds, and as much as glibc lets the other be."""


def keep_freed_memory() -> None:
    """Keep what is freed for what is needed next, where the C library can be told so: glibc's, on Linux.

    A gradient step makes and drops dozens of tensors of a few megabytes. Left alone, glibc gives most of them back to the
    system, which clears every page before it hands it out again: a tenth of the time of a gradient step.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if sys.platform == "linux" else None
    if mallopt:
        mallopt(_TRIM_THRESHOLD, _NEVER)
        mallopt(_MMAP_THRESHOLD, _LARGEST)
