"""The environment as training sees it: less of it, shaped, several side by side."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from agents.candidate_policy import OBSERVATION_KEYS
from agents.features import AREA, IS_TARGET
from agents.training_config import TrainingConfig
from envs.library import load_scenes
from envs.resect import ResectEnv
from envs.scene import Scene

ENDING = ("is_success", "episode")
"""What the learner's statistics need of an episode's last info."""


class TrainingView(gym.Wrapper[Any, Any, Any, Any]):
    """Show only what the policy reads, and of the info only how an episode ends: the rest is copied for nothing.

    The reward is shaped by a potential, minus the part of the interface that is still sewn, so that every cut which
    gets on is rewarded at once (Ng, Harada and Russell, 1999: that changes no optimal policy).

    An episode that overruns its budget counts as over, because its return is: nothing lies behind it to be valued.
    """

    def __init__(self, env: gym.Env[Any, Any], shaping: float, gamma: float) -> None:
        """Wrap a Resect-v0; shaping: weight of the potential, discounted by gamma."""
        super().__init__(env)
        shown: Any = env.observation_space
        self.observation_space = gym.spaces.Dict({key: shown[key] for key in OBSERVATION_KEYS})
        self._shaping, self._gamma = shaping, gamma
        self._start_area = self._potential = 0.0

    def reset(self, **arguments: Any) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode."""
        observation, _ = self.env.reset(**arguments)
        self._start_area = interface_area(observation)
        self._potential = -self._shaping
        return self._shown(observation), {}

    def step(self, action: Any) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Act."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        has_ended = terminated or truncated
        # The potential of an ended episode is 0: then shaping changes the return of no policy more than of another.
        before, self._potential = self._potential, 0.0
        if not has_ended:
            self._potential = -self._shaping * interface_area(observation) / self._start_area
        shaped = float(reward) + self._gamma * self._potential - before
        ending: dict[str, Any] = {key: info[key] for key in ENDING if key in info} if has_ended else {}
        return self._shown(observation), shaped, has_ended, False, ending

    def _shown(self, observation: dict[str, Any]) -> dict[str, Any]:
        return {key: observation[key] for key in OBSERVATION_KEYS}


def interface_area(observation: dict[str, Any]) -> float:
    """Return the area of the sewn faces between target and healthy tissue, over h^2."""
    sides = observation["face_tetrahedra"].astype(np.intp)
    is_target = observation["tetrahedra"][:, IS_TARGET][sides]
    return float(observation["faces"][:, AREA] @ np.abs(is_target[:, 0] - is_target[:, 1]))


def make_environments(config: TrainingConfig) -> DummyVecEnv:
    """Return the training environments, side by side in this process.

    They deal the scenes out among themselves, for each settles every body that it plays for the first time.
    """
    scenes, count = load_scenes(config.scene, "train"), config.ppo.n_envs
    hands = [scenes[number % len(scenes) :: count] for number in range(count)]
    return DummyVecEnv([partial(_make_training_environment, hand, config) for hand in hands])


def _make_training_environment(scenes: Sequence[Scene], config: TrainingConfig) -> TrainingView:
    return TrainingView(Monitor(ResectEnv(scenes, mask=config.mask)), config.ppo.shaping, config.ppo.gamma)
