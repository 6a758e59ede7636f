r"""Foresight: another policy is played out on the simulator again and again, until one of its ways frees the target.

    now --o--o--o--x        a collapse: refused here, and the policy proposes again
                 \--x  x    too often refused: a dead end, which is not entered again
    now --o--o--o'--o--o    the next way is drawn by the policy's own chances, so that it parts from the last one early

The shield looks one step ahead, which comes too late where the fault was made many cuts before. Here the policy says what is
worth trying, and the simulator what holds. A policy that leaves nothing to chance parts from its last way only where that was
refused.
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

PATIENCE = 4
"""Proposals refused in one state that make it a dead end. With 2 fewer targets came free, with 9 as many."""


class ForesightPolicy(Planner):
    """Follow the first way of another policy that frees the target; where none is found in time, do what that policy would."""

    def __init__(self, name: str, budget: int, guide: Callable[[ResectEnv], Policy]) -> None:
        """Take who proposes.

        Args:
            name: of that policy.
            budget: steps of the simulator in an episode after which nothing more is tried. What a guide spends that simulates
                itself is counted with them, but no guide is stopped in its thoughts.
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
        ways = _Ways(twin, guide, env.save_state())
        found: Order | None = None
        while found is None and not ways.are_exhausted and self.n_simulated < limit:
            found = self._descend(ways, limit)
        return found or ()

    def choose_without_plan(self, situation: Situation) -> int:
        """Return what the guide would do."""
        twin, guide = self._twin_of(situation.env)
        seen = twin.load_state(situation.env.save_state())
        mask = np.zeros(len(seen["action_mask"]), bool)
        mask[situation.legal] = True
        return int(guide.predict(seen, deterministic=True, action_masks=mask)[0])

    def _descend(self, ways: "_Ways", limit: int) -> Order | None:
        """Follow the guide from the start; return its way where that frees the target."""
        ways.begin()
        while not ways.give_up():
            action = ways.propose()
            if self.n_simulated >= limit:
                break
            self._trials.n_steps += 1
            if ways.follow(action):
                return ways.order
        return None

    def _twin_of(self, env: ResectEnv) -> tuple[ResectEnv, Policy]:
        """Return an environment of the same scene, in which nothing that is tried can be seen from outside, and its guide."""
        if self._twin is None or self._twin.scene is not env.scene or self._twin.mask_mode != env.mask_mode:
            self._n_spent += n_simulated(self._guide)
            self._twin = ResectEnv([env.scene], mask=env.mask_mode)
            self._guide = self._make_guide(self._twin)
        assert self._guide is not None
        return self._twin, self._guide


class _Ways:
    """The ways that a guide has been followed on, all from the same start."""

    def __init__(self, env: ResectEnv, guide: Policy, start: EpisodeState) -> None:
        self._env, self._guide, self._start = env, guide, start
        self._refused: dict[frozenset[int], set[int]] = {}
        """By what has been cut: the cuts that lead nowhere."""
        self._n_begun = 0
        self._seen: dict[str, Array] = {}
        self.order: Order = ()
        """What has been cut on the way that is followed now."""
        self.are_exhausted = False
        """Whether even the start is a dead end."""

    def begin(self) -> None:
        """Go back to the start."""
        self._n_begun += 1
        self._seen, self.order = self._env.load_state(self._start), ()

    def give_up(self) -> bool:
        """Return whether this is a dead end; then the last cut led nowhere, and is refused from now on."""
        is_dead = len(self._refused_here()) >= PATIENCE or not self._mask().any()
        if is_dead and self.order:
            self._refused.setdefault(frozenset(self.order[:-1]), set()).add(self.order[-1])
        self.are_exhausted = is_dead and not self.order
        return is_dead

    def propose(self) -> int:
        """Return what the guide would do next: on the first way what it holds for best, on all others what it draws."""
        action, _ = self._guide.predict(self._seen, deterministic=self._n_begun == 1, action_masks=self._mask())
        return int(action)

    def follow(self, action: int) -> bool:
        """Do it, unless that ends the episode; return whether it frees the target."""
        before = self._env.save_state()
        seen, _, terminated, truncated, info = self._env.step(action)
        if info["is_success"] or not (terminated or truncated):
            self._seen, self.order = seen, (*self.order, action)
        else:
            self._refused.setdefault(frozenset(self.order), set()).add(action)
            self._env.load_state(before)
        return bool(info["is_success"])

    def _refused_here(self) -> set[int]:
        return self._refused.get(frozenset(self.order), set())

    def _mask(self) -> Array:
        """Return what is legal and not refused."""
        mask = self._env.action_masks()
        mask[list(self._refused_here())] = False
        return mask
