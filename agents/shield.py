"""The shield: it lets a policy do nothing after which the body collapses at once, as far as there is anything else to do."""

from typing import Any

import gymnasium as gym
import numpy as np

from agents.evaluation import Policy
from agents.trials import Trials, has_collapsed, n_simulated
from gmapspring.errors import ConfigError

Array = np.ndarray[Any, Any]


class ShieldedPolicy:
    """Try what another policy proposes on the simulator, and have it propose again where that ends in a collapse.

    Each action refused is taken out of the mask. Looking one step ahead is not enough to survive: where every action left
    ends in a collapse, the first proposal is done.
    """

    def __init__(self, policy: Policy, env: gym.Env[Any, Any], n_proposals: int | None = None) -> None:
        """Wrap a policy that plays this environment.

        Args:
            policy: who proposes.
            env: the environment that is played, wrapped or not.
            n_proposals: how often it may propose before its first proposal is done; None for as long as actions are left.

        Raises:
            ConfigError: it may not propose at all.
        """
        if n_proposals is not None and n_proposals < 1:
            raise ConfigError(f"n_proposals is {n_proposals}; give at least 1")
        self._policy = policy
        self._env: Any = env.unwrapped
        self._n_proposals = np.inf if n_proposals is None else n_proposals
        self._trials = Trials()

    @property
    def n_simulated(self) -> int:
        """Return how many steps of the simulator have been spent, those of the wrapped policy included."""
        return self._trials.n_steps + n_simulated(self._policy)

    def predict(
        self,
        observation: dict[str, Array],
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
        action_masks: Array | None = None,
    ) -> tuple[Any, Any]:
        """Choose a legal action for one observation, or for a batch of one, as (action, state)."""
        mask = np.array(observation["action_mask"] if action_masks is None else action_masks, dtype=bool)
        proposals: list[tuple[Any, Any]] = []
        while len(proposals) < self._n_proposals and mask.any():
            proposals.append(self._policy.predict(observation, state, episode_start, deterministic, mask))
            action = np.asarray(proposals[-1][0]).item()
            # A policy that goes beyond its mask would only do so again.
            if not mask[..., action].all():
                break
            if self._is_safe(action):
                return proposals[-1]
            mask[..., action] = False
        return proposals[0]

    def _is_safe(self, action: int) -> bool:
        """Return whether the body still stands after an action."""
        task = self._env.task
        with self._trials.after(task, action):
            return not has_collapsed(task)
