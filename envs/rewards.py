"""What an agent is rewarded for: a sum of named terms, each a raw value times a weight."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from envs.collapse import COLLAPSE_RULES
from envs.task import SEPARATED
from gmapspring.config import closest
from gmapspring.errors import ConfigError


class Transition(NamedTuple):
    """What one action did, as far as rewards are concerned."""

    cost: float
    """Cost of the action."""

    optimum: float
    """Least total cost J* that frees the target."""

    outcome: str | None
    """None, "separated" or the reason of a collapse."""

    is_illegal: bool
    """Whether the action was refused."""


class RewardTerm(NamedTuple):
    """One term: its raw value, and its weight unless another is given."""

    raw: Callable[[Transition], float]
    weight: float


REWARD_TERMS: dict[str, RewardTerm] = {
    "cost": RewardTerm(lambda transition: transition.cost / transition.optimum, -0.5),
    "separation": RewardTerm(lambda transition: float(transition.outcome == SEPARATED), 1.5),
    "collapse": RewardTerm(lambda transition: float(transition.outcome in COLLAPSE_RULES), -1.0),
    "illegal": RewardTerm(lambda transition: float(transition.is_illegal), -0.1),
}
"""Terms by name, summed in this order: with these weights the best return is 1, and regret is 1 - return."""


def reward_weights(overrides: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the weight of every term, given some that differ from their defaults; 0 turns a term off.

    Raises:
        ConfigError: a name is unknown or a weight is not a finite number; all mistakes are listed.
    """
    weights = {name: term.weight for name, term in REWARD_TERMS.items()}
    mistakes = []
    for name, weight in (overrides or {}).items():
        if name not in REWARD_TERMS:
            mistakes.append(f"  reward.{name}: unknown term; {closest(str(name), REWARD_TERMS)}")
        elif (
            isinstance(weight, bool) or not isinstance(weight, int | float) or not abs(weight) < float("inf")
        ):
            mistakes.append(f"  reward.{name}: {weight!r} is not a finite number")
        else:
            weights[name] = float(weight)
    if mistakes:
        raise ConfigError("\n".join(["reward has mistakes:", *mistakes]))
    return weights


def reward(transition: Transition, weights: Mapping[str, float]) -> tuple[float, dict[str, dict[str, float]]]:
    """Return the reward and its terms, raw and weighted; the weighted ones, summed in order, are the reward exactly."""
    raw = {name: term.raw(transition) for name, term in REWARD_TERMS.items()}
    # To add 0 turns -0 into 0 and changes nothing else.
    terms = {name: {"raw": raw[name], "weighted": weights[name] * raw[name] + 0.0} for name in REWARD_TERMS}
    return sum((term["weighted"] for term in terms.values()), 0.0), terms
