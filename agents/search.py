"""Search: a policy that looks for an order of cuts that the body survives, on the simulator and within a budget of its steps.

First the guides, which cost one step a cut: orders of the cheapest plan that leave a stalk for the end, behind the load or at
each of its cuts in turn; then such orders of all faces round the target, which cost more than the plan, to have something to
go back to. Then beams of widths 1, 2, 4 ... over the cheapest plan, which cost a step for every cut that they could go on with.
What has been tried is remembered, so that nothing is paid for twice. Steps are replayed bit for bit: an order that survived in
the search survives when it is played.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from agents.planner import Planner
from agents.scripted import Situation, choose_minimum_cut_by_index
from agents.trials import Trials, has_collapsed
from envs.baselines import cheapest_plan, interface, levers, places
from envs.collapse import SEPARATED
from envs.order import Way, next_beam, one_more, way_so_far
from envs.resect import ResectEnv

Array = np.ndarray[Any, Any]


class SearchPolicy(Planner):
    """Play the best order found; once the budget is spent and the order played, go on with the cheapest plan by index."""

    def __init__(self, budget: int) -> None:
        """Take the budget: steps of the simulator to be spent in an episode, at most."""
        super().__init__(f"search:{budget}", budget)

    def plan(self, env: ResectEnv, limit: int) -> tuple[int, ...]:
        """Return the best order found."""
        return best_order(env, self._trials, limit)

    def choose_without_plan(self, situation: Situation) -> int:
        """Return the next action of the cheapest plan."""
        return choose_minimum_cut_by_index(situation)


def best_order(env: ResectEnv, trials: Trials, limit: int) -> tuple[int, ...]:
    """Return an order that frees the target, as cheaply as it can be had, or else one that goes on longest before a collapse.

    Args:
        env: the environment; what it plays is as it was afterwards.
        trials: counts the steps.
        limit: the count at which the search ends.
    """
    start = env.task.save_state()
    tree = _Tree(env, trials, limit)
    tree.follow_guides()
    root: Way | None = tree.root
    while root is not None and not tree.is_over:
        tree.widen(root)
        root = None if tree.is_over or tree.resort else tree.detour()
    env.task.load_state(start)
    return tree.resort if tree.resort and tree.best.state.outcome != SEPARATED else tree.best.order


class _Tree:
    """All ways that have been tried from where the body stood."""

    def __init__(self, env: ResectEnv, trials: Trials, limit: int) -> None:
        self._task, self._mask = env.task, env.mask_mode
        self._trials, self._limit = trials, limit
        self.root = self.best = way_so_far(env.task)
        self.resort: tuple[int, ...] = ()
        """An order that frees the target for more than the least cost, if one is known."""
        self._tried: dict[tuple[int, ...], Way] = {}

    @property
    def is_over(self) -> bool:
        """Return whether a cheapest way to the end is known, or nothing more may be tried."""
        return self.best.state.outcome == SEPARATED or self._trials.n_steps >= self._limit

    def follow_guides(self) -> None:
        """Try to leave a stalk for the end: of the cheapest plan, then of all faces between target and healthy tissue."""
        if self.is_over:
            return
        plan, faces = cheapest_plan(self._task), interface(self._task, np.flatnonzero(self._task.action_mask("all")))
        for actions, extend in ((plan, self._extend), (faces, self._try)):
            self._task.load_state(self.root.state)
            place, lever = places(self._task, actions), levers(self._task, actions)
            towards = [np.linalg.norm(place - place[stalk], axis=1) for stalk in np.argsort(lever, kind="stable")]
            for distance in (None, *towards):
                way = self._descend(actions, distance, extend)
                if way.state.outcome == SEPARATED:
                    # A way over the plan is the best there is; one over other faces is what there is to go back to.
                    self.resort = () if self.best.state.outcome == SEPARATED else way.order
                    return

    def _descend(self, actions: Array, distance: Array | None, extend: Callable[[Way, int], Way]) -> Way:
        """Do the farthest action that is left again and again; return how far that leads.

        distance: of each action, shape (n,), or None for that from the load's line at the time.
        """
        way, left = self.root, np.ones(len(actions), bool)
        while way.state.outcome is None and way.peak < np.inf and not self.is_over:
            self._task.load_state(way.state)
            left &= self._task.action_mask(self._mask)[actions].astype(bool)
            if not left.any():
                break
            away = levers(self._task, actions[left]) if distance is None else distance[left]
            way = extend(way, int(actions[left][np.argmax(away)]))
        return way

    def widen(self, root: Way) -> None:
        """Carry out the cheapest plan from there by ever wider beams, until it is over or nothing falls off the beam."""
        self._task.load_state(root.state)
        plan, has_tool = cheapest_plan(self._task).tolist(), self._task.scene.tool_radius is not None
        width, is_cut = 1, True
        while is_cut and not self.is_over:
            beam, is_cut = [root], False
            for _ in plan:
                beam = next_beam(beam, plan, width, self._extend, has_tool=has_tool)
                is_cut = is_cut or len(beam) == width
            width *= 2

    def detour(self) -> Way | None:
        """Return the gentlest way on from a dead end by an action that is not in the plan but near the target, if any."""
        self._task.load_state(self.best.state)
        near = np.flatnonzero(self._task.action_mask("focus")).tolist()
        beam = next_beam([self.best], near, 1, self._extend)
        return beam[0] if beam else None

    def _extend(self, way: Way, action: int) -> Way:
        """Return a way with one more action, and keep the best of all; its peak is infinite where it leads to nothing."""
        longer = self._try(way, action)
        if longer.peak < np.inf:
            self.best = min(self.best, longer, key=_worth)
        return longer

    def _try(self, way: Way, action: int) -> Way:
        """Return a way with one more action, and remember it; its peak is infinite where it leads to nothing."""
        order = (*way.order, action)
        if order not in self._tried:
            self._tried[order] = self._simulate(way, action)
        return self._tried[order]

    def _simulate(self, way: Way, action: int) -> Way:
        """Return a way with one more action, if that is legal and may still be tried."""
        nothing = way._replace(peak=np.inf)
        if self._trials.n_steps >= self._limit:
            return nothing
        self._task.load_state(way.state)
        if not self._task.action_mask(self._mask)[action]:
            return nothing
        self._trials.n_steps += 1
        longer = one_more(self._task, way, action)
        return nothing if has_collapsed(self._task) else longer


def _worth(way: Way) -> tuple[Any, ...]:
    """Return what is least for the best way: one to the end, else the longest, and of several the gentlest."""
    return way.state.outcome != SEPARATED, -len(way.order), way[:3]
