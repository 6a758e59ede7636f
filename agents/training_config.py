"""The form of a training configuration."""

import pathlib
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from agents.potentials import POTENTIALS
from envs.actions import MASKS
from gmapspring.config import Config, check_config, names_of

MaskName = Annotated[str, names_of("mask", MASKS)]
UnitShare = Annotated[float, Field(gt=0.0, le=1.0)]


class PPOSettings(Config):
    """Settings of the learner (Schulman et al., 2017)."""

    n_envs: PositiveInt
    """Environments played side by side, in one process."""
    n_steps: PositiveInt
    """Steps of each environment between two updates."""
    batch_size: PositiveInt
    """Steps per gradient."""
    n_epochs: PositiveInt
    """Passes over the steps of an update."""
    learning_rate: PositiveFloat
    """At the start."""
    learning_rate_half_life: PositiveInt
    """Steps after which the learning rate is half of what it was."""
    clip_range: PositiveFloat
    """How far an update may move the ratio of new to old probabilities from 1. Of some 250 actions each starts with a
    small probability, which can grow only by this factor per update: short updates and a wide range learn faster."""
    entropy: NonNegativeFloat
    """Weight of the entropy in the loss."""
    gamma: UnitShare
    """Discount per step."""
    gae_lambda: UnitShare
    averaged_updates: PositiveInt = 1
    """About how many updates the weights of the policy that is validated and saved are averaged over; 1 for no averaging."""

    @model_validator(mode="after")
    def _batch_fits(self) -> Self:
        if self.n_envs * self.n_steps % self.batch_size:
            raise ValueError(f"batch_size {self.batch_size} does not divide n_envs * n_steps = {self.n_envs * self.n_steps}")
        return self


class NetworkSettings(Config):
    """Shape of the candidate network."""

    kind: Literal["candidates"] = "candidates"
    hidden: PositiveInt = 32
    """Width of its layers."""
    rounds: NonNegativeInt = 3
    """Rounds of messages between tetrahedra that are sewn to each other."""
    heads: PositiveInt = 2
    """Weighted means over the tetrahedra of a state."""
    is_blind_to_strain: bool = False
    """Whether it does without what it sees of strains and volumes, to learn what these are worth."""


class FlatSettings(Config):
    """Shape of the flat network, which is there to compare with."""

    kind: Literal["flat"]
    layers: Annotated[list[PositiveInt], Field(min_length=1)] = [256, 256]
    """Widths of its hidden layers."""


def _with_kind(network: Any) -> Any:
    """Return the settings of a network with their kind."""
    return {"kind": "candidates"} | network if isinstance(network, dict) else network


Network = Annotated[FlatSettings | NetworkSettings, Field(discriminator="kind"), BeforeValidator(_with_kind)]
"""Settings of a network of any kind: of candidates, unless another is named."""


class WarmStart(Config):
    """Say how the policy is cloned from the certificates of the training scenes before it plays (Pomerleau, 1989)."""

    epochs: PositiveInt = 8
    """Passes over all states along the certificates."""
    batch_size: PositiveInt = 64
    learning_rate: PositiveFloat = 3e-3
    """At the start; it falls to 0 in a straight line."""
    recordings: list[str] | None = None
    """Episodes to be cloned beside the certificates, as `gmapspring view` records them: files; relative paths start at the
    folder of the configuration. Each must free the target of a training scene."""

    @model_serializer(mode="wrap")
    def _without_nothing(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave recordings out where there are none: runs are told apart by what is in their configuration."""
        return {name: value for name, value in dump(self).items() if name != "recordings" or value}

    @field_validator("recordings")
    @classmethod
    def _start_at_the_configuration(cls, recordings: list[str] | None, info: ValidationInfo) -> list[str] | None:
        folder = (info.context or {}).get("folder", pathlib.Path())
        return recordings and [str(folder / path) for path in recordings]


class Shaping(Config):
    """Reward what gets on at once, by a potential that changes no optimum (Ng, Harada and Russell, 1999)."""

    potential: Annotated[str, names_of("potential", POTENTIALS)] = "interface"
    """What is left to do, a name of `agents.potentials.POTENTIALS`."""
    weight: NonNegativeFloat
    """What all of the potential is worth, in units of return."""


class StopRule(Config):
    """When training ends: at whichever comes first."""

    steps: PositiveInt | None = None
    """Steps of all environments together."""
    cpu_seconds: PositiveFloat | None = None
    """CPU time of the process, imports and validation included [s]; no update starts that would overrun it,
    as far as the last update and the last validation tell."""

    @model_validator(mode="after")
    def _names_a_limit(self) -> Self:
        if self.steps is None and self.cpu_seconds is None:
            raise ValueError("give steps, cpu_seconds, or both")
        return self


class ValidationSettings(Config):
    """How the best policy is chosen: on validation scenes, never on test scenes."""

    every_updates: PositiveInt
    """Updates between two validations; a checkpoint is written with each."""
    episodes: PositiveInt
    keep_checkpoints: PositiveInt = 3
    """Checkpoints kept beside the best and the last."""


class TrainingConfig(Config):
    """Describe one training run."""

    scene: str | Annotated[list[str], Field(min_length=1)]
    """Name of a shipped scene, or a scene file; or several of them, each played in as many environments."""
    mask: MaskName = "all"
    """What counts as legal, a name of `envs.actions.MASKS`."""
    seed: NonNegativeInt
    network: Network = NetworkSettings()
    warm_start: WarmStart | None = None
    """By default none: learn from scratch."""
    shaping: Shaping | None = None
    ppo: PPOSettings
    stop: StopRule
    validation: ValidationSettings

    @model_validator(mode="after")
    def _can_be_cloned(self) -> Self:
        if self.warm_start and isinstance(self.network, FlatSettings):
            raise ValueError("warm_start: certificates are cloned by a network of kind 'candidates' only; leave warm_start out")
        return self

    @model_validator(mode="after")
    def _scenes_fit(self) -> Self:
        n_scenes, n_envs = len(self.scenes), self.ppo.n_envs
        if n_envs % n_scenes:
            raise ValueError(f"scene: {n_scenes} scenes cannot share ppo.n_envs = {n_envs} evenly; make it a multiple")
        if n_scenes > 1 and isinstance(self.network, FlatSettings):
            raise ValueError("scene: a flat network is made for one size of mesh; give one scene, or another kind of network")
        return self

    @property
    def scenes(self) -> list[str]:
        """Return the scenes, one or more."""
        return [self.scene] if isinstance(self.scene, str) else self.scene

    def replaced(self, seed: int | None, cpu_seconds: float | None, warm_start: str | None = None) -> "TrainingConfig":
        """Return the same with what is given: another seed, CPU time as the only rule for stopping, cloning ("bc") or "none"."""
        changes: dict[str, object] = {}
        if seed is not None:
            changes["seed"] = seed
        if cpu_seconds is not None:
            changes["stop"] = {"cpu_seconds": cpu_seconds}
        if warm_start == "none":
            changes["warm_start"] = None
        if warm_start == "bc" and self.warm_start is None:
            changes["warm_start"] = {}
        return check_config(self.model_dump(mode="json") | changes, TrainingConfig, source="the command line")
