"""Prefetching is a hint: it reaches the processor, and changes nothing, whatever row is named."""

import numba
import numpy as np
import pytest

from gmapspring.jit import kernel
from gmapspring.prefetch import prefetch


@kernel
def sum_ahead(values, ahead):
    """Sum, with a hint of the row so many further on."""
    total = 0.0
    for i in range(len(values)):
        prefetch(values, i + ahead)
        total += values[i, 0]
    return total


@pytest.mark.parametrize("ahead", [0, 4, -(10**6), 10**15])
def test_a_hint_changes_no_result_and_any_number_will_do_for_a_row(ahead):
    values = np.arange(12.0).reshape(4, 3)
    assert sum_ahead(values, ahead) == 0.0 + 3.0 + 6.0 + 9.0
    assert np.array_equal(values, np.arange(12.0).reshape(4, 3))


@pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="numba's compiler is switched off")
def test_a_hint_is_left_in_by_the_compiler():
    compiled = numba.njit(sum_ahead.py_func)
    compiled(np.zeros((4, 3)), 1)
    assert "call void @llvm.prefetch" in compiled.inspect_llvm(compiled.signatures[0])
