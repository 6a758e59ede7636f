"""Pictures as observations: they fit gymnasium and stable-baselines3, show what is seen, and tell nothing more."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from envs.frames import camera_of
from envs.pixels import PixelObservation, with_depth
from envs.resect import ResectEnv
from gmapspring import render
from gmapspring.errors import ConfigError
from tests.small_scene import small_scene

SCENE = small_scene()


@pytest.mark.parametrize(("mode", "channels"), [("rgb", 3), ("rgbd", 4)])
def test_the_wrapped_environment_passes_the_check(mode, channels):
    env = PixelObservation(ResectEnv(SCENE), mode)
    check_env(env, skip_render_check=True)
    observation, _ = env.reset(seed=0)
    assert observation.shape == (84, 84, channels) and observation.dtype == np.uint8
    assert env.observation_space.contains(observation)


def test_a_wrapped_environment_is_made_again_from_its_spec():
    env = PixelObservation(gym.make("envs:Resect-v0", scene="box-48", disable_env_checker=True), mode="rgbd", size=48)
    again = gym.make(env.spec)
    np.testing.assert_array_equal(env.reset(seed=1)[0], again.reset(seed=1)[0])


def test_depth_is_that_of_the_faces_in_front():
    env = PixelObservation(ResectEnv(SCENE), "rgbd", 64)
    observation, _ = env.reset(seed=0)
    camera = camera_of(SCENE, (64, 64))
    # Each pixel has four samples: the centres of the pixels of a picture of twice the size.
    seen = render.see_faces(env.unwrapped.task.simulation.body, camera, (128, 128))
    nearest = seen.depth.reshape(64, 2, 64, 2).min(axis=(1, 3))
    is_seen = np.isfinite(nearest)
    assert (observation[~is_seen, 3] == 0).all() and (observation[is_seen, 3] > 0).all()
    # 254 steps over one distance of the camera: rounding is off by half a step at most.
    depth = (382.0 - observation[is_seen, 3]) * camera.distance / 254.0
    np.testing.assert_allclose(depth, nearest[is_seen], atol=0.51 * camera.distance / 254.0)


def test_a_wrapped_environment_tells_what_is_legal():
    plain = ResectEnv(SCENE)
    env = PixelObservation(plain)
    env.reset(seed=0)
    np.testing.assert_array_equal(env.action_masks(), plain.action_masks())


def test_depths_beyond_the_range_end_at_its_ends():
    camera = camera_of(SCENE)
    depth = np.array([[0.0, 0.5, 1.0, 1.5, 9.0, np.inf]]) * camera.distance
    picture = np.arange(18, dtype=np.uint8).reshape(1, 6, 3)
    joined = with_depth(picture, depth, camera)
    np.testing.assert_array_equal(joined[..., 3], [[255, 255, 128, 1, 1, 0]])
    np.testing.assert_array_equal(joined[..., :3], picture)


def test_pictures_change_with_cuts_and_tell_nothing_of_optimum_or_certificate():
    misled = dataclasses.replace(SCENE, certificate=dataclasses.replace(SCENE.certificate, optimum=3.0, order=(1, 2)))
    one, other = (PixelObservation(ResectEnv(scene), "rgbd") for scene in (SCENE, misled))
    first, _ = one.reset(seed=0)
    np.testing.assert_array_equal(first, other.reset(seed=0)[0])
    legal = np.flatnonzero(one.unwrapped.action_masks())
    for action in (legal[-1], legal[-3]):
        seen = one.step(action)[0]
        np.testing.assert_array_equal(seen, other.step(action)[0])
    assert (seen != first).any()


def test_unknown_modes_and_sizes_are_refused():
    with pytest.raises(ConfigError, match="no pixel mode 'rbg'; did you mean 'rgb'"):
        PixelObservation(ResectEnv(SCENE), "rbg")
    for size in (8, 84.0, True):
        with pytest.raises(ConfigError, match="size must be a whole number from 36 to 1024"):
            PixelObservation(ResectEnv(SCENE), size=size)


@pytest.mark.parametrize("mode", ["rgb", "rgbd"])
def test_training_from_pixels_starts_and_keeps_to_legal_actions(mode):
    maskable = pytest.importorskip("sb3_contrib").MaskablePPO
    illegal = []

    class Watched(gym.Wrapper):
        def step(self, action):
            found = self.env.step(action)
            illegal.append(found[-1]["is_illegal"])
            return found

    env = Watched(PixelObservation(ResectEnv(SCENE), mode, 36))
    small = {"features_extractor_kwargs": {"features_dim": 16}}
    model = maskable("CnnPolicy", env, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs=small)
    model.learn(16)
    assert len(illegal) == 16 and not any(illegal)
