"""Minimum cuts of networks, against scipy's maximum flow and, for tiny ones, against every cut there is."""

from itertools import product

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from envs.flow import reached_from


def random_network(rng, largest, n_arcs):
    """Return (source, sink, n_nodes, tails, heads, capacities); arcs may be parallel, opposite or empty."""
    n_nodes = int(rng.integers(2, largest + 1))
    tails, heads = rng.integers(0, n_nodes, (2, int(rng.integers(0, n_arcs + 1))))
    tails, heads = tails[tails != heads], heads[tails != heads]
    source, sink = rng.choice(n_nodes, 2, replace=False)
    return int(source), int(sink), n_nodes, tails, heads, rng.integers(0, 6, len(tails))


def reached_by_scipy(source, sink, n_nodes, tails, heads, capacities):
    """Return what the source reaches through what scipy's flow leaves."""
    graph = csr_array((capacities.astype(np.int32), (tails, heads)), shape=(n_nodes, n_nodes))
    left = csr_array(graph - maximum_flow(graph, source, sink).flow)
    left.data[left.data < 0] = 0
    left.eliminate_zeros()
    is_reached = np.zeros(n_nodes, bool)
    is_reached[breadth_first_order(left, source, return_predecessors=False)] = True
    return is_reached


@pytest.mark.parametrize(("largest", "n_arcs"), [(5, 12), (30, 200), (200, 1500)])
def test_what_is_reached_is_what_scipys_flow_leaves(largest, n_arcs, rng):
    for _ in range(100):
        network = random_network(rng, largest, n_arcs)
        assert np.array_equal(reached_from(*network), reached_by_scipy(*network))


def test_no_cut_is_cheaper_and_none_as_cheap_leaves_fewer_with_the_source(rng):
    for _ in range(100):
        source, sink, n_nodes, tails, heads, capacities = random_network(rng, 7, 16)
        sides = np.array(list(product([False, True], repeat=n_nodes)))
        sides = sides[sides[:, source] & ~sides[:, sink]]
        costs = (sides[:, tails] & ~sides[:, heads]) @ capacities
        best = sides[costs == costs.min()]
        found = reached_from(source, sink, n_nodes, tails, heads, capacities)
        assert np.array_equal(found, best.all(axis=0)) and (best == found).all(axis=1).any()


def test_capacities_may_be_larger_than_32_bits_hold():
    tails, heads = np.array([0, 1, 1, 2]), np.array([1, 2, 3, 3])
    capacities = np.array([2**40, 2**39, 2**38, 2**41])
    assert reached_from(0, 3, 4, tails, heads, capacities).tolist() == [True, True, False, False]
