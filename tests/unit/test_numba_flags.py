"""Flags compared quickly are equal, and hashed, as numba's own comparison has it."""

import itertools

import pytest
from numba.core.compiler import Flags
from numba.core.targetconfig import Option, TargetConfig

from gmapspring import jit, numba_flags

assert jit, "importing it is what changes the comparison"


def some_flags():
    """Return flags that differ in nothing, in a default that is set, in one option or in two."""
    changes = [{}, {"nrt": False}, {"nrt": True}, {"no_cpython_wrapper": True}, {"nrt": True, "no_cpython_wrapper": True},
               {"nrt": True, "no_cpython_wrapper": False}, {"error_model": "numpy"}]  # fmt: skip
    found = []
    for change in changes:
        flags = Flags()
        for name, value in change.items():
            setattr(flags, name, value)
        found.append(flags)
    return found


def test_numba_compares_flags_as_it_did():
    assert Flags.__eq__ is numba_flags.is_equal
    n_equal = 0
    for one, other in itertools.product(some_flags(), repeat=2):
        assert (one == other) is TargetConfig.__eq__(one, other)
        assert hash(one) == hash(other) == TargetConfig.__hash__(one)
        n_equal += one == other
    assert 7 < n_equal < 49


class MoreFlags(Flags):
    """Flags with an option more."""

    is_other = Option(type=bool, default=False, doc="an option that flags do not have")


def test_flags_of_another_kind_are_compared_and_hashed_by_numba():
    more = MoreFlags()
    more.is_other = True
    copied = Flags(copy_from=more)  # sets what flags do not have
    for one, other in itertools.product([Flags(), more, MoreFlags(), copied], repeat=2):
        assert (one == other) is TargetConfig.__eq__(one, other)
        assert hash(one) == TargetConfig.__hash__(one)


def test_what_is_no_flags_is_not_equal():
    assert Flags() != 1 and Flags() is not None
    assert numba_flags.is_equal(Flags(), TargetConfig()) is TargetConfig.__eq__(Flags(), TargetConfig())


def test_a_numba_that_keeps_them_elsewhere_is_left_alone(monkeypatch):
    class Other:
        """Flags of another make."""

    monkeypatch.setattr(numba_flags, "Flags", Other)
    numba_flags.compare_quickly()
    assert Other.__eq__ is object.__eq__ and Other() != Other()


@pytest.mark.parametrize("name", ["nrt", "error_model"])
def test_a_change_of_flags_is_seen(name):
    one, other = Flags(), Flags()
    assert one == other
    setattr(other, name, {"nrt": True, "error_model": "numpy"}[name])
    assert one != other
