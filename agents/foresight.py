r"""Foresight: another policy is played out on the simulator again and again, until one of its ways frees the target.

    now --o--o--o--x        a collapse: refused here, and the policy proposes again
                 \--x  x    too often refused: a dead end, which is not entered again
    now --o--o--o'--o--o    the next way is drawn by the policy's own chances, so that it parts from the last one early

The shield looks one step ahead, which comes too late where the fault was made many cuts before. Here the policy says what is
worth trying, and the simulator what holds.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.evaluation import Policy
from agents.planner import Planner
from agents.scripted import Situation
from agents.trials import n_simulated
from envs.resect import EpisodeState, ResectEnv

Array = np.ndarray[Any, Any]
Order = tuple[int, ...]

PATIENCE = 3
"""Proposals refused in one state after which it counts as a dead end. With 1 fewer targets came free, with 8 as many."""


class ForesightPolicy(Planner):
    """Follow the first way of another policy that frees the target; where none is found in time, do what that policy would."""

    def __init__(self, name: str, budget: int, guide: Callable[[ResectEnv], Policy]) -> None:
        """Take who proposes.

        Args:
            name: of that policy.
            budget: steps of the simulator to be spent in an episode, at most; those that the guide spends count as well.
            guide: makes the policy for an environment, of which it may look at the simulator.
        """
        super().__init__(f"foresight:{budget}:{name}", budget)
        self._make_guide = guide
        self._twin: ResectEnv | None = None
        self._guide: Policy | None = None
        self._n_spent = 0

    @property
    def n_simulated(self) -> int:
        """Return how many steps of the simulator have been spent, those of all guides included."""
        return self._trials.n_steps + self._n_spent + n_simulated(self._guide)

    def plan(self, env: ResectEnv, limit: int) -> Order:
        """Return a way that frees the target, or nothing."""
        twin, guide = self._twin_of(env)
        start = env.save_state()
        ways = _Ways(twin, guide)
        found: Order | None = None
        while found is None and not ways.is_exhausted and self.n_simulated < limit:
            found = self._descend(ways, start, limit)
        return found or ()

    def choose_without_plan(self, situation: Situation) -> int:
        """Return what the guide would do."""
        twin, guide = self._twin_of(situation.env)
        seen = twin.load_state(situation.env.save_state())
        mask = np.zeros(len(seen["action_mask"]), bool)
        mask[situation.legal] = True
        return int(guide.predict(seen, deterministic=True, action_masks=mask)[0])

    def _descend(self, ways: "_Ways", start: EpisodeState, limit: int) -> Order | None:
        """Follow the guide from the start; return its way where that frees the target."""
        ways.begin(start)
        while not ways.is_stuck and self.n_simulated < limit:
            action = ways.propose()
            self._trials.n_steps += 1
            if ways.follow(action):
                return ways.order
        return None

    def _twin_of(self, env: ResectEnv) -> tuple[ResectEnv, Policy]:
        """Return an environment of the same scene, in which nothing that is tried can be seen from outside, and its guide."""
        if self._twin is None or self._twin.scene is not env.scene:
            self._n_spent += n_simulated(self._guide)
            self._twin = ResectEnv([env.scene], mask=env.mask_mode)
            self._guide = self._make_guide(self._twin)
        assert self._guide is not None
        return self._twin, self._guide


class _Ways:
    """The ways that a guide has been followed on, all from the same start."""

    def __init__(self, env: ResectEnv, guide: Policy) -> None:
        self._env, self._guide = env, guide
        self._refused: dict[frozenset[int], set[int]] = {}
        """By what has been cut: the cuts that lead nowhere."""
        self._is_first = True

    def begin(self, start: EpisodeState) -> None:
        """Go back to the start: the first way is what the guide holds for best, all others are drawn."""
        self._is_drawn, self._is_first = not self._is_first, False
        self._seen = self._env.load_state(start)
        self.order: Order = ()

    @property
    def is_exhausted(self) -> bool:
        """Return whether even the start is a dead end."""
        return len(self._refused.get(frozenset(), ())) > PATIENCE

    @property
    def is_stuck(self) -> bool:
        """Return whether there is nothing to go on with; then the last cut led nowhere, and is refused from now on."""
        is_dead = len(self._refused_here) > PATIENCE or not self._mask.any()
        if is_dead and self.order:
            self._refused.setdefault(frozenset(self.order[:-1]), set()).add(self.order[-1])
        return is_dead

    @property
    def _refused_here(self) -> set[int]:
        return self._refused.setdefault(frozenset(self.order), set())

    @property
    def _mask(self) -> Array:
        """Return what is legal and not refused."""
        mask = self._env.action_masks()
        mask[list(self._refused_here)] = False
        return mask

    def propose(self) -> int:
        """Return what the guide would do next."""
        return int(self._guide.predict(self._seen, deterministic=not self._is_drawn, action_masks=self._mask)[0])

    def follow(self, action: int) -> bool:
        """Do it, unless that ends the episode; return whether it frees the target."""
        before = self._env.save_state()
        seen, _, terminated, truncated, info = self._env.step(action)
        if info["is_success"] or not (terminated or truncated):
            self._seen, self.order = seen, (*self.order, action)
        else:
            self._refused_here.add(action)
            self._env.load_state(before)
        return bool(info["is_success"])
