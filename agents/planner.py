"""Planners: policies that look for an order of cuts on the simulator before the first one, and then follow it."""

from abc import abstractmethod

from agents.scripted import RulePolicy, Situation
from envs.resect import ResectEnv
from envs.task import Resection


class Planner(RulePolicy):
    """Plan before the first cut, and again where the plan was not followed, within a budget for each episode."""

    def __init__(self, name: str, budget: int) -> None:
        """Take a name and the budget: steps of the simulator to be spent in an episode, at most."""
        super().__init__(name)
        self.budget = budget
        self._task: Resection | None = None
        self._n_steps = 0
        self._order: tuple[int, ...] = ()
        self._limit = 0

    @abstractmethod
    def plan(self, env: ResectEnv, limit: int) -> tuple[int, ...]:
        """Return an order of actions, none where nothing is known; stop when the count of simulated steps is at the limit."""

    @abstractmethod
    def choose_without_plan(self, situation: Situation) -> int:
        """Return a legal action where there is no order to follow."""

    def choose(self, situation: Situation) -> int:
        """Return the next action of the order, if there is one."""
        self._look_round(situation.env)
        if not self._order or self._order[0] not in situation.legal:
            self._order = self.plan(situation.env, self._limit)
        if self._order and self._order[0] in situation.legal:
            return self._order[0]
        return self.choose_without_plan(situation)

    def _look_round(self, env: ResectEnv) -> None:
        """Take note of what has happened since the last choice: a new episode, the next step of the order, or another one."""
        if env.task is not self._task or env.n_steps < self._n_steps:
            self._order = ()
            self._limit = self.n_simulated + self.budget
        elif env.n_steps > self._n_steps:
            # What has been cut cannot be cut again.
            is_followed = env.n_steps == self._n_steps + 1 and not env.action_masks()[list(self._order[:1])].any()
            self._order = self._order[1:] if is_followed else ()
        self._task, self._n_steps = env.task, env.n_steps
