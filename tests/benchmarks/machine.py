"""What the figures were measured on, and what that machine could do at best."""

import datetime
import os
import pathlib
import platform
from functools import cache
from importlib import metadata
from typing import Any

import numpy as np

from tests.benchmarks.timing import timed

PACKAGES = ("gmapspring", "numpy", "numba", "scipy", "gymnasium", "torch", "stable-baselines3", "sb3-contrib", "taichi",
            "warp-lang", "mujoco", "pybullet")  # fmt: skip


def describe() -> dict[str, Any]:
    """Return date, processor, cores and versions."""
    return {
        "date": datetime.date.today().isoformat(),
        "processor": cpu_model(),
        "cores": os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": {name: version for name in PACKAGES if (version := version_of(name))},
        "load average": load_average(),
    }


def load_average() -> list[float]:
    """Return how many processes wanted a core in the last 1, 5 and 15 minutes; empty where that is unknown."""
    try:
        return [round(load, 2) for load in os.getloadavg()]
    except OSError:
        return []


def version_of(package: str) -> str | None:
    """Return the version of an installed package."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


@cache
def _cpu_lines() -> dict[str, str]:
    """Return what Linux says about the first core; empty elsewhere."""
    path = pathlib.Path("/proc/cpuinfo")
    text = path.read_text().split("\n\n")[0] if path.exists() else ""
    pairs = (line.split(":", 1) for line in text.splitlines() if ":" in line)
    return {key.strip(): value.strip() for key, value in pairs}


def cpu_model() -> str:
    """Return the processor's name; family and model number too, since virtual machines hide the name."""
    lines = _cpu_lines()
    name = lines.get("model name") or platform.processor() or "unknown processor"
    return f"{name} (family {lines['cpu family']}, model {lines['model']})" if "cpu family" in lines else name


def cpu_flags() -> frozenset[str]:
    """Return the instruction sets that the processor offers, by Linux's names; empty where they are unknown."""
    return frozenset(_cpu_lines().get("flags", "").split())


def matrix_rate() -> float:
    """Measure the rate of float64 arithmetic in a matrix product on one thread [1/s]."""
    a, b, out = (np.ones((512, 512)) for _ in range(3))
    np.matmul(a, b, out=out)
    return 2.0 * 512**3 / min(timed(lambda: np.matmul(a, b, out=out)) for _ in range(15))


def bandwidth(n_bytes: int) -> float:
    """Measure how fast a working set of some bytes is read and written, by copying one half onto the other [B/s]."""
    half = max(n_bytes // 2, 4096)
    source, target = np.ones(half, np.uint8), np.zeros(half, np.uint8)
    repeats = max(1, int(2e6 // half))

    def copy() -> None:
        for _ in range(repeats):
            np.copyto(target, source)

    copy()
    return 2.0 * half * repeats / min(timed(copy) for _ in range(15))
