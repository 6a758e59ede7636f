r"""Foresight: another policy is played out on the simulator again and again, until one of its ways frees the target.

    now --o--o--o--x        a collapse: refused here, and the policy proposes again
                 \--x  x    too often refused: a dead end, which is not entered again
    now --r--r--o--o--o     what was left to cut there (r) is cut first on the next way, which so leaves another stalk

The shield looks one step ahead, which comes too late where the fault was made many cuts before: to go back step by step from
where it shows would take longer than any budget. Here the policy says what is worth trying, and the simulator what holds.

Which cuts are cheapest needs no simulator (envs/optimum.py). So the policy is asked for an order of these alone at first, and
may choose others as well once half of the budget is spent, or none of these leads on. What has been walked is remembered: ways
pay only for what they do not share.
"""

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.evaluation import Policy
from agents.planner import Planner
from agents.scripted import Situation
from agents.trials import n_simulated
from envs.baselines import cheapest_plan
from envs.resect import EpisodeState, ResectEnv

Array = np.ndarray[Any, Any]
Order = tuple[int, ...]

PATIENCE = 4
"""Proposals refused in one state that make it a dead end. With 2 fewer targets came free, with 9 as many."""


class ForesightPolicy(Planner):
    """Follow the first way of those tried that frees the target; where there is none, do what the other policy would."""

    def __init__(self, name: str, budget: int, guide: Callable[[ResectEnv], Policy]) -> None:
        """Take who proposes.

        Args:
            name: of that policy.
            budget: steps of the simulator in an episode after which nothing more is tried. What a guide spends that simulates
                itself is counted with them, but no guide is stopped in its thoughts. While a plan is made, as
                many states of the body are kept: half a megabyte each in the liver.
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
        cheapest = np.isin(np.arange(len(env.action_masks())), cheapest_plan(env.task))
        ways, half = _Ways(twin, guide, env.save_state(), cheapest), (self.n_simulated + limit) // 2
        return self._look(ways, cheapest, half) or self._look(ways, np.ones_like(cheapest), limit)

    def _look(self, ways: "_Ways", among: Array, limit: int) -> Order:
        """Return a way among some actions, bool (n_actions,), or nothing."""
        ways.keep_to(among)
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
        while self.n_simulated < limit and not ways.give_up():
            action = ways.propose()
            if self.n_simulated >= limit:
                break
            if not ways.go_where_it_has_been(action):
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

    def __init__(self, env: ResectEnv, guide: Policy, start: EpisodeState, cheapest: Array) -> None:
        self._env, self._guide, self._cheapest = env, guide, cheapest
        self._reached: dict[Order, EpisodeState] = {(): start}
        """How the body stood after the cuts that have been walked, in their order."""
        self._fatal: dict[frozenset[int], set[int]] = {}
        """By what has been cut: the cuts that end the episode without freeing the target."""
        self._seen: dict[str, Array] = {}
        self.order: Order = ()
        """What has been cut on the way that is followed now."""
        self.keep_to(cheapest)

    def keep_to(self, among: Array) -> None:
        """Go on with some actions alone, bool (n_actions,); what is fatal stays so, but with others no end need be dead."""
        self._among, self._first, self._n_begun = among, np.zeros_like(among), 0
        self._dead: dict[frozenset[int], set[int]] = {}
        """By what has been cut: the cuts that lead to dead ends."""
        self._n_refused: Counter[frozenset[int]] = Counter()
        """By what has been cut: how many cuts have been found to be fatal or to lead to dead ends since."""
        self.are_exhausted = False
        """Whether even the start is a dead end."""

    def begin(self) -> None:
        """Go back to the start; what the last way has left of the cheapest cuts comes first now."""
        if self._n_begun:
            self._first = self._cheapest.copy()
            self._first[list(self.order)] = False
        self._n_begun += 1
        self._go_to(())

    def give_up(self) -> bool:
        """Return whether this is a dead end; then the last cut led nowhere, and is refused from now on."""
        is_dead = self._n_refused[frozenset(self.order)] >= PATIENCE or not self._mask().any()
        if is_dead and self.order:
            self._refuse(self._dead, self.order)
        self.are_exhausted = is_dead and not self.order
        return is_dead

    def propose(self) -> int:
        """Return what the guide would do next: on the first way what it holds for best, on all others what it draws."""
        action, _ = self._guide.predict(self._seen, deterministic=self._n_begun == 1, action_masks=self._mask())
        return int(action)

    def go_where_it_has_been(self, action: int) -> bool:
        """Go on by an action, if a way has led there before; return whether one has."""
        order = (*self.order, action)
        has_been = order in self._reached
        if has_been:
            self._go_to(order)
        return has_been

    def follow(self, action: int) -> bool:
        """Do it, unless that ends the episode; return whether it frees the target."""
        order = (*self.order, action)
        seen, _, terminated, truncated, info = self._env.step(action)
        if info["is_success"] or not (terminated or truncated):
            self._seen, self.order, self._reached[order] = seen, order, self._env.save_state()
        else:
            self._refuse(self._fatal, order)
            self._go_to(self.order)
        return bool(info["is_success"])

    def _refuse(self, as_what: dict[frozenset[int], set[int]], order: Order) -> None:
        """Note that the last cut of an order leads nowhere after the others, in whatever order these are done."""
        done = frozenset(order[:-1])
        as_what.setdefault(done, set()).add(order[-1])
        self._n_refused[done] += 1

    def _go_to(self, order: Order) -> None:
        """Stand where a way has led."""
        self._seen, self.order = self._env.load_state(self._reached[order]), order

    def _mask(self) -> Array:
        """Return what may be done: what is legal, kept to and not refused; of that, what comes first."""
        mask, done = self._env.action_masks() & self._among, frozenset(self.order)
        for refused in (self._fatal, self._dead):
            mask[list(refused.get(done, ()))] = False
        first = mask & self._first
        return first if first.any() else mask
