"""What an agent is rewarded for: a sum of named terms, each a raw value times a weight."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from envs.collapse import SEPARATED
from gmapspring.config import closest
from gmapspring.errors import ConfigError


class Transition(NamedTuple):
    """What one action did, as far as rewards are concerned; or, for many bodies at once, arrays (n,) of that."""

    cost: Any
    """Cost of the action, float."""

    optimum: Any
    """Least total cost J* that frees the target, float."""

    outcome: Any
    """None, "separated" or the reason of a collapse; an object array where there are many."""

    is_illegal: Any
    """Whether the action was refused, bool."""

    @property
    def is_separated(self) -> Any:
        """Tell whether the target came free."""
        return self.outcome == SEPARATED

    @property
    def is_collapsed(self) -> Any:
        """Tell whether the body gave way."""
        return (self.outcome != None) & (self.outcome != SEPARATED)  # noqa: E711, of an array each element is compared


class RewardTerm(NamedTuple):
    """One term: its raw value, and its weight unless another is given."""

    raw: Callable[[Transition], Any]
    weight: float


REWARD_TERMS: dict[str, RewardTerm] = {
    "cost": RewardTerm(lambda transition: transition.cost / transition.optimum, -0.5),
    "separation": RewardTerm(lambda transition: 1.0 * transition.is_separated, 1.5),
    "collapse": RewardTerm(lambda transition: 1.0 * transition.is_collapsed, -1.0),
    "illegal": RewardTerm(lambda transition: 1.0 * transition.is_illegal, -0.1),
}
"""Terms by name, summed in this order: with these weights the best return is 1, and regret is 1 - return."""


def reward_weights(overrides: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the weight of every term, given some that differ from their defaults; 0 turns a term off.

    Raises:
        ConfigError: a name is unknown or a weight is not a finite number; all mistakes are listed.
    """
    if overrides is not None and not isinstance(overrides, Mapping):
        raise ConfigError(f"reward is {overrides!r}; give the weights of terms by their names, as in {{'cost': -2.0}}")
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


def reward(transition: Transition, weights: Mapping[str, float]) -> tuple[Any, dict[str, dict[str, Any]]]:
    """Return the reward and its terms, raw and weighted; the weighted ones, summed in order, are the reward exactly.

    Of arrays it makes arrays: the same bits, each for itself.
    """
    raw = {name: term.raw(transition) for name, term in REWARD_TERMS.items()}
    # To add 0 turns -0 into 0 and changes nothing else.
    terms = {name: {"raw": raw[name], "weighted": weights[name] * raw[name] + 0.0} for name in REWARD_TERMS}
    return sum((term["weighted"] for term in terms.values()), 0.0), terms
