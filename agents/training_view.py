"""The environments as training sees them: less of them, shaped, several side by side."""

import time
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from agents.candidate_policy import OBSERVATION_KEYS
from agents.mixed_view import MixedView
from agents.potentials import POTENTIALS
from agents.training_config import Shaping, TrainingConfig
from agents.vector_face import ResectVecEnv

Array = np.ndarray[Any, Any]


class TrainingView(VecEnvWrapper):
    """Show only what the policy reads, and of the info only how an episode ended.

    The reward is shaped by a potential, minus the share that is left to do, so that every cut which gets on is rewarded
    at once (Ng, Harada and Russell, 1999: that changes no optimal policy).

    An episode that overruns its budget counts as over, because its return is: nothing lies behind it to be valued.
    """

    def __init__(self, environments: ResectVecEnv, shaping: Shaping | None, gamma: float) -> None:
        """Wrap environments that begin anew by themselves; shaping: None for rewards as they are, else discounted by gamma."""
        shown: Any = environments.observation_space
        super().__init__(environments, gym.spaces.Dict({key: shown[key] for key in OBSERVATION_KEYS}))
        self._shaping, self._gamma = shaping or Shaping(weight=0.0), gamma
        self._potential = POTENTIALS[self._shaping.potential](environments.scene_of)
        self._whole, self._value = np.ones(self.num_envs), np.zeros(self.num_envs)
        self._return, self._length = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._actions = np.zeros(self.num_envs, np.int64)
        self._started = time.perf_counter()

    def reset(self) -> dict[str, Array]:
        """Start an episode everywhere."""
        observation: Any = self.venv.reset()
        self._begin(observation, np.arange(self.num_envs))
        return _shown(observation)

    def step_async(self, actions: Array) -> None:
        """Keep the actions."""
        self._actions = actions
        super().step_async(actions)

    def step_wait(self) -> tuple[dict[str, Array], Array, Array, list[dict[str, Any]]]:
        """Act everywhere; where an episode ends, what is seen is the next one's beginning."""
        observation: Any
        observation, rewards, dones, infos = self.venv.step_wait()
        self._return += rewards
        self._length += 1
        # The potential of an ended episode is 0: then shaping changes the return of no policy more than of another.
        before, self._value = self._value, np.zeros(self.num_envs)
        goes_on = np.flatnonzero(~dones)
        left = self._potential.proceed(goes_on, self._actions[goes_on], observation)
        self._value[goes_on] = -self._shaping.weight * left / self._whole[goes_on]
        shaped = rewards + self._gamma * self._value - before
        endings: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = np.flatnonzero(dones)
        for row in map(int, ended):
            endings[row] = self._ending(row, infos[row])
        self._begin(observation, ended)
        return _shown(observation), shaped.astype(np.float32), dones, endings

    def _begin(self, observation: dict[str, Array], rows: Array) -> None:
        """Start counting anew in some rows."""
        if not len(rows):
            return
        self._whole[rows] = self._potential.begin(rows, observation)
        self._value[rows] = -self._shaping.weight
        self._return[rows], self._length[rows] = 0.0, 0

    def _ending(self, row: int, info: dict[str, Any]) -> dict[str, Any]:
        """Return what the learner's statistics and stable-baselines3 need of an episode's end."""
        seconds = round(time.perf_counter() - self._started, 6)
        episode = {"r": float(self._return[row]), "l": int(self._length[row]), "t": seconds}
        return {"is_success": info["is_success"], "episode": episode, "TimeLimit.truncated": False}


def _shown(observation: dict[str, Array]) -> dict[str, Array]:
    return {key: observation[key] for key in OBSERVATION_KEYS}


def make_environments(config: TrainingConfig) -> VecEnv:
    """Return the training environments, side by side in this process, each scene's as many."""
    n_envs = config.ppo.n_envs // len(config.scenes)
    views = [
        TrainingView(ResectVecEnv(n_envs, scene=scene, split="train", mask=config.mask), config.shaping, config.ppo.gamma)
        for scene in config.scenes
    ]
    return views[0] if len(views) == 1 else MixedView(views)
