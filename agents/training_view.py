"""The environments as training sees them: less of them, shaped, several side by side."""

import time
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from agents.candidate_policy import OBSERVATION_KEYS
from agents.features import AREA, IS_TARGET
from agents.training_config import TrainingConfig
from agents.vector_face import ResectVecEnv

Array = np.ndarray[Any, Any]


class TrainingView(VecEnvWrapper):
    """Show only what the policy reads, and of the info only how an episode ended.

    The reward is shaped by a potential, minus the part of the interface that is still sewn, so that every cut which
    gets on is rewarded at once (Ng, Harada and Russell, 1999: that changes no optimal policy).

    An episode that overruns its budget counts as over, because its return is: nothing lies behind it to be valued.
    """

    def __init__(self, environments: VecEnv, shaping: float, gamma: float) -> None:
        """Wrap environments that begin anew by themselves; shaping: weight of the potential, discounted by gamma."""
        shown: Any = environments.observation_space
        super().__init__(environments, gym.spaces.Dict({key: shown[key] for key in OBSERVATION_KEYS}))
        self._shaping, self._gamma = shaping, gamma
        self._interface = np.zeros((self.num_envs, len(shown["faces"].low)), np.float32)
        self._start_area, self._potential = np.ones(self.num_envs), np.zeros(self.num_envs)
        self._return, self._length = np.zeros(self.num_envs), np.zeros(self.num_envs, np.int64)
        self._started = time.perf_counter()

    def reset(self) -> dict[str, Array]:
        """Start an episode everywhere."""
        observation: Any = self.venv.reset()
        self._begin(observation, np.arange(self.num_envs))
        return _shown(observation)

    def step_wait(self) -> tuple[dict[str, Array], Array, Array, list[dict[str, Any]]]:
        """Act everywhere; where an episode ends, what is seen is the next one's beginning."""
        observation: Any
        observation, rewards, dones, infos = self.venv.step_wait()
        self._return += rewards
        self._length += 1
        # The potential of an ended episode is 0: then shaping changes the return of no policy more than of another.
        before = self._potential
        self._potential = -self._shaping * self._sewn(observation) / self._start_area
        shaped = rewards + self._gamma * np.where(dones, 0.0, self._potential) - before
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
        self._interface[rows] = is_interface({key: observation[key][rows] for key in ("face_tetrahedra", "tetrahedra")})
        self._start_area[rows] = self._sewn(observation)[rows]
        self._potential[rows] = -self._shaping
        self._return[rows], self._length[rows] = 0.0, 0

    def _sewn(self, observation: dict[str, Array]) -> Array:
        """Return the area of the sewn faces between target and healthy tissue, over h^2: a face that is cut has none."""
        return np.einsum("ij,ij->i", observation["faces"][:, :, AREA], self._interface, dtype=np.float64)

    def _ending(self, row: int, info: dict[str, Any]) -> dict[str, Any]:
        """Return what the learner's statistics and stable-baselines3 need of an episode's end."""
        seconds = round(time.perf_counter() - self._started, 6)
        episode = {"r": float(self._return[row]), "l": int(self._length[row]), "t": seconds}
        return {"is_success": info["is_success"], "episode": episode, "TimeLimit.truncated": False}


def _shown(observation: dict[str, Array]) -> dict[str, Array]:
    return {key: observation[key] for key in OBSERVATION_KEYS}


def is_interface(observation: dict[str, Array]) -> Array:
    """Tell which faces lie between target and healthy tissue, both alive, in one observation or a batch."""
    sides = observation["face_tetrahedra"].astype(np.intp)
    is_target = observation["tetrahedra"][..., IS_TARGET] > 0.0
    one, other = (np.take_along_axis(is_target, sides[..., side], axis=-1) for side in range(2))
    found: Array = one != other
    return found


def interface_area(observation: dict[str, Array]) -> Array:
    """Return the area of the sewn faces between target and healthy tissue, over h^2, in one observation or a batch."""
    area: Array = (observation["faces"][..., AREA] * is_interface(observation)).sum(axis=-1)
    return area


def make_environments(config: TrainingConfig) -> VecEnv:
    """Return the training environments, side by side in this process."""
    environments = ResectVecEnv(config.ppo.n_envs, scene=config.scene, split="train", mask=config.mask)
    return TrainingView(environments, config.shaping.weight if config.shaping else 0.0, config.ppo.gamma)
