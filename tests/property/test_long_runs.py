"""Long random sequences over the whole zoo: the fast body and the naive one never part."""

import numpy as np
import pytest

from gmapspring import stability
from tests import zoo
from tests.twins import Twins


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in zoo.ALL if name != "liver"])
@pytest.mark.parametrize("seed", range(10))
def test_a_hundred_random_operations_agree_with_the_naive_body_and_keep_the_bound(name, seed):
    twins, rng = Twins(zoo.build(name), seed), np.random.default_rng(seed)
    bound = stability.element_frequency(twins.sim.body)
    for _ in range(100):
        twins.random_operation(rng)
        twins.assert_agreement()
        if twins.sim.body.n_nodes:
            assert stability.assembled_frequency(twins.sim.body) <= bound * (1 + 1e-12)
