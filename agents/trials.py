"""Trials: what policies do on the simulator to see what would happen, counted and undone."""

from collections.abc import Iterator
from contextlib import contextmanager

from envs.collapse import SEPARATED
from envs.task import Resection


class Trials:
    """Try actions on a simulator, which afterwards is as it was."""

    def __init__(self) -> None:
        """Start to count."""
        self.n_steps = 0
        """Steps tried so far."""

    @contextmanager
    def after(self, task: Resection, action: int) -> Iterator[None]:
        """Let the task stand as it would after an action, as long as the block lasts."""
        start = task.save_state()
        self.n_steps += 1
        try:
            task.step(action)
            yield
        finally:
            task.load_state(start)


def has_collapsed(task: Resection) -> bool:
    """Return whether the body has given way."""
    return task.outcome not in (None, SEPARATED)


def n_simulated(policy: object) -> int:
    """Return how many steps of the simulator a policy has spent on thinking; one that does not count spends none."""
    return int(getattr(policy, "n_simulated", 0))
