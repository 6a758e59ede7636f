"""Resect-v0 replayed: the same seed and actions give the same bits, and snapshots and copies go on from where they are."""

import copy
import hashlib
import pickle
import subprocess
import sys

import numpy as np
import pytest

from envs.resect import ResectEnv
from gmapspring.errors import StateFileError
from tests.bits import assert_same_bits, bits_of
from tests.small_scene import VARIANTS, first_scenes, play, random_policy, small_scene, variant_scene

SCENES = [small_scene(seed) for seed in range(4)]


def digest(steps):
    """Return a hash of everything that an episode gave."""
    found = hashlib.sha256()
    for observation, reward, terminated, truncated, info in steps:
        for array in observation.values():
            found.update(array.tobytes())
        found.update(repr((reward, terminated, truncated, info)).encode())
    return found.hexdigest()


@pytest.fixture
def env():
    """Return an environment on four small scenes."""
    return ResectEnv(SCENES)


def test_an_episode_repeats_to_the_last_bit(env):
    assert digest(play(env, random_policy(1), 7)) == digest(play(env, random_policy(1), 7))


def test_an_episode_repeats_whatever_was_played_before(env):
    expected = digest(play(ResectEnv(SCENES), random_policy(1), 7))
    for seed in range(3):
        play(env, random_policy(seed), seed)
    assert digest(play(env, random_policy(1), 7)) == expected


def test_an_episode_repeats_in_a_fresh_process(env):
    program = (
        "from tests.end_to_end.test_replay import *;"
        "print(digest(play(ResectEnv(SCENES), random_policy(1), 7)))"
    )
    printed = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert printed.stdout.strip() == digest(play(env, random_policy(1), 7))


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_goes_on_from_the_middle_of_an_episode(env, duplicate):
    env.reset(seed=2)
    for _ in range(3):
        env.step(int(np.flatnonzero(env.action_masks())[7]))
    twin = duplicate(env)
    for _ in range(3):
        action = int(np.flatnonzero(env.action_masks())[3])
        assert digest([env.step(action)]) == digest([twin.step(action)])
    assert first_scenes(env) == first_scenes(twin)


@pytest.mark.parametrize("variant", VARIANTS)
def test_snapshots_of_the_task_restore_it_to_the_last_bit(variant):
    env = ResectEnv(variant_scene(variant))
    env.reset(seed=0)
    task = env.task
    rng = np.random.default_rng(0)
    for _ in range(4):
        state, action = task.save_state(), int(rng.choice(np.flatnonzero(task.action_mask())))
        task.step(action)
        once = bits_of(task.simulation)
        cost, outcome, tissue = task.cost, task.outcome, task.tissue
        task.load_state(state)
        task.step(action)
        assert_same_bits(once, bits_of(task.simulation))
        assert (cost, outcome, tissue) == (task.cost, task.outcome, task.tissue)


def test_a_snapshot_of_another_task_is_refused(env):
    other = ResectEnv(small_scene(cells=(2, 2, 1)))
    with pytest.raises(StateFileError, match=r"belongs to a task of \(24, "):
        env.task.load_state(other.task.save_state())


@pytest.mark.parametrize("change", [{"viscosity": 0.0}, {"damping": 0.01}])
def test_a_snapshot_of_a_task_with_other_forces_is_refused(env, change):
    other = ResectEnv(small_scene(physics=small_scene().physics.model_copy(update=change)))
    with pytest.raises(StateFileError, match=r"belongs to a task of \(48, "):
        env.task.load_state(other.task.save_state())
