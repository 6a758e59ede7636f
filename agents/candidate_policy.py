"""The learned policy: the candidate network between observations, or candidates gathered from them before, and actions."""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from torch import Tensor

from agents.candidate_network import CandidateNetwork, Owners, Seen
from agents.features import Candidates, Observed, gather_candidates
from agents.layers import Graph
from agents.segments import Segments, highest, segments, total
from agents.training_config import NetworkSettings
from gmapspring.jit import kernel

OBSERVATION_KEYS = (*Observed._fields, "action_mask")
"""The parts of the observation that the policy reads; the others may be absent."""


class CandidatePolicy(MaskableActorCriticPolicy):
    """MaskablePPO's policy over the Dict observation of Resect-v0, whose own mask says what is legal.

    Where stable-baselines3 hands over a batch of observations, `Candidates` will do as well.
    """

    def __init__(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, lr_schedule: Any, *, network: NetworkSettings
    ) -> None:
        """Make the network and its optimizer."""
        self.settings = network
        super().__init__(observation_space, action_space, lr_schedule)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        spaces_ = {"observation_space": self.observation_space, "action_space": self.action_space}
        return {**spaces_, "lr_schedule": self._dummy_schedule, "network": self.settings}

    def _build(self, lr_schedule: Any) -> None:
        # The base class made layers that flatten the observation; nothing passes through them.
        self.network = CandidateNetwork(self.settings)
        # Fused: one call for all parameters, where the plain one takes ten for each.
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), fused=True, **self.optimizer_kwargs)

    def forward(  # type: ignore[override]
        self, obs: dict[str, Tensor] | Candidates, deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return one action per row, the values, (batch, 1), and the actions' log-probabilities."""
        candidates, of, log_probability, value = self._score(obs, action_masks)
        row = highest(log_probability, of) if deterministic else _drawn(log_probability, of)
        return torch.from_numpy(candidates.action)[row].long(), value[:, None], log_probability[row]

    def evaluate_actions(  # type: ignore[override]
        self, obs: dict[str, Tensor] | Candidates, actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the values, (batch, 1), the log-probabilities of the actions, and the entropies, to be differentiated."""
        candidates, of, log_probability, value = self._score(obs, action_masks)
        is_chosen = torch.from_numpy(candidates.action) == actions.flatten().index_select(0, of.state_of)
        entropy = -total(log_probability.exp() * log_probability, of)
        return value[:, None], total(log_probability * is_chosen, of), entropy

    def predict_values(self, obs: dict[str, Tensor] | Candidates) -> Tensor:  # type: ignore[override]
        """Return the values, shape (batch, 1)."""
        return self._score(obs, None)[3][:, None]

    def predict(  # type: ignore[override]
        self,
        observation: dict[str, np.ndarray],
        state: Any = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
        action_masks: np.ndarray | None = None,
    ) -> tuple[Any, Any]:
        """Choose a legal action for one observation, or one for each of a batch, as (action, state)."""
        is_batch = np.ndim(observation["globals"]) == 2
        parts = {key: np.asarray(observation[key]) for key in OBSERVATION_KEYS}
        candidates = read_candidates(parts if is_batch else {key: part[None] for key, part in parts.items()}, action_masks)
        with torch.inference_mode():
            action = self.forward(candidates, deterministic)[0].numpy()
        return (action if is_batch else action[0]), state

    def _score(self, obs: dict[str, Tensor] | Candidates, action_masks: Any) -> tuple[Candidates, Segments, Tensor, Tensor]:
        """Return (candidates, which are whose, their log-probabilities, values of the states)."""
        candidates = obs if isinstance(obs, Candidates) else read_candidates(obs, action_masks)
        of = Owners(segments(candidates.offset), segments(candidates.tetrahedron_offset))
        return candidates, of.candidates, *self.network(*_prepared(candidates), of)


def _prepared(candidates: Candidates) -> tuple[Seen, Graph]:
    """Return what the network takes: rows of a state's own tetrahedra become rows of all."""
    n_candidates, n_tetrahedra = len(candidates.sides), len(candidates.neighbours)
    sides, offset = np.empty((2, n_candidates), np.int64), np.zeros(n_tetrahedra + 1, np.int64)
    neighbours = np.empty(candidates.neighbours.size, np.int64)
    _renumber(candidates, sides, neighbours, offset)
    arrays = candidates.features, sides, candidates.tetrahedra, candidates.of_state
    graph = Graph(torch.from_numpy(neighbours[: offset[-1]]), torch.from_numpy(offset))
    return Seen(*map(torch.from_numpy, arrays)), graph


@kernel
def _renumber(candidates, sides, neighbours, offset):
    """Write sides and neighbours as rows of all tetrahedra, and where each one's neighbours end."""
    n_neighbours = 0
    for state in range(len(candidates.offset) - 1):
        start = candidates.tetrahedron_offset[state]
        for candidate in range(candidates.offset[state], candidates.offset[state + 1]):
            for side in range(2):
                sides[side, candidate] = start + candidates.sides[candidate, side]
        for tet in range(start, candidates.tetrahedron_offset[state + 1]):
            for corner in range(4):
                if candidates.neighbours[tet, corner] >= 0:
                    neighbours[n_neighbours] = start + candidates.neighbours[tet, corner]
                    n_neighbours += 1
            offset[tet + 1] = n_neighbours


def read_candidates(obs: Any, action_masks: Any = None) -> Candidates:
    """Return the legal actions of a batch of observations, fewer by a mask from outside where there is one."""
    observed, mask = Observed(*(np.asarray(obs[name]) for name in Observed._fields)), np.asarray(obs["action_mask"])
    if action_masks is not None:
        # What is gone shows nothing, whoever allows it.
        mask = (mask != 0) & (np.asarray(action_masks).reshape(mask.shape) != 0)
    return gather_candidates(observed, mask)


def _drawn(log_probability: Tensor, of: Segments) -> Tensor:
    """Draw one row of each state; the chances come from torch's generator."""
    # Laid end to end, the probabilities of a state cover about one unit of a line: a point of it is drawn.
    end = log_probability.double().exp().cumsum(0)
    last = of.first + of.length - 1
    to = end[last]
    begin = torch.cat([to.new_zeros(1), to[:-1]])
    point = begin + torch.rand_like(to) * (to - begin)
    return torch.minimum(torch.searchsorted(end, point, right=True), last)
