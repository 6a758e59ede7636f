"""The cheapest way to the end as a potential: followed while it is proven to be that, else searched anew, in all rows at once."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents.potentials import CutLeft, cost_of, follow, search, what_is_there  # noqa: E402
from agents.vector_face import ResectVecEnv  # noqa: E402
from envs.action_table import action_table  # noqa: E402
from envs.costs import loss_costs  # noqa: E402
from envs.optimum import MinimumCuts, Prices, Terms, minimum_cut, prices_of, terms_of  # noqa: E402
from tests.small_scene import VARIANTS, drawn, quiet_scenes, small_scene, variant_scene  # noqa: E402


def terms_of_rows(environments):
    """Return the terms of the scenes that all rows play, and their prices."""
    scenes = [environments.scene_of(row) for row in range(environments.num_envs)]
    known = [(terms_of(scene, action_table(scene.mesh)), prices_of(scene, action_table(scene.mesh))) for scene in scenes]
    terms, prices = zip(*known, strict=True)
    return Terms(*map(np.concatenate, zip(*terms, strict=True))), Prices(*map(np.stack, zip(*prices, strict=True)))


@pytest.mark.parametrize("variant", VARIANTS)
def test_what_is_followed_of_a_cheapest_way_costs_what_a_new_search_finds(variant):
    scenes = [variant_scene(variant, seed, load=0.02) for seed in range(4)]
    environments, rng, rows = ResectVecEnv(4, scene=scenes), np.random.default_rng(0), np.arange(4)
    environments.seed(1)
    observation, n_followed, n_lost = environments.reset(), 0, 0
    terms, prices = terms_of_rows(environments)
    ways = search(terms, what_is_there(observation, rows))
    for _ in range(60):
        actions = wavering(observation, ways, rng)
        observation, _, dones, _ = environments.step(actions)
        there = what_is_there(observation, rows)
        left, is_proven = follow(ways, actions, there)
        terms, prices = terms_of_rows(environments)
        anew, is_followed = search(terms, there), is_proven & ~dones
        found, expected = cost_of(left, prices), cost_of(anew, prices)
        n_followed, n_lost = n_followed + is_followed.sum(), n_lost + left.is_lost[is_followed].any(1).sum()
        for row in np.flatnonzero(is_followed):
            # The search counts in whole numbers: 2^29 of them for the largest cost.
            assert found[row] == pytest.approx(expected[row], rel=1e-6) or (found[row] < expected[row] and not anew.is_exact[row])
            assert there[row, left.is_part[row]].all()
        ways = MinimumCuts(*(np.where(np.expand_dims(is_followed, tuple(range(1, old.ndim))), old, new)
                             for old, new in zip(left, anew, strict=True)))  # fmt: skip
    assert n_followed > 30 and (n_lost > 5 or variant != "two targets")


def wavering(observation, ways, rng):
    """Return actions, of the cheapest ways as often as not."""
    actions = drawn(observation, rng)
    for row, allowed in enumerate((observation["action_mask"] != 0) & ways.is_part):
        if allowed.any() and rng.random() < 0.7:
            actions[row] = rng.choice(np.flatnonzero(allowed))
    return actions


def one_way():
    """Return a scene, its actions, its cheapest way as a batch of one, and what is there."""
    scene = small_scene(seed=2, load=0.02)
    table = action_table(scene.mesh)
    there = np.ones((1, table.n_actions), bool)
    return scene, table, search(terms_of(scene, table), there), there


def test_a_way_is_not_followed_where_that_proves_nothing():
    _, _, ways, there = one_way()
    (first, second), other = np.flatnonzero(ways.is_part)[:2], np.flatnonzero(~ways.is_part)[0]

    def is_proven(ways, action):
        return follow(ways, np.array([action]), there)[1].item()

    there[0, first] = False
    assert is_proven(ways, first)
    assert not is_proven(ways._replace(is_exact=np.array([False])), first), "an upper bound"
    assert not is_proven(ways, second), "an action that was not done"
    there[0, other] = False
    assert not is_proven(ways, other), "an action that is no part of the way"


def test_what_went_on_the_way_is_not_paid_for_again():
    scene, table, ways, there = one_way()
    losses = loss_costs(table.volume, ~scene.target, scene.spacing)
    healthy, actions, costs = np.flatnonzero(~scene.target), np.flatnonzero(ways.is_part), prices_of(scene, table)
    ways = ways._replace(is_lost=np.isin(np.arange(table.n_tetrahedra), healthy[:2])[None])
    there[0, [*actions[:2], table.n_faces + healthy[0]]] = False
    left, _ = follow(ways, actions[:1], there)
    assert np.flatnonzero(left.is_part).tolist() == actions[2:].tolist() and np.flatnonzero(left.is_lost).tolist() == [healthy[1]]
    expected = costs.actions[actions[2:]].sum() + losses[healthy[1]]
    assert cost_of(left, Prices(*(part[None] for part in costs))) == pytest.approx(expected)


@pytest.mark.parametrize("variant", ["plain", "vessel", "two targets"])
def test_the_minimum_cut_potential_is_the_cost_of_the_cheapest_way_in_every_state(variant):
    scenes = quiet_scenes(variant)
    environments, rng, rows = ResectVecEnv(3, scene=scenes), np.random.default_rng(0), np.arange(3)
    environments.seed(0)
    potential, observation = CutLeft(environments.scene_of), environments.reset()
    left = potential.begin(rows, observation)
    np.testing.assert_allclose(left, [environments.scene_of(row).certificate.optimum for row in rows], rtol=1e-14)
    n_compared = 0
    for _ in range(25):
        ways = search(terms_of_rows(environments)[0], what_is_there(observation, rows))
        actions = wavering(observation, ways, rng)
        observation, _, dones, _ = environments.step(actions)
        goes_on = np.flatnonzero(~dones)
        left = potential.proceed(goes_on, actions[goes_on], observation)
        for row, cost in zip(goes_on, left, strict=True):
            scene, there = environments.scene_of(row), what_is_there(observation, [row])[0]
            table = action_table(scene.mesh)
            anew = minimum_cut(scene, table, there[table.n_faces :], there[: table.n_faces])
            assert cost == pytest.approx(min(anew.cost, limit_of(environments, row)), rel=1e-6) or (
                cost < anew.cost and not anew.is_exact
            )
            n_compared += 1
        potential.begin(np.flatnonzero(dones), observation)
    assert n_compared > 30


def limit_of(environments, row):
    """Return the cost at which a row's episode is cut short."""
    scene = environments.scene_of(row)
    return scene.budget * scene.certificate.optimum


def test_a_state_without_a_way_counts_as_far_as_the_budget():
    scene = variant_scene("vessel", 2, load=0.02)
    environments, rows = ResectVecEnv(1, scene=scene), np.array([0])
    potential, observation = CutLeft(environments.scene_of), environments.reset()
    potential.begin(rows, observation)
    # Nothing is sewn any more, so the vessel, which must not be lost, hangs on nothing.
    observation["faces"][:] = 0.0
    assert not search(terms_of(scene, action_table(scene.mesh)), what_is_there(observation, rows)).is_possible
    assert potential.proceed(rows, np.array([0]), observation) == pytest.approx(limit_of(environments, 0))
