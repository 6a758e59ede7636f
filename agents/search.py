"""Search: a policy that looks for an order of cuts that the body survives, on the simulator and within a budget of its steps.

Beams of widths 1, 2, 4 ... run over the cheapest plan. What has been tried is remembered, so that a wider beam pays only for
what is new. Steps are replayed bit for bit: an order that survived in the search survives when it is played.
"""

import numpy as np

from agents.scripted import RulePolicy, Situation, choose_minimum_cut_by_index
from agents.trials import Trials, has_collapsed
from envs.baselines import cheapest_plan
from envs.collapse import SEPARATED
from envs.order import Way, next_beam, one_more, way_so_far
from envs.resect import ResectEnv
from envs.task import Resection


class SearchPolicy(RulePolicy):
    """Search an order before the first cut, and again where it was not followed; play the best one found.

    Once the budget is spent and the order played, go on with the cheapest plan by index.
    """

    def __init__(self, budget: int) -> None:
        """Take the budget: steps of the simulator to be spent in an episode, at most."""
        super().__init__(f"search:{budget}")
        self.budget = budget
        self._task: Resection | None = None
        self._n_steps = 0
        self._order: tuple[int, ...] = ()
        self._limit = 0

    def choose(self, situation: Situation) -> int:
        """Return the next action of the order, or of the cheapest plan where there is none."""
        self._look_round(situation.env)
        if not self._order or self._order[0] not in situation.legal:
            self._order = best_order(situation.env, self._trials, self._limit)
        if self._order and self._order[0] in situation.legal:
            return self._order[0]
        return choose_minimum_cut_by_index(situation)

    def _look_round(self, env: ResectEnv) -> None:
        """Take note of what has happened since the last choice: a new episode, the next step of the order, or another one."""
        if env.task is not self._task or env.n_steps < self._n_steps:
            self._order = ()
            self._limit = self._trials.n_steps + self.budget
        elif env.n_steps > self._n_steps:
            # What has been cut cannot be cut again.
            is_followed = env.n_steps == self._n_steps + 1 and not env.action_masks()[list(self._order[:1])].any()
            self._order = self._order[1:] if is_followed else ()
        self._task, self._n_steps = env.task, env.n_steps


def best_order(env: ResectEnv, trials: Trials, limit: int) -> tuple[int, ...]:
    """Return the order that frees the target, or else goes on longest before the body collapses; of several, the gentlest.

    Args:
        env: the environment; what it plays is as it was afterwards.
        trials: counts the steps.
        limit: the count at which the search ends.
    """
    start = env.task.save_state()
    tree = _Tree(env, trials, limit)
    root: Way | None = tree.root
    while root is not None and not tree.is_over:
        tree.widen(root)
        root = None if tree.is_over else tree.detour()
    env.task.load_state(start)
    return tree.best.order


class _Tree:
    """All ways that have been tried from where the body stood."""

    def __init__(self, env: ResectEnv, trials: Trials, limit: int) -> None:
        self._task, self._mask = env.task, env.mask_mode
        self._trials, self._limit = trials, limit
        self.root = self.best = way_so_far(env.task)
        self._tried: dict[tuple[int, ...], Way] = {}

    @property
    def is_over(self) -> bool:
        """Return whether a way to the end is known, or nothing more may be tried."""
        return self.best.state.outcome == SEPARATED or self._trials.n_steps >= self._limit

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
        """Return a way with one more action, and remember it; its peak is infinite where it leads to nothing."""
        order = (*way.order, action)
        if order not in self._tried:
            self._tried[order] = longer = self._simulate(way, action)
            if longer.peak < np.inf:
                self.best = min(self.best, longer, key=lambda each: (-len(each.order), each[:3]))
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
