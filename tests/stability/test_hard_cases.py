"""Every hard case, for every scheme, in both precisions: what is expected holds."""

import numpy as np
import pytest

from gmapspring.integrators import INTEGRATORS
from tests.stability.cases import CASES, LONG_CASES, Check, Verdict
from tests.stability.cases.verdict import differing, refused

every_scheme = pytest.mark.parametrize("scheme", sorted(INTEGRATORS))
both_precisions = pytest.mark.parametrize("dtype", [np.float64, np.float32], ids=["float64", "float32"])


def assert_holds(verdict):
    """Fail with every figure that is beyond its limit."""
    failed = [f"{check.figure}: {check.worst:.6g}, at most {check.limit:.6g}" for check in verdict.checks if not check.passed]
    assert not failed, f"expected: {verdict.expected}; found: {'; '.join(failed)}"


@both_precisions
@every_scheme
@pytest.mark.parametrize("name", CASES)
def test_a_hard_case_ends_as_expected(name, scheme, dtype):
    assert_holds(CASES[name](scheme, dtype))


@pytest.mark.slow
@both_precisions
@every_scheme
@pytest.mark.parametrize("name", LONG_CASES)
def test_a_long_hard_case_ends_as_expected(name, scheme, dtype):
    verdict = LONG_CASES[name](scheme, dtype)
    for check in verdict.checks:
        print(f"{name}, {scheme}: {check.figure} {check.worst:.6g}, at most {check.limit:.6g}")
    assert_holds(verdict)


def test_a_verdict_is_that_of_its_tightest_check():
    checks = (Check("wide", 1.0, 100.0), Check("tight", 9.0, 10.0), Check("exact", 0.0, 0.0))
    verdict = Verdict("", checks)
    assert verdict.passed and verdict.tightest.figure == "tight" and verdict.margin == pytest.approx(10 / 9)
    assert not Verdict("", (*checks, Check("beyond", 1.1, 1.0))).passed
    assert not Check("not a number", np.nan, np.inf).passed
    assert not Check("not zero", 1.0, 0.0).passed


def test_a_call_that_is_not_refused_is_counted():
    def refuse():
        raise ValueError("too long")

    assert refused([refuse], ValueError, "long").passed
    assert refused([refuse], ValueError, "short").worst == 1.0
    assert refused([lambda: None, lambda: None], ValueError).worst == 2.0


def test_entries_of_other_bits_are_counted():
    zeros = np.zeros(3)
    assert differing("", zeros, zeros.copy()).passed
    assert differing("", zeros, np.array([0.0, -0.0, 1.0])).worst == 2.0
    assert differing("", zeros, np.zeros(4)).worst == 4.0
