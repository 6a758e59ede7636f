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
from envs.observation_kernel import observe
from gmapspring.integrators import INTEGRATORS
from gmapspring.jit import announce, is_to_be_compiled
from gmapspring.kernel_cache import HERE

NO_TABLE, NO_ROWS, NO_NUMBERS = np.zeros((0, 1), np.int64), np.zeros(0, np.int64), np.zeros(0)
"""What kernels are called with to be compiled and do nothing."""
TIME_LIMIT = 120.0
"""How long the other process may take [s], many times what it needs."""


@contextmanager
def compiling_beside(dtype: str, integrator: str) -> Iterator[None]:
    """Have `act` ready for a precision when the block is done, compiled beside it if it has to be compiled at all."""
    beside = _start(dtype) if is_to_be_compiled(act) and _has_room() else None
    try:
        yield
        if beside is not None:
            _compile_others(_real(dtype), integrator)
            _wait_for(beside)
    finally:
        if beside is not None and beside.poll() is None:
            beside.kill()
            beside.wait()


def compile_act(dtype: str) -> None:
    """Compile the kernel that carries out actions, for a precision."""
    act(NO_TABLE, NO_ROWS, _real(dtype), NO_ROWS, np.zeros(0, bool))


def _start(dtype: str) -> subprocess.Popen[bytes] | None:
    """Start the other process, on these very sources; None where there can be none."""
    announce()
    code = f"from envs.compiling import compile_act; compile_act({dtype!r})"
    path = os.pathsep.join([str(HERE), *filter(None, [os.environ.get("PYTHONPATH")])])
    try:
        return subprocess.Popen(
            [sys.executable, "-P", "-c", code], env=os.environ | {"PYTHONPATH": path}, stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )  # fmt: skip
    except OSError:
        return None


def _wait_for(beside: subprocess.Popen[bytes]) -> None:
    """Wait, but not for ever: what was started may not have been Python."""
    try:
        beside.wait(TIME_LIMIT)
    except subprocess.TimeoutExpired:
        return


def _compile_others(real: Any, integrator: str) -> None:
    """Compile what else every episode needs, rather than wait."""
    # Imported where it is used: the task itself does without Gymnasium.
    from envs.observation import Observer, observation_space

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
