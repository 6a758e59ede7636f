"""What PPO remembers of its play: of each state the features of its legal actions, gathered once and never padded."""

from typing import Any

import numpy as np
from sb3_contrib.common.maskable.buffers import MaskableRolloutBufferSamples
from stable_baselines3.common.buffers import RolloutBuffer
from torch import Tensor

from agents.features import Candidates, join

Array = np.ndarray[Any, Any]

_OF_STATES = ("actions", "values", "log_probs", "advantages", "returns")
"""What a sample holds of each state beside its candidates, in order."""


class CandidateBuffer(RolloutBuffer):
    """The steps of one rollout; state `step * n_envs + env` is what an environment showed before a step."""

    def reset(self) -> None:
        """Forget all steps."""
        self.states: list[Candidates] = []
        for name in (*_OF_STATES, "rewards", "episode_starts"):
            setattr(self, name, np.zeros((self.buffer_size, self.n_envs), np.float32))
        self.pos, self.full = 0, False
        # The base class would lay all arrays environment by environment before it draws samples.
        self.generator_ready = True

    def add(  # type: ignore[override]
        self, candidates: Candidates, action: Array, reward: Array, episode_start: Array, value: Tensor, log_prob: Tensor
    ) -> None:
        """Remember one step of all environments."""
        self.states += candidates.split()
        self.actions[self.pos], self.rewards[self.pos], self.episode_starts[self.pos] = action, reward, episode_start
        self.values[self.pos], self.log_probs[self.pos] = value.flatten(), log_prob
        self.pos += 1
        self.full = self.pos == self.buffer_size

    def _get_samples(self, batch_inds: Array, env: Any = None) -> MaskableRolloutBufferSamples:  # type: ignore[override]
        """Return some states as MaskablePPO takes them; what it hands on as observations are their candidates."""
        of_states = [self.to_torch(getattr(self, name).ravel()[batch_inds]) for name in _OF_STATES]
        samples: Any = (join([self.states[state] for state in batch_inds]), *of_states, None)
        return MaskableRolloutBufferSamples(*samples)
