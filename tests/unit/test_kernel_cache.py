"""The cache of kernels: what is compiled is kept on disk, and never used when anything it was made of has changed."""

import os
import shutil
import subprocess
import sys

import numba
import pytest

from gmapspring.jit import kernel

CALLER = """
from gmapspring.jit import kernel
from package.callee import double
from package.types import Pair

@kernel
def compute(pair):
    return double(pair.first) - pair.second
"""
CALLEE = """
from gmapspring.jit import kernel, part

@kernel
def double(value):
    return 2 * value
"""
TYPES = """
from typing import NamedTuple

class Pair(NamedTuple):
    first: int
    second: int
"""
RUN = """
from package.caller import compute
from package.types import Pair
print(compute(Pair(first=10, second=1)), sum(compute.stats.cache_hits.values()))
"""
ASK = """
from gmapspring.jit import is_to_be_compiled
from package.caller import compute
print(is_to_be_compiled(compute))
"""


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs the package in a new process and returns what it computed and its cache hits."""
    package = tmp_path / "package"
    package.mkdir()
    for name, text in (("__init__", ""), ("caller", CALLER), ("callee", CALLEE), ("types", TYPES), ("other", "")):
        (package / f"{name}.py").write_text(text)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def run_again(file=None, old="", new="", folder=tmp_path):
        if file:
            path = package / f"{file}.py"
            path.write_text(path.read_text().replace(old, new) + ("# changed" if not old else ""))
        done = subprocess.run([sys.executable, "-c", RUN], cwd=folder, capture_output=True, text=True, timeout=120)
        assert done.returncode == 0, done.stderr
        return tuple(int(word) for word in done.stdout.split())

    return run_again


def test_a_cached_kernel_is_used_again_until_something_it_can_reach_changes(run):
    assert run() == (19, 0)  # 2 * 10 - 1, compiled
    assert run() == (19, 1)  # from the cache
    assert run("other") == (19, 1)  # a file that it does not reach
    assert run("callee", "2 * value", "3 * value") == (29, 0)  # a function that it calls
    # The fields of a tuple that it takes change places: the compiled code would read the wrong ones.
    assert run("types", "first: int\n    second: int", "second: int\n    first: int") == (29, 0)
    assert run() == (29, 1)


def test_copies_of_the_same_sources_share_what_is_compiled_wherever_they_lie_and_whenever_they_were_made(run, tmp_path):
    assert run() == (19, 0)
    shutil.copytree(tmp_path / "package", tmp_path / "elsewhere" / "package")
    for file in (tmp_path / "elsewhere" / "package").glob("*.py"):
        os.utime(file, (10**9, 10**9))
    assert run(folder=tmp_path / "elsewhere") == (19, 1)


@pytest.mark.parametrize(("folder", "hits"), [("project", 0), ("site-packages", 1)])
def test_modules_beside_a_package_count_unless_they_are_installed(run, tmp_path, folder, hits):
    place = tmp_path / folder
    shutil.copytree(tmp_path / "package", place / "package")
    (place / "beside.py").write_text("")
    caller = place / "package" / "caller.py"
    caller.write_text("import beside\n" + caller.read_text())
    assert run(folder=place) == (19, 0)
    (place / "beside.py").write_text("# changed")
    assert run(folder=place) == (19, hits)


def test_where_nothing_can_be_written_kernels_work_all_the_same(run, tmp_path, monkeypatch):
    (tmp_path / "a file").touch()
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "a file" / "cache"))
    assert run()[0] == 19


def test_other_users_of_numba_keep_their_cache_folder():
    before = numba.config.CACHE_DIR

    @kernel
    def add(a, b):
        return a + b

    assert add(1, 2) == 3
    assert numba.config.CACHE_DIR == before


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_a_kernel_is_to_be_compiled_until_it_is_kept(run, tmp_path):
    def ask():
        done = subprocess.run([sys.executable, "-c", ASK], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=120)
        return done.stdout.strip()

    assert ask() == "True"
    run()
    assert ask() == "False"
    (tmp_path / "package" / "callee.py").write_text(CALLEE.replace("2 * value", "3 * value"))
    assert ask() == "True", "what it is made of has changed"
    (tmp_path / "package" / "callee.py").write_text(CALLEE)
    assert ask() == "False", "what was made of it before is still there"
