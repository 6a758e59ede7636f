"""What an agent is shown tells nothing of J* or the certificate: scenes that differ in these alone look alike to the last bit."""

import dataclasses

import numpy as np
import pytest

from envs.library import load_scenes, shipped_scenes
from envs.resect import ResectEnv
from envs.vector import ResectVectorEnv

N_STEPS = 40
ENDLESS = 1e6
"""A budget that ends no episode, in J*."""


def differing(scene):
    """Return scenes that differ in nothing but what was found out about them, and in their budget."""
    true = scene.certificate
    false = dataclasses.replace(
        true, optimum=1.7 * true.optimum, order=true.order[::-1], load_factor=3.0 * true.load_factor,
        peak_strain=0.1, lowest_volume_ratio=0.9,
    )  # fmt: skip
    plain = dataclasses.replace(scene, budget=ENDLESS)
    misled = dataclasses.replace(scene, certificate=false, budget=2.0 * ENDLESS)
    return plain, misled, dataclasses.replace(plain, certificate=None)


def shown(env, choose):
    """Play an episode, or side by side as many as there are rows; yield all that an agent is shown, and when it ends."""
    observation, _ = env.reset(seed=0)
    yield observation, env.action_masks(), env.step_limit
    for _ in range(N_STEPS):
        observation, _, terminated, truncated, _ = env.step(choose(env.action_masks()))
        yield observation, env.action_masks(), terminated, truncated
        if np.all(terminated):
            return


def assert_same_sight(envs, choose):
    """Play all alike and compare what they show; choose: makes a source of actions, the same for each."""
    n_shown = 0
    for one, *others in zip(*(shown(env, choose()) for env in envs), strict=True):
        for other in others:
            assert bits(other) == bits(one)
        n_shown += 1
    assert n_shown > 2


def bits(seen):
    """Return whatever is shown as bytes."""
    if isinstance(seen, dict):
        return {name: bits(part) for name, part in seen.items()}
    if isinstance(seen, tuple):
        return tuple(bits(part) for part in seen)
    return np.asarray(seen).tobytes()


def single_actions(seed):
    """Return a source of actions for one environment, now and then an illegal one."""
    rng = np.random.default_rng(seed)

    def choose(mask):
        return int(rng.choice(np.flatnonzero(mask) if rng.random() < 0.9 else len(mask)))

    return choose


def batch_actions(seed):
    """Return the same for rows."""
    choose = single_actions(seed)
    return lambda masks: np.array([choose(mask) for mask in masks])


@pytest.mark.parametrize("mask", ["all", "reachable", "focus"])
@pytest.mark.parametrize("name", shipped_scenes())
def test_an_environment_shows_nothing_of_the_optimum(name, mask):
    envs = [ResectEnv(scene, mask=mask) for scene in differing(load_scenes(name, "test")[0])]
    assert len({env.optimum for env in envs}) > 1
    assert_same_sight(envs, lambda: single_actions(0))


@pytest.mark.parametrize("name", shipped_scenes())
def test_a_batch_shows_nothing_of_the_optimum(name):
    envs = [ResectVectorEnv(3, scene) for scene in differing(load_scenes(name, "test")[0])]
    assert_same_sight(envs, lambda: batch_actions(1))


def test_a_certificate_changes_the_rewards_and_the_budget_alone():
    plain, other, _ = (ResectEnv(scene) for scene in differing(load_scenes("box-48", "test")[0]))
    for env in (plain, other):
        env.reset(seed=0)
    action = int(np.flatnonzero(plain.action_masks())[0])
    # reward: -0.5 cost / J*, and the other J* is 1.7 times as large
    assert plain.step(action)[1] == pytest.approx(1.7 * other.step(action)[1])
