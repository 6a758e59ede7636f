"""MaskablePPO on ragged candidates: of what a state shows, only the features of its legal actions are kept and learnt from."""

from typing import Any

import torch
from sb3_contrib import MaskablePPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from agents.candidate_policy import CandidatePolicy, read_candidates
from agents.features import Candidates
from agents.rollout_buffer import CandidateBuffer


class CandidatePPO(MaskablePPO):
    """MaskablePPO of a `CandidatePolicy`; the mask is part of the observation, and an episode never ends but by being over.

    It learns what MaskablePPO learns, in less time: that stores whole observations, and gathers the same features from
    them in every epoch.
    """

    def __init__(self, policy: type[CandidatePolicy], env: Any, **settings: Any) -> None:
        """Make everything; settings: those of MaskablePPO, but for its buffer."""
        super().__init__(policy, env, **settings, rollout_buffer_class=CandidateBuffer)

    def collect_rollouts(
        self, env: VecEnv, callback: BaseCallback, rollout_buffer: Any, n_rollout_steps: int, use_masking: bool = True
    ) -> bool:
        """Play so many steps of every environment; return whether the callback let it."""
        self.policy.set_training_mode(False)
        rollout_buffer.reset()
        callback.on_rollout_start()
        candidates: Any = _candidates(self._last_obs)
        for _ in range(n_rollout_steps):
            with torch.inference_mode():
                actions, values, log_probs = self.policy(candidates)
            self._last_obs, rewards, dones, infos = env.step(actions.numpy())  # type: ignore[assignment]
            self.num_timesteps += env.num_envs
            callback.update_locals(locals())
            if not callback.on_step():
                return False
            self._update_info_buffer(infos, dones)
            rollout_buffer.add(candidates, actions, rewards, self._last_episode_starts, values, log_probs)
            self._last_episode_starts = dones.copy()
            candidates = _candidates(self._last_obs)
        with torch.inference_mode():
            values = self.policy.predict_values(candidates)
        rollout_buffer.compute_returns_and_advantage(values, dones)
        callback.on_rollout_end()
        return True


def _candidates(seen: Any) -> Candidates:
    """Return the candidates of what environments show: a batch of observations, or candidates already."""
    return seen if isinstance(seen, Candidates) else read_candidates(seen)
