"""The first start on a machine: while bodies' kernels are compiled here, the largest one is compiled in a process beside.

To compile `act`, which carries out cuts, takes as long as to compile all else that an episode needs. The other process leaves
what it makes in the cache on disk, from which it is loaded here. Where anything is in the way of that, all is compiled here.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from envs.acting import act
from envs.actions import mask_all
from envs.measuring import measure
from envs.observation import Observer, observation_space
from envs.observation_kernel import observe
from gmapspring.integrators import INTEGRATORS
from gmapspring.jit import is_to_be_compiled

NO_TABLE, NO_ROWS, NO_NUMBERS = np.zeros((0, 1), np.int64), np.zeros(0, np.int64), np.zeros(0)
"""What kernels are called with to be compiled and do nothing."""


@contextmanager
def compiling_beside(dtype: str, integrator: str) -> Iterator[None]:
    """Have `act` ready for a precision when the block is done, compiled beside it if it has to be compiled at all."""
    if not is_to_be_compiled(act) or not _has_room():
        yield
        return
    code = f"from envs.compiling import compile_act; compile_act({dtype!r})"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as beside:
        try:
            yield
            _compile_others(_real(dtype), integrator)
        except BaseException:
            beside.terminate()
            raise


def compile_act(dtype: str) -> None:
    """Compile the kernel that carries out actions, for a precision."""
    act(NO_TABLE, NO_ROWS, _real(dtype), NO_ROWS, np.zeros(0, bool))


def _compile_others(real: Any, integrator: str) -> None:
    """Compile what else every episode needs, rather than wait."""
    INTEGRATORS[integrator].advance(NO_TABLE, NO_ROWS, real, NO_NUMBERS, NO_ROWS, NO_NUMBERS, NO_ROWS)
    for kernel in (measure, mask_all):
        kernel(NO_TABLE, NO_ROWS, real)
    observe(NO_TABLE, NO_ROWS, real, NO_ROWS, Observer(observation_space(1, 2)).room_for(1))


def _real(dtype: str) -> Any:
    """Return a number of a precision."""
    return np.dtype(dtype).type(0.0)


def _has_room() -> bool:
    """Return whether there is a core to spare, and a Python to be started: a frozen application would start itself."""
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return n_cores > 1 and bool(sys.executable) and not getattr(sys, "frozen", False)
