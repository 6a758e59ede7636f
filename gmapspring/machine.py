"""What figures were measured on: date, processor, versions."""

import datetime
import os
import pathlib
import platform
from collections.abc import Sequence
from functools import cache
from importlib import metadata
from typing import Any

PACKAGES = ("gmapspring", "numpy", "numba", "scipy", "gymnasium", "torch", "stable-baselines3", "sb3-contrib", "taichi",
            "warp-lang", "mujoco", "pybullet")  # fmt: skip


def in_a_line(packages: Sequence[str]) -> str:
    """Return date, machine and the versions of some packages in a line, for the head of a page."""
    facts = describe()
    versions = ", ".join(f"{name} {facts['versions'][name]}" for name in packages)
    return f"{facts['date']}, {facts['processor']}, one core, {facts['system']}, Python {facts['python']}, {versions}"


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
