"""From a name on the command line to a policy that can play."""

import pathlib
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.evaluation import Policy
from agents.scripted import POLICIES, ScriptedPolicy
from gmapspring.config import closest
from gmapspring.errors import ConfigError

DEFAULT_SCENE = "box-108"
"""Scene on which scripted policies are evaluated unless another is named."""


class Setting(NamedTuple):
    """Where a policy is at home."""

    scene: str
    mask: str


def is_saved(name: str) -> bool:
    """Return whether a name means a file."""
    return name.endswith(".zip")


def home_of(name: str) -> Setting:
    """Return the scene and the mask a saved policy was trained with, or the defaults for a scripted one.

    Raises:
        ConfigError: there is no such policy.
        CheckpointError: the file is not a usable policy.
    """
    if not is_saved(name):
        if name not in POLICIES:
            raise ConfigError(f"there is no policy {name!r}; {closest(name, POLICIES)} (or give a saved one, *.zip)")
        return Setting(DEFAULT_SCENE, "all")
    if not pathlib.Path(name).is_file():
        raise ConfigError(f"cannot read {name}: there is no such file")
    page = _checkpoint().read_page(pathlib.Path(name))
    return Setting(page.scene, page.mask)


def make_policy(name: str, env: gym.Env[Any, Any], seed: int) -> Policy:
    """Return a policy that plays an environment: a rule by its name, or a saved one by its file."""
    if not is_saved(name):
        return ScriptedPolicy(name, np.random.default_rng(seed)).bind(env)
    policy: Policy = _checkpoint().load_policy(pathlib.Path(name), env.observation_space, env.action_space)
    return policy


def _checkpoint() -> Any:
    """Import what reads saved policies; scripted ones do without torch."""
    require_torch()
    from agents import checkpoint

    return checkpoint


def require_torch() -> None:
    """Raise with the way out where torch or stable-baselines3 is missing; else leave torch one thread.

    A forward pass took 0.13 ms with one thread and 4.8 ms with two on a busy machine.
    """
    try:
        import sb3_contrib  # noqa: F401
        import torch
    except ImportError as error:
        raise ConfigError(f"learned policies need {error.name}: pip install 'gmapspring[train]'") from None
    torch.set_num_threads(1)
