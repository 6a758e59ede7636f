"""Scripted policies: what a rule can do without learning, to be beaten or to be looked up to.

Each rule is a function of a `Situation`. All but `random` look at the simulator behind the environment, and so must be
bound to the environment that they play: `ScriptedPolicy("lookahead").bind(env)`.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple, Self

import gymnasium as gym
import numpy as np

from agents.trials import Trials, has_collapsed
from envs.baselines import legal_plan, lever_first, levers, rim_first
from envs.resect import ResectEnv
from gmapspring.config import known_name
from gmapspring.errors import ConfigError, GmapspringError

Array = np.ndarray[Any, Any]


class Situation(NamedTuple):
    """What a rule chooses by."""

    observation: dict[str, Array]
    """One observation, without a batch dimension."""

    legal: Array
    """Ids of the legal actions, ascending, int64."""

    env: ResectEnv
    """The environment that is played."""

    rng: np.random.Generator
    """Source of chance."""

    trials: Trials
    """What to try actions with."""


def choose_random(situation: Situation) -> int:
    """Choose any legal action."""
    return int(situation.rng.choice(situation.legal))


def choose_rim_first(situation: Situation) -> int:
    """Cut the face between target and healthy tissue that lies farthest from the middle of all such faces."""
    return rim_first(situation.env.task, situation.legal, situation.rng)


def choose_lever_first(situation: Situation) -> int:
    """Cut the face between target and healthy tissue that lies farthest from the line along which the load pulls."""
    return lever_first(situation.env.task, situation.legal, situation.rng)


def choose_minimum_cut_by_index(situation: Situation) -> int:
    """Work out the cheapest plan anew and do its action of lowest id; physics plays no part."""
    return int(_plan(situation)[0])


def choose_minimum_cut_at_random(situation: Situation) -> int:
    """Work out the cheapest plan anew and do any of its actions; physics plays no part."""
    return int(situation.rng.choice(_plan(situation)))


def choose_minimum_cut_by_lever(situation: Situation) -> int:
    """Work out the cheapest plan anew and do its action that lies farthest from the line along which the load pulls."""
    plan = _plan(situation)
    return int(plan[np.argmax(levers(situation.env.task, plan))])


def choose_by_lookahead(situation: Situation) -> int:
    """Try every action of the cheapest plan in the simulator and do the one after which healthy tissue strains least."""
    task = situation.env.task
    plan = _plan(situation)
    strains = []
    for action in plan:
        with situation.trials.after(task, int(action)):
            strains.append(np.inf if has_collapsed(task) else task.tissue.healthy_strain)
    return int(plan[np.argmin(strains)])


def choose_by_certificate(situation: Situation) -> int:
    """Follow the order that is known to survive at the least cost."""
    certificate = situation.env.scene.certificate
    if certificate is None:
        raise ConfigError("this scene has no certificate to follow; choose another policy")
    order = np.array(certificate.order)
    ahead = order[np.isin(order, situation.legal)]
    return int(ahead[0]) if len(ahead) else choose_random(situation)


def _plan(situation: Situation) -> Array:
    """Return the legal actions of the cheapest plan from here, ascending; all legal ones where the mask allows none."""
    return legal_plan(situation.env.task, situation.legal)


POLICIES: dict[str, Callable[[Situation], int]] = {
    "random": choose_random,
    "rim-first": choose_rim_first,
    "lever-first": choose_lever_first,
    "min-cut-index": choose_minimum_cut_by_index,
    "min-cut-random": choose_minimum_cut_at_random,
    "min-cut-lever": choose_minimum_cut_by_lever,
    "lookahead": choose_by_lookahead,
    "certificate": choose_by_certificate,
}
"""Rules by name."""


class RulePolicy(ABC):
    """Choose by looking at a `Situation`, through the same `predict` as stable-baselines3's policies."""

    def __init__(self, name: str, rng: np.random.Generator | None = None) -> None:
        """Take a name; without a generator chance starts from seed 0."""
        self.name = name
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._env: Any = None
        self._trials = Trials()

    @abstractmethod
    def choose(self, situation: Situation) -> int:
        """Return a legal action."""

    @property
    def n_simulated(self) -> int:
        """Return how many steps of the simulator have been spent on thinking."""
        return self._trials.n_steps

    def bind(self, env: gym.Env[Any, Any]) -> Self:
        """Play this environment from now on; wrappers around it do not matter."""
        self._env = env.unwrapped
        return self

    def predict(
        self,
        observation: dict[str, Array],
        state: Any = None,
        episode_start: Array | None = None,
        deterministic: bool = False,
        action_masks: Array | None = None,
    ) -> tuple[Any, Any]:
        """Choose a legal action, as (action, state); of a batch only one row can be the environment that is bound."""
        mask = np.asarray(observation["action_mask"] if action_masks is None else action_masks)
        is_batch = np.ndim(observation["globals"]) == 2
        if is_batch:
            if len(observation["globals"]) != 1:
                raise GmapspringError("a scripted policy plays one environment; give it one observation at a time")
            observation = {key: array[0] for key, array in observation.items()}
        if self._env is None and self.name != "random":
            raise GmapspringError(f"policy {self.name!r} looks into the simulator: call bind(env) first")
        action = self.choose(Situation(observation, np.flatnonzero(mask), self._env, self._rng, self._trials))
        return (np.array([action]) if is_batch else action), state


class ScriptedPolicy(RulePolicy):
    """Play by a rule of `POLICIES`."""

    def __init__(self, name: str, rng: np.random.Generator | None = None) -> None:
        """Find the rule.

        Raises:
            ConfigError: there is no such rule.
        """
        super().__init__(known_name("scripted policy", name, POLICIES), rng)

    def choose(self, situation: Situation) -> int:
        """Return a legal action."""
        return POLICIES[self.name](situation)
