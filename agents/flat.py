"""The flat policy, to compare with: stable-baselines3's plain network, which sees the whole observation as one vector."""

from collections.abc import Mapping
from typing import Any

import torch
from gymnasium import spaces
from sb3_contrib.common.maskable.policies import MaskableActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch import Tensor

from agents.training_config import FlatSettings
from envs.wrappers import FLAT_PARTS


class FlatParts(BaseFeaturesExtractor):
    """Write the tables of numbers of an observation one after another."""

    def __init__(self, observation_space: spaces.Dict) -> None:
        """Count the numbers."""
        super().__init__(observation_space, sum(spaces.flatdim(observation_space[part]) for part in FLAT_PARTS))

    def forward(self, observations: dict[str, Tensor]) -> Tensor:
        """Return the vectors, shape (batch, numbers)."""
        return torch.cat([observations[part].flatten(1) for part in FLAT_PARTS], dim=1)


class FlatPolicy(MaskableActorCriticPolicy):
    """MaskablePPO's policy over the Dict observation of Resect-v0, whose own mask says what is legal.

    It has an input for each number and an output for each action, so it plays only meshes as large as the one it learnt on.
    """

    def __init__(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, lr_schedule: Any, *, network: FlatSettings
    ) -> None:
        """Make one network for the actions, one like it for the value, and their optimizer."""
        self.settings = network
        # Fused: one pass over the millions of weights, where the plain optimizer takes ten; eps is stable-baselines3's own.
        super().__init__(
            observation_space, action_space, lr_schedule, net_arch=network.layers, features_extractor_class=FlatParts,
            optimizer_kwargs={"fused": True, "eps": 1e-5},
        )  # fmt: skip

    def _get_constructor_parameters(self) -> dict[str, Any]:
        spaces_ = {"observation_space": self.observation_space, "action_space": self.action_space}
        return {**spaces_, "lr_schedule": self._dummy_schedule, "network": self.settings}

    def forward(  # type: ignore[override]
        self, obs: dict[str, Tensor], deterministic: bool = False, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return one action per row, the values, (batch, 1), and the actions' log-probabilities."""
        return super().forward(obs, deterministic, _legal(obs, action_masks))  # type: ignore[arg-type]

    def evaluate_actions(  # type: ignore[override]
        self, obs: dict[str, Tensor], actions: Tensor, action_masks: Any = None
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Return the values, (batch, 1), the log-probabilities of the actions, and the entropies, to be differentiated."""
        return super().evaluate_actions(obs, actions, _legal(obs, action_masks))  # type: ignore[arg-type]

    def get_distribution(self, obs: dict[str, Tensor], action_masks: Any = None) -> Any:  # type: ignore[override]
        """Return the distribution of the action in each row."""
        return super().get_distribution(obs, _legal(obs, action_masks))  # type: ignore[arg-type]

    def predict(self, observation: Any, *arguments: Any, **keywords: Any) -> tuple[Any, Any]:
        """Choose a legal action for one observation, or one for each of a batch, as (action, state)."""
        # Stable-baselines3 refuses tables that were not shown in training, read or not.
        return super().predict({part: observation[part] for part in (*FLAT_PARTS, "action_mask")}, *arguments, **keywords)

    def misfit(self, weights: Mapping[str, Tensor]) -> str | None:
        """Return why the weights of a flat policy do not fit this one's mesh, None where they do."""
        fits = "{} numbers to see and {} actions".format
        own, other = (
            fits(of["mlp_extractor.policy_net.0.weight"].shape[1], of["action_net.bias"].shape[0])
            for of in (self.state_dict(), weights)
        )
        return None if own == other else f"a flat network is made for one size of mesh, {other}; this one has {own}"


def _legal(obs: dict[str, Tensor], action_masks: Any) -> Tensor:
    """Return what is legal by the observation, and by the mask from outside where there is one."""
    seen = obs["action_mask"].bool()
    return seen if action_masks is None else seen & torch.as_tensor(action_masks, dtype=torch.bool)
