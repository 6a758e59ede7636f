"""The policy that plays: a moving mean of the weights that are learnt, which evens out the noise of single updates.

(Polyak and Juditsky, 1992.)
"""

from collections.abc import Iterator
from contextlib import contextmanager

from torch import Tensor, nn

GROWTH = 5
"""Early on the mean covers the last of so many equal parts of the run, however long it may become later."""

Weights = dict[str, Tensor]


def copied(module: nn.Module) -> Weights:
    """Return the weights of a module as copies."""
    return {name: tensor.clone() for name, tensor in module.state_dict().items()}


class WeightAverage:
    """Follow the weights of a module as it learns."""

    def __init__(self, module: nn.Module, n_updates: int) -> None:
        """Begin at the weights as they are; n_updates: over about how many updates the mean reaches back, 1 for no mean."""
        self._module, self._reach = module, n_updates
        self.weights = copied(module)

    def begin(self) -> None:
        """Begin anew at the weights as they are."""
        self.weights = copied(self._module)

    def follow(self, n_updates: int) -> None:
        """Take in the weights after an update, the n-th of the run."""
        reach = min(self._reach, max(1.0, n_updates / GROWTH))
        for name, tensor in self._module.state_dict().items():
            self.weights[name].lerp_(tensor, 1.0 / reach)

    @contextmanager
    def playing(self) -> Iterator[Weights]:
        """Let the module have the mean as its weights for as long as the block lasts; yield those that are learnt."""
        learnt = copied(self._module)
        try:
            self._module.load_state_dict(self.weights)
            yield learnt
        finally:
            self._module.load_state_dict(learnt)
