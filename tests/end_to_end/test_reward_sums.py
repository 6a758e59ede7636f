"""Rewards add up: each to its terms to the last bit, and those of the certificate to 1, on every level in both environments."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from envs.library import load_scene_config, load_scenes, shipped_scenes
from envs.resect import ResectEnv
from envs.rewards import REWARD_TERMS, reward_weights
from envs.vector import ResectVectorEnv
from tests.small_scene import play, random_policy

ODD = dict(zip(REWARD_TERMS, (-0.7310585786300049, 1e-3 / 3.0, -17.1, 0.1), strict=False))
"""Weights that no sum comes out even with; one has the wrong sign."""
SPLITS = [(name, split) for name in shipped_scenes() for split in load_scene_config(name).splits]
N_ROWS = 4


def assert_adds_up(reward, terms, weights):
    """Check the terms of one reward."""
    assert list(terms) == list(REWARD_TERMS)
    total = 0.0
    for name, term in terms.items():
        assert term["weighted"] == weights[name] * term["raw"]
        total += term["weighted"]
    assert total == reward


def row_of(info, row):
    """Return the reward terms of one row of a batch."""
    terms = info["reward_terms"]
    return {name: {kind: terms[name][kind][row] for kind in ("raw", "weighted")} for name in REWARD_TERMS}


def mostly_legal(rng):
    """Return a policy that now and then does what is illegal."""
    legal = random_policy(0)
    return lambda env, observation: int(rng.integers(len(env.action_masks()))) if rng.random() < 0.2 else legal(env, observation)


@pytest.mark.parametrize("overrides", [{}, ODD], ids=["default", "odd"])
@pytest.mark.parametrize("name", shipped_scenes())
def test_terms_sum_to_the_reward_to_the_last_bit(name, overrides, rng):
    env, weights = ResectEnv(name, reward=overrides), reward_weights(overrides)
    choose = mostly_legal(rng)
    for seed in range(3):
        for _, reward, _, _, info in play(env, choose, seed):
            assert_adds_up(reward, info["reward_terms"], weights)


@pytest.mark.parametrize("overrides", [{}, ODD], ids=["default", "odd"])
@pytest.mark.parametrize("name", shipped_scenes())
def test_terms_sum_to_the_reward_in_every_row_of_a_batch(name, overrides, rng):
    batch, weights = ResectVectorEnv(N_ROWS, name, reward=overrides), reward_weights(overrides)
    observation, _ = batch.reset(seed=0)
    begins = np.zeros(N_ROWS, bool)
    n_ended = 0
    while n_ended < N_ROWS:
        legal = np.array([rng.choice(np.flatnonzero(mask)) for mask in observation["action_mask"]])
        actions = np.where(rng.random(N_ROWS) < 0.2, rng.integers(batch.n_actions, size=N_ROWS), legal)
        observation, rewards, terminated, truncated, info = batch.step(actions)
        for row in range(N_ROWS):
            if begins[row]:
                assert rewards[row] == 0.0
            else:
                assert_adds_up(rewards[row], row_of(info, row), weights)
        begins = terminated | truncated
        n_ended += int(begins.sum())


# The certificate ---------------------------------------------------------------------------------------------------


def returns_of_certificates(scenes):
    """Return what every certificate earns: all scenes side by side, each in a row of its own."""
    batch = ResectVectorEnv(len(scenes), scenes, autoreset_mode=AutoresetMode.NEXT_STEP)
    earned = np.zeros(len(scenes))
    for row in range(len(scenes)):
        batch.reset(seed=0, options={"index": row, "reset_mask": np.arange(len(scenes)) == row})
    ends = np.array([len(scene.certificate.order) for scene in scenes])
    for step in range(ends.max()):
        plays = step < ends
        refused = batch.action_masks().argmin(axis=1)
        actions = [scene.certificate.order[step] if plays[row] else refused[row] for row, scene in enumerate(scenes)]
        _, rewards, terminated, _, info = batch.step(np.array(actions))
        earned += np.where(plays, rewards, 0.0)
        # Each ends with its last cut, neither before nor after.
        np.testing.assert_array_equal(terminated & plays, step + 1 == ends)
        assert info["is_success"][step + 1 == ends].all()
    return earned


def assert_earn_one(scenes):
    """Check certificates.

    1.5 less half of the costs over J*, cut by cut, while J* is summed before it is divided by: both round, so that the sum is 1
    to within some 1e-16, and not always to the last bit.
    """
    np.testing.assert_allclose(returns_of_certificates(scenes), 1.0, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize(("name", "split"), SPLITS)
def test_sampled_certificates_earn_one(name, split):
    scenes = load_scenes(name, split)
    # Some dozens of small bodies, few large ones.
    assert_earn_one(scenes[:: -(-len(scenes) * scenes[0].mesh.n_tetrahedra // 6000)])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "split"), SPLITS)
def test_every_certificate_earns_one(name, split):
    scenes = load_scenes(name, split)
    for first in range(0, len(scenes), 64):
        assert_earn_one(scenes[first : first + 64])
