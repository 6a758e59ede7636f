"""Wrappers of the environment for agents that want another form of it."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs

Array = np.ndarray[Any, Any]

FLAT_PARTS = ("nodes", "faces", "tetrahedra", "globals")
"""Tables of numbers; ids mean nothing to a plain network, and the mask reaches it by `action_masks`."""


class FlatObservation(gym.ObservationWrapper[Array, int, dict[str, Array]], RecordConstructorArgs):
    """Show chosen parts of the observation as one vector, for `MlpPolicy`; `parts` are written one after another."""

    def __init__(self, env: gym.Env[dict[str, Array], int], parts: tuple[str, ...] = FLAT_PARTS) -> None:
        """Wrap an environment whose observation is a dict of boxes."""
        RecordConstructorArgs.__init__(self, parts=parts)
        gym.ObservationWrapper.__init__(self, env)
        self.parts = tuple(parts)
        boxes = [env.observation_space[part] for part in self.parts]  # type: ignore[index]
        self.observation_space = spaces.Box(
            np.concatenate([box.low.ravel() for box in boxes]),
            np.concatenate([box.high.ravel() for box in boxes]),
            dtype=np.float32,
        )

    def action_masks(self) -> Array:
        """Return the legal actions, bool (n_actions,), as MaskablePPO asks for them."""
        masks: Array = self.env.get_wrapper_attr("action_masks")()
        return masks

    def observation(self, observation: dict[str, Array]) -> Array:
        """Return the parts as one vector, float32."""
        return np.concatenate([observation[part].ravel() for part in self.parts], dtype=np.float32)
