"""The batch of environments as stable-baselines3 sees it."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import VecEnv

from envs.scene import Scene
from envs.vector import ResectVectorEnv
from gmapspring.errors import ConfigError

Array = np.ndarray[Any, Any]


class ResectVecEnv(VecEnv):
    """Step a `ResectVectorEnv` for stable-baselines3, in mode SAME_STEP; infos are told of ended episodes alone."""

    def __init__(self, num_envs: int, **arguments: Any) -> None:
        """Make the environments; see `ResectVectorEnv`."""
        self.envs = ResectVectorEnv(num_envs, autoreset_mode=AutoresetMode.SAME_STEP, **arguments)
        self.render_mode = self.envs.render_mode
        super().__init__(num_envs, self.envs.single_observation_space, self.envs.single_action_space)
        self._actions = np.zeros(num_envs, np.int64)

    def reset(self) -> dict[str, Array]:
        """Start an episode everywhere, seeded if `seed` was called before."""
        seeds: Any = self._seeds if any(seed is not None for seed in self._seeds) else None
        observation, info = self.envs.reset(seed=seeds, options=self._options[0] or None)
        self.reset_infos = [{key: info[key][row] for key in ("scene", "scene_seed")} for row in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: Array) -> None:
        """Keep the actions."""
        self._actions = actions

    def step_wait(self) -> tuple[dict[str, Array], Array, Array, list[dict[str, Any]]]:
        """Act everywhere; where an episode ends, what is seen is the next one's beginning."""
        observation, rewards, terminated, truncated, info = self.envs.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(dones).tolist():
            infos[row] = _row_of(info["final_info"], row) | {
                "terminal_observation": info["final_obs"][row], "TimeLimit.truncated": bool(truncated[row]),
            }  # fmt: skip
        return observation, rewards.astype(np.float32), dones, infos

    def scene_of(self, row: int) -> Scene:
        """Return the scene that a row plays."""
        return self.envs.scene_of(row)

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the whole batch, once for each row."""
        return [getattr(self.envs, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: rows share their attributes."""
        raise ConfigError(f"{attr_name} cannot be set: the rows of a batch share it; make another batch")

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **keywords: Any) -> list[Any]:
        """Call a method of the batch and return, of what it returns, the part of each row."""
        found = getattr(self.envs, method_name)(*arguments, **keywords)
        return [found[row] for row in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Tell that no row is wrapped."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[Array | None]:
        """Return a frame of each row."""
        return self.envs.render() or [None] * self.num_envs


def _row_of(info: dict[str, Any], row: int) -> dict[str, Any]:
    """Return the info of one row."""
    return {
        key: _row_of(values, row) if isinstance(values, dict) else values[row].item() if values.dtype != object else values[row]
        for key, values in info.items()
        if not key.startswith("_")
    }
