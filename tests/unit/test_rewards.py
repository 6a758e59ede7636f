"""Rewards: named terms that sum to the reward, and what the names and weights may be."""

import numpy as np
import pytest

from envs.collapse import COLLAPSE_RULES
from envs.rewards import REWARD_TERMS, Transition, reward, reward_weights
from gmapspring.errors import ConfigError


def transition(cost=0.5, outcome=None, is_illegal=False):
    """Return a transition in a scene whose least cost is 4."""
    return Transition(cost, 4.0, outcome, is_illegal)


def test_a_cut_costs_half_its_share_of_the_optimum():
    total, terms = reward(transition(cost=0.5), reward_weights())
    assert total == -0.5 * 0.5 / 4.0
    assert terms["cost"] == {"raw": 0.125, "weighted": -0.0625}


def test_separation_at_the_least_cost_returns_one():
    costs = [0.5] * 7 + [0.5]
    outcomes = [None] * 7 + ["separated"]
    returns = sum(reward(transition(c, o), reward_weights())[0] for c, o in zip(costs, outcomes, strict=True))
    assert returns == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("reason", COLLAPSE_RULES)
def test_every_collapse_costs_one(reason):
    assert reward(transition(0.0, reason), reward_weights())[0] == -1.0


def test_an_illegal_action_costs_its_own_term_and_nothing_else():
    total, terms = reward(transition(0.0, None, is_illegal=True), reward_weights())
    assert total == terms["illegal"]["weighted"] == -0.1
    assert sum(abs(term["raw"]) for name, term in terms.items() if name != "illegal") == 0.0


def test_weighted_terms_sum_to_the_reward_to_the_last_bit(rng):
    for _ in range(200):
        weights = {name: float(rng.normal()) for name in REWARD_TERMS}
        outcome = [None, "separated", "tear"][rng.integers(3)]
        total, terms = reward(Transition(*rng.uniform(0.1, 9.0, 2), outcome, bool(rng.integers(2))), weights)
        assert list(terms) == list(REWARD_TERMS)
        assert sum(term["weighted"] for term in terms.values()) == total
        for name, term in terms.items():
            assert term["weighted"] == weights[name] * term["raw"]


def test_a_weight_may_be_set_and_a_term_turned_off():
    weights = reward_weights({"collapse": -3, "cost": 0})
    assert weights == {"cost": 0.0, "separation": 1.5, "collapse": -3.0, "illegal": -0.1}


def test_an_unknown_term_is_an_error_that_names_the_nearest_one():
    with pytest.raises(ConfigError, match=r"reward\.seperation: unknown term; did you mean 'separation'\?"):
        reward_weights({"seperation": 1.0})


@pytest.mark.parametrize("weight", [np.nan, np.inf, "1", None, True])
def test_a_weight_must_be_a_finite_number(weight):
    with pytest.raises(ConfigError, match=r"reward\.cost"):
        reward_weights({"cost": weight})


def test_all_mistakes_are_listed_at_once():
    with pytest.raises(ConfigError, match=r"(?s)reward\.cots.*reward\.collapse"):
        reward_weights({"cots": 1.0, "collapse": "much"})


def test_many_transitions_at_once_give_the_same_bits_as_one_by_one(rng):
    n = 50
    cost, optimum = rng.uniform(0.0, 9.0, n), rng.uniform(0.1, 9.0, n)
    outcomes = np.array([None, "separated", *COLLAPSE_RULES], dtype=object)[rng.integers(2 + len(COLLAPSE_RULES), size=n)]
    is_illegal = rng.random(n) < 0.3
    weights = {name: float(rng.normal()) for name in REWARD_TERMS}
    totals, terms = reward(Transition(cost, optimum, outcomes, is_illegal), weights)
    for i in range(n):
        transition_of = Transition(float(cost[i]), float(optimum[i]), outcomes[i], bool(is_illegal[i]))
        total, each = reward(transition_of, weights)
        assert total == totals[i]
        assert each == {name: {kind: values[kind][i] for kind in values} for name, values in terms.items()}
