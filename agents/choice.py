"""From a name on the command line to a policy that can play.

A name is that of a scripted policy, the file of a saved one (*.zip), `search:BUDGET`, or `shield:NAME` or
`foresight:BUDGET:NAME` with any of these.
"""

import pathlib
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.evaluation import Policy
from agents.foresight import ForesightPolicy
from agents.scripted import POLICIES, ScriptedPolicy
from agents.search import SearchPolicy
from agents.shield import ShieldedPolicy
from gmapspring.config import closest
from gmapspring.errors import ConfigError

DEFAULT_SCENE = "box-108"
"""Scene on which scripted policies are evaluated unless another is named."""


SEARCH, SHIELD, FORESIGHT = "search", "shield", "foresight"
"""What stands before the colon in names of policies that think."""


class Setting(NamedTuple):
    """Where a policy is at home."""

    scene: str
    mask: str


def is_saved(name: str) -> bool:
    """Return whether a name means a file."""
    return name.endswith(".zip")


def home_of(name: str) -> Setting:
    """Return the first scene and the mask a saved policy was trained with, in a wrapper or not, or the defaults for any other.

    Raises:
        ConfigError: there is no such policy.
        CheckpointError: the file is not a usable policy.
    """
    kind, _, rest = name.partition(":")
    if kind == SHIELD:
        return home_of(rest)
    if kind == FORESIGHT:
        return home_of(_foreseen(rest)[1])
    if kind == SEARCH:
        _budget(rest)
        return Setting(DEFAULT_SCENE, "all")
    if not is_saved(name):
        if name not in POLICIES:
            known = closest(kind, [*POLICIES, SEARCH, SHIELD, FORESIGHT])
            raise ConfigError(f"there is no policy {name!r}; {known} (or give a saved one, *.zip)")
        return Setting(DEFAULT_SCENE, "all")
    if not pathlib.Path(name).is_file():
        raise ConfigError(f"cannot read {name}: there is no such file")
    page = _checkpoint().read_page(pathlib.Path(name))
    return Setting(page.scene.split(_checkpoint().SCENE_JOINT)[0], page.mask)


def make_policy(name: str, env: gym.Env[Any, Any], seed: int) -> Policy:
    """Return a policy that plays an environment."""
    kind, _, rest = name.partition(":")
    if kind == SHIELD:
        return ShieldedPolicy(make_policy(rest, env, seed), env)
    if kind == FORESIGHT:
        budget, guide = _foreseen(rest)
        return ForesightPolicy(guide, budget, lambda twin: make_policy(guide, twin, seed)).bind(env)
    if kind == SEARCH:
        return SearchPolicy(_budget(rest)).bind(env)
    if not is_saved(name):
        return ScriptedPolicy(name, np.random.default_rng(seed)).bind(env)
    checkpoint = _checkpoint()
    import torch

    # Where it is asked for other actions than its best, they come from torch's generator, which all of the process shares.
    torch.manual_seed(seed)
    policy: Policy = checkpoint.load_policy(pathlib.Path(name), env.observation_space, env.action_space)
    return policy


def is_wrapper(name: str) -> bool:
    """Return whether a name is `shield` or `foresight:BUDGET`, to which that of a policy can be added.

    Raises:
        ConfigError: the budget is none.
    """
    kind, _, rest = name.partition(":")
    if kind == FORESIGHT:
        _budget(rest)
        return True
    return name == SHIELD


def _budget(text: str) -> int:
    """Return the budget of a policy that plans."""
    if not text.isdecimal():
        raise ConfigError(
            "the budget of a search, or of foresight, is a whole number of simulator steps, as in search:300 or "
            f"foresight:300:rim-first, not {text!r}"
        )
    return int(text)


def _foreseen(text: str) -> tuple[int, str]:
    """Return the budget of foresight, and who proposes."""
    budget, _, guide = text.partition(":")
    return _budget(budget), guide


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
