"""Settings of the whole suite: one thread everywhere, and Hypothesis runs that repeat."""
# ruff: noqa: E402, the number of threads must be set before what follows is imported

import os

# Set before numba, numpy or torch start: with more threads, small work on busy cores is slower, and sums may differ.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import sys

import hypothesis
import numpy as np
import pytest

from tests import zoo

hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True, database=None)
hypothesis.settings.register_profile("search", deadline=None, max_examples=500, print_blob=True)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(autouse=True)
def one_torch_thread():
    """Keep torch on one thread where a test has imported it."""
    if "torch" in sys.modules:
        sys.modules["torch"].set_num_threads(1)


@pytest.fixture
def rng():
    """Return a seeded random generator."""
    return np.random.default_rng(20100601)


@pytest.fixture(params=zoo.ALL)
def any_mesh(request):
    """Return every mesh of the zoo in turn."""
    return zoo.build(request.param)


@pytest.fixture(params=zoo.SMALL)
def small_mesh(request):
    """Return every small mesh of the zoo in turn."""
    return zoo.build(request.param)
