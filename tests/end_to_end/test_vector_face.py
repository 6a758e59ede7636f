"""The batch under stable-baselines3: the same as its own vector of single environments, and MaskablePPO learns on it."""

import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.vector_face import ResectVecEnv
from envs.resect import ResectEnv
from gmapspring.errors import ConfigError
from tests.small_scene import small_scene

SCENES = [small_scene(seed) for seed in range(4)]


def test_it_gives_what_single_environments_give():
    ours, theirs = ResectVecEnv(3, scene=SCENES), DummyVecEnv([lambda: ResectEnv(SCENES)] * 3)
    rng, n_ended = np.random.default_rng(0), 0
    for each in (ours, theirs):
        each.seed(5)
    seen, expected = ours.reset(), theirs.reset()
    assert ours.reset_infos == theirs.reset_infos
    for _ in range(60):
        assert all(np.array_equal(seen[key], expected[key]) for key in expected)
        masks = np.stack(ours.env_method("action_masks"))
        assert np.array_equal(masks, np.stack(theirs.env_method("action_masks")))
        actions = np.array([rng.choice(np.flatnonzero(mask)) for mask in masks])
        seen, rewards, dones, infos = ours.step(actions)
        expected, their_rewards, their_dones, their_infos = theirs.step(actions)
        assert np.array_equal(rewards, their_rewards) and np.array_equal(dones, their_dones)
        for row in np.flatnonzero(dones):
            last, their_last = infos[row].pop("terminal_observation"), their_infos[row].pop("terminal_observation")
            assert all(np.array_equal(last[key], their_last[key]) for key in their_last)
            assert infos[row] == their_infos[row]
            n_ended += 1
    assert n_ended > 3


def test_maskable_ppo_learns_on_it():
    from sb3_contrib import MaskablePPO

    envs = ResectVecEnv(4, scene=SCENES, mask="reachable")
    model = MaskablePPO("MultiInputPolicy", envs, n_steps=16, batch_size=16, n_epochs=1, device="cpu", seed=0)
    model.learn(64)
    observation = envs.reset()
    masks = np.stack(envs.env_method("action_masks"))
    actions, _ = model.predict(observation, action_masks=masks)
    assert masks[np.arange(4), actions].all()


def test_what_rows_share_cannot_be_set_for_one():
    envs = ResectVecEnv(2, scene=SCENES)
    assert envs.get_attr("mask_mode") == ["all", "all"]
    assert envs.env_is_wrapped(object) == [False, False]
    with pytest.raises(ConfigError, match="mask_mode cannot be set"):
        envs.set_attr("mask_mode", "focus")
