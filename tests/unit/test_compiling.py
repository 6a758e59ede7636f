"""The largest kernel is compiled beside the others: for the very types that episodes use, and only where it has to be."""

import subprocess
import sys

import numba
import numpy as np
import pytest

from envs import compiling
from envs.acting import act
from envs.actions import mask_all
from envs.compiling import compile_act, compiling_beside
from envs.measuring import measure
from envs.observation_kernel import observe
from envs.resect import ResectEnv
from gmapspring.integrators import INTEGRATORS
from gmapspring.jit import is_to_be_compiled
from tests.small_scene import small_scene

compiled = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="the compiler is switched off")


@pytest.fixture
def started(monkeypatch):
    """Let there be something to compile, and return the processes that are started for it."""
    processes = []

    class Process(subprocess.Popen):
        def __init__(self, *arguments, **settings):
            super().__init__(*arguments, **settings)
            processes.append(self)

    monkeypatch.setattr(compiling, "is_to_be_compiled", lambda kernel: True)
    monkeypatch.setattr(compiling, "_has_room", lambda: True)
    monkeypatch.setattr(subprocess, "Popen", Process)
    return processes


@compiled
def test_what_is_compiled_ahead_is_what_episodes_call():
    env = ResectEnv(small_scene())
    observation, _ = env.reset(seed=0)
    env.step(int(observation["action_mask"].argmax()))
    kernels = act, measure, mask_all, observe, INTEGRATORS["symplectic_euler"].advance
    before = [len(kernel.signatures) for kernel in kernels]
    compile_act("float64")
    compiling._compile_others(np.float64(0.0), "symplectic_euler")
    assert [len(kernel.signatures) for kernel in kernels] == before
    assert min(before) > 0


@compiled
def test_nothing_is_started_where_there_is_nothing_to_compile(monkeypatch):
    compile_act("float64")
    assert not is_to_be_compiled(act)
    monkeypatch.setattr(subprocess, "Popen", None)
    with compiling_beside("float64", "symplectic_euler"):
        pass


@compiled
def test_the_other_process_is_waited_for(started):
    with compiling_beside("float64", "symplectic_euler"):
        (process,) = started
    assert process.returncode == 0


@compiled
def test_a_process_that_fails_is_no_error(started, monkeypatch):
    monkeypatch.setenv("PYTHONHOME", "/nowhere")
    with compiling_beside("float64", "symplectic_euler"):
        (process,) = started
    assert process.returncode != 0


def test_an_error_meanwhile_ends_the_other_process(started):
    with pytest.raises(ValueError, match="meanwhile"), compiling_beside("float64", "symplectic_euler"):
        raise ValueError("meanwhile")
    (process,) = started
    assert process.returncode < 0, "it was killed"


@compiled
@pytest.mark.parametrize("executable", ["/nowhere/python", sys.executable + "-none"])
def test_where_no_process_can_be_started_all_is_compiled_here(started, monkeypatch, executable):
    monkeypatch.setattr(sys, "executable", executable)
    with compiling_beside("float64", "symplectic_euler"):
        assert not started


@compiled
def test_a_process_that_does_not_end_is_not_waited_for_for_ever(started, monkeypatch):
    monkeypatch.setattr(compiling, "TIME_LIMIT", 0.0)
    with compiling_beside("float64", "symplectic_euler"):
        (process,) = started
    assert process.returncode < 0


@compiled
def test_the_other_process_takes_these_sources_whatever_lies_where_it_is_started(started, monkeypatch, tmp_path):
    (tmp_path / "envs").mkdir()
    (tmp_path / "envs" / "__init__.py").write_text("raise ImportError")
    monkeypatch.chdir(tmp_path)
    with compiling_beside("float64", "symplectic_euler"):
        (process,) = started
    assert process.returncode == 0


def test_where_there_is_one_core_all_is_compiled_in_one_process(started, monkeypatch):
    monkeypatch.setattr(compiling, "_has_room", lambda: False)
    with compiling_beside("float64", "symplectic_euler"):
        assert not started
