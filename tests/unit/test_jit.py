"""The decorator of kernels: what it compiles is cached on disk, and never used when anything it was made of has changed."""

import os
import subprocess
import sys

import numba
import pytest
from numba.core.codegen import JITCodeLibrary

from gmapspring.jit import kernel, part

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


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs the package in a new process and returns what it computed and its cache hits."""
    package = tmp_path / "package"
    package.mkdir()
    for name, text in (("__init__", ""), ("caller", CALLER), ("callee", CALLEE), ("types", TYPES), ("other", "")):
        (package / f"{name}.py").write_text(text)
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))

    def run_again(file=None, old="", new=""):
        if file:
            path = package / f"{file}.py"
            path.write_text(path.read_text().replace(old, new) + ("# changed" if not old else ""))
        done = subprocess.run([sys.executable, "-c", RUN], cwd=tmp_path, capture_output=True, text=True, timeout=120)
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


def test_other_users_of_numba_keep_their_cache_folder():
    before = numba.config.CACHE_DIR

    @kernel
    def add(a, b):
        return a + b

    assert add(1, 2) == 3
    assert numba.config.CACHE_DIR == before


def test_kernels_follow_ieee_arithmetic():
    @kernel
    def quotient(a, b):
        return a / b

    assert quotient(1.0, 0.0) == float("inf")
    assert quotient(0.0, 0.0) != quotient(0.0, 0.0)


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_a_part_of_kernels_cannot_be_called_from_python():
    @part
    def double(value):
        return 2 * value

    @numba.njit
    def quadruple(value):
        return double(double(value))

    for _ in range(2):  # before and after a kernel has had it compiled
        with pytest.raises(TypeError, match="double is a part of kernels"):
            double(3)
        assert quadruple(3) == 12


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_a_part_becomes_machine_code_only_within_the_kernels_that_call_it(monkeypatch):
    emitted = []
    finalize = JITCodeLibrary._finalize_specific
    monkeypatch.setattr(JITCodeLibrary, "_finalize_specific", lambda library: (emitted.append(library), finalize(library)))

    @part
    def square(value):
        return value * value

    @part
    def cube(value):
        return value * square(value)

    @kernel
    def both(value):
        return cube(value) + square(value)

    assert both(3) == 36
    (library,) = emitted
    assert any("both" in function.name for function in library.get_defined_functions())


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_compiling_is_announced_and_using_the_cache_is_not(tmp_path):
    program = "from gmapspring.stability import largest_eigenvalue as f; import numpy as np; f(np.eye(2)); f(np.eye(3))"
    errors = [subprocess.run([sys.executable, "-c", program], env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, check=True,
                             capture_output=True, text=True).stderr for _ in range(2)]  # fmt: skip
    assert errors[0].count("compiling kernels") == 1 and errors[0].count("\n") == 1 and not errors[1]
