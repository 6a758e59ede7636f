"""The decorators: kernels follow IEEE arithmetic and say when they are compiled, parts are compiled only within kernels."""


import gc
import math
import os
import subprocess
import sys

import numba
import numpy as np
import pytest
from numba.core import event
from numba.core.codegen import JITCodeLibrary

from gmapspring.jit import inlined_part, kernel, part


def test_kernels_follow_ieee_arithmetic():
    @kernel
    def quotient(a, b):
        return a / b

    assert quotient(1.0, 0.0) == float("inf")
    assert quotient(0.0, 0.0) != quotient(0.0, 0.0)


@pytest.mark.parametrize("is_on", [True, False])
def test_the_garbage_collector_is_after_compiling_what_it_was_before(is_on):
    @kernel
    def twice(value):
        return 2 * value

    was_on = gc.isenabled()
    try:
        (gc.enable if is_on else gc.disable)()
        while_compiling = []
        probe = event.RecordingListener()
        probe.on_start = lambda started: while_compiling.append(gc.isenabled())
        with event.install_listener("numba:compile", probe):
            assert twice(2) == 4
        # nothing is compiled where the kernel is in the cache from the last time
        assert not any(while_compiling)
        assert gc.isenabled() == is_on
        # what cannot be compiled is no exception
        with pytest.raises((numba.errors.TypingError, TypeError)):
            twice(None)
        assert gc.isenabled() == is_on
    finally:
        (gc.enable if was_on else gc.disable)()


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
@pytest.mark.parametrize("decorator, is_called", [(part, True), (inlined_part, False)])
def test_an_inlined_part_is_put_whole_into_the_kernels_that_call_it(decorator, is_called):
    @decorator
    def long_sum(values):
        total = np.zeros(3)
        for x in values:
            for y in values:
                total[0] += x / y
                for z in values:
                    total[1] += x * y / z
                    total[2] += math.sin(x) * math.cos(y) * math.tan(z)
        return total[0] + total[1] * total[2]

    @numba.njit
    def both(values):
        return long_sum(values) + long_sum(2.0 * values)

    both(np.ones(2))
    defined = [line for line in both.inspect_llvm(both.signatures[0]).splitlines() if line.startswith("define")]
    assert any("long_sum" in line for line in defined) == is_called


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_compiling_is_announced_and_using_the_cache_is_not(tmp_path):
    program = "from gmapspring.stability import largest_eigenvalue as f; import numpy as np; f(np.eye(2)); f(np.eye(3))"
    errors = [subprocess.run([sys.executable, "-c", program], env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}, check=True,
                             capture_output=True, text=True).stderr for _ in range(2)]  # fmt: skip
    assert errors[0].count("compiling kernels") == 1 and errors[0].count("\n") == 1 and not errors[1]
