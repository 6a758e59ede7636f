"""Environments of several scenes as one: their meshes differ in size, so they show candidates instead of arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from agents.candidate_policy import read_candidates
from agents.features import Candidates, join

Array = np.ndarray[Any, Any]


class MixedView(VecEnv):
    """Step several batches of environments one after the other; the rows of the first come first.

    What is seen are the `Candidates` of all rows. The spaces are those of the batch with the most actions.
    """

    def __init__(self, parts: Sequence[VecEnv]) -> None:
        """Lay batches side by side."""
        self._parts = list(parts)
        self._first = np.cumsum([0, *(part.num_envs for part in parts)])
        largest = max(parts, key=lambda part: part.action_space.n)  # type: ignore[attr-defined]
        super().__init__(int(self._first[-1]), largest.observation_space, largest.action_space)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Seed the next reset: row i as seed + i, whichever batch it belongs to; None leaves seeds to chance."""
        found: list[Any] = []
        for part, first in zip(self._parts, self._first.tolist(), strict=False):
            found += part.seed(None if seed is None else seed + first)
        return found

    def reset(self) -> Candidates:
        """Start an episode everywhere."""
        return _joined([part.reset() for part in self._parts])

    def step_async(self, actions: Array) -> None:
        """Hand each batch its actions."""
        for part, its_own in zip(self._parts, np.split(actions, self._first[1:-1]), strict=True):
            part.step_async(its_own)

    def step_wait(self) -> tuple[Candidates, Array, Array, list[dict[str, Any]]]:
        """Act everywhere."""
        seen, rewards, dones, infos = zip(*(part.step_wait() for part in self._parts), strict=True)
        return _joined(seen), np.concatenate(rewards), np.concatenate(dones), [info for part in infos for info in part]

    def close(self) -> None:
        """Close all batches."""
        for part in self._parts:
            part.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of some rows."""
        return [part.get_attr(attr_name, row)[0] for part, row in self._places(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set an attribute of some rows."""
        for part, row in self._places(indices):
            part.set_attr(attr_name, value, row)

    def env_method(self, method_name: str, *arguments: Any, indices: Any = None, **keywords: Any) -> list[Any]:
        """Call a method of some rows and return what they return."""
        return [part.env_method(method_name, *arguments, indices=row, **keywords)[0] for part, row in self._places(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]:
        """Tell which of some rows are wrapped."""
        return [part.env_is_wrapped(wrapper_class, row)[0] for part, row in self._places(indices)]

    def _places(self, indices: Any) -> list[tuple[VecEnv, int]]:
        """Return the batch of each of some rows and the row's number in it."""
        rows = np.array(list(self._get_indices(indices)), np.int64)
        numbers = np.searchsorted(self._first, rows, side="right") - 1
        return [(self._parts[number], int(row - self._first[number])) for number, row in zip(numbers, rows, strict=True)]


def _joined(observations: Sequence[Any]) -> Candidates:
    """Return the candidates of several batches as those of one."""
    return join([state for observation in observations for state in read_candidates(observation).split()])
