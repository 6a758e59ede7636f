"""The learned policy: one small network shared by all legal cuts, blind to how the mesh is numbered.

    features of each legal cut -> encoder -> mean and maximum over the cuts, with the globals -> context
    encoded cut + context -> logit of the cut;  context -> value of the state

To renumber tetrahedra or faces permutes the logits and nothing else, and a mesh may have any size.
"""

from typing import Any, NamedTuple

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from torch import Tensor, nn

from agents.features import N_FEATURES, Observed, gather_candidates

OBSERVATION_KEYS = (*Observed._fields, "action_mask")
"""The parts of the observation that the policy reads; the others may be absent."""
ILLEGAL = -1e9
"""Logit of padding: its probability is exactly 0 in float32."""


class CandidateBatch(NamedTuple):
    """The legal actions of a batch of observations, padded to the longest row."""

    action: Tensor
    """Action id, int64, shape (batch, n_candidates)."""
    is_legal: Tensor
    """False where padded, shape (batch, n_candidates)."""
    features: Tensor
    """float32, shape (batch, n_candidates, N_FEATURES)."""
    globals: Tensor
    """float32, shape (batch, n_globals)."""


class CandidateNetwork(nn.Module):
    """Score every candidate, and value the state they belong to."""

    def __init__(self, n_globals: int, hidden: int) -> None:
        """Make the layers; hidden: width of all of them."""
        super().__init__()
        self.encoder = nn.Sequential(nn.Linear(N_FEATURES, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.context = nn.Sequential(nn.Linear(2 * hidden + n_globals, hidden), nn.ReLU())
        self.from_candidate = nn.Linear(hidden, hidden)
        self.from_context = nn.Linear(hidden, hidden)
        self.logit = nn.Linear(hidden, 1)
        self.value_encoder = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU())
        self.value = nn.Linear(hidden, 1)
        for layer in self.modules():
            if isinstance(layer, nn.Linear):
                nn.init.orthogonal_(layer.weight, 1.0)
                nn.init.zeros_(layer.bias)
        with torch.no_grad():
            # All actions start about equally likely, and all values near zero.
            self.logit.weight.mul_(0.01)
            self.value.weight.mul_(0.1)

    def forward(self, batch: CandidateBatch) -> tuple[Tensor, Tensor]:
        """Return the logits, (batch, n_candidates), `ILLEGAL` where padded, and the values, (batch, 1)."""
        shape = batch.action.shape
        # One flat row per candidate: on views of three dimensions autograd copies whole tensors.
        encoded = self.encoder(batch.features.flatten(0, 1))
        rows = encoded.view(*shape, -1)
        weight = batch.is_legal / batch.is_legal.sum(1, keepdim=True).clamp(min=1)
        mean = torch.bmm(weight[:, None], rows)[:, 0]
        # Padding repeats a legal candidate, which leaves the maximum as it is.
        context = self.context(torch.cat([mean, rows.max(1).values, batch.globals], 1))
        joined = self.from_candidate(encoded).view(*shape, -1) + self.from_context(context)[:, None]
        logits = self.logit(joined.relu_().flatten(0, 1)).view(shape)
        return logits.masked_fill(~batch.is_legal, ILLEGAL), self.value(self.value_encoder(context))


class CandidatePolicy(MaskableActorCriticPolicy):
    """MaskablePPO's policy over the Dict observation of Resect-v0, whose own mask says what is legal."""

    def __init__(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, lr_schedule: Any, *, hidden: int = 64
    ) -> None:
        """Make the network and its optimizer."""
        self.hidden = hidden
        super().__init__(observation_space, action_space, lr_schedule)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        spaces_ = {"observation_space": self.observation_space, "action_space": self.action_space}
        return {**spaces_, "lr_schedule": self._dummy_schedule, "hidden": self.hidden}

    def _build(self, lr_schedule: Any) -> None:
        # The base class made layers that flatten the observation; nothing passes through them.
        self.network = CandidateNetwork(self.observation_space["globals"].shape[0], self.hidden)  # type: ignore[index]
        self.optimizer = torch.optim.Adam(self.parameters(), lr=lr_schedule(1), **self.optimizer_kwargs)

    def forward(  # type: ignore[override]
        self, obs: dict[str, Tensor], deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return one action per row, the values, and the actions' log-probabilities."""
        batch, log_probability, value = self._score(obs, action_masks)
        likeliest = log_probability.argmax(1, keepdim=True)
        place = likeliest if deterministic else torch.multinomial(log_probability.exp(), 1)
        return batch.action.gather(1, place)[:, 0], value, log_probability.gather(1, place)[:, 0]

    def evaluate_actions(  # type: ignore[override]
        self, obs: dict[str, Tensor], actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the values, the log-probabilities of the actions, and the entropies."""
        batch, log_probability, value = self._score(obs, action_masks)
        is_chosen = (batch.action == actions[:, None]) & batch.is_legal
        entropy = -(log_probability.exp() * log_probability).sum(1)
        return value, (log_probability * is_chosen).sum(1), entropy

    def predict_values(self, obs: dict[str, Tensor]) -> Tensor:  # type: ignore[override]
        """Return the values, shape (batch, 1)."""
        return self._score(obs, None)[2]

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
        tensors = {key: torch.as_tensor(part if is_batch else part[None]) for key, part in parts.items()}
        with torch.no_grad():
            action = self.forward(tensors, deterministic, action_masks)[0].numpy()
        return (action if is_batch else action[0]), state

    def _score(self, obs: dict[str, Tensor], action_masks: Any) -> tuple[CandidateBatch, Tensor, Tensor]:
        """Return the candidates, their log-probabilities, (batch, n_candidates), and the values, (batch, 1)."""
        mask = np.asarray(obs["action_mask"] if action_masks is None else action_masks)
        parts = Observed(*(obs[name].numpy() for name in Observed._fields))
        found = gather_candidates(parts, mask.reshape(len(parts.globals), -1))
        batch = CandidateBatch(
            action=torch.from_numpy(found.action),
            is_legal=torch.from_numpy(np.arange(found.action.shape[1]) < found.n_legal[:, None]),
            features=torch.from_numpy(found.features),
            globals=obs["globals"],
        )
        logits, value = self.network(batch)
        return batch, logits.log_softmax(1), value
