"""Motion for the eye: the body is let move without the episode's noticing, and put back before anything else is done.

The episode itself lets a body settle in one go. To be watched, the body is taken back to the moment of the cut and moves from
there in small parts of time; whatever comes of it is forgotten for the state that the episode holds.
"""

import contextlib

from envs.task import Resection, ResectionState, settle_step
from gmapspring.errors import DivergenceError


class Motion:
    """Let the body of a task move, as long as nobody needs it."""

    def __init__(self) -> None:
        """Start at rest."""
        self._task: Resection | None = None
        self._held: ResectionState | None = None
        self._left = 0.0

    @property
    def is_shown(self) -> bool:
        """Return whether the body now is another one than the episode's."""
        return self._held is not None

    @property
    def is_moving(self) -> bool:
        """Return whether a settling is under way."""
        return self._left > 0.0

    @property
    def left(self) -> float:
        """Return how much of the settling is left [s]."""
        return self._left

    def begin(self, task: Resection, before: ResectionState, action: int) -> None:
        """Go back to the moment after a cut, which the task has already settled from; before: the state that it was made in."""
        self.end()
        self._task, self._held = task, task.save_state()
        task.load_state(before)
        task.apply(action)
        self._left = task.scene.physics.settle_seconds

    def advance(self, seconds: float) -> None:
        """Let time pass while the body settles; once it has, the body is the episode's own again."""
        if self.is_moving:
            self._move(min(seconds, self._left))
            self._left -= seconds
            if self._left <= 0.0:
                self.end()

    def nudge(self, task: Resection, seconds: float) -> None:
        """Let time pass, from rest too."""
        if self.is_moving:
            self.advance(seconds)
            return
        if self._held is None:
            self._task, self._held = task, task.save_state()
        self._move(seconds)

    def end(self) -> None:
        """Put the episode's body back."""
        if self._task is not None and self._held is not None:
            self._task.load_state(self._held)
        self._task, self._held, self._left = None, None, 0.0

    def _move(self, seconds: float) -> None:
        """Advance the body; one that diverges holds its last finite state."""
        assert self._task is not None
        simulation = self._task.simulation
        with contextlib.suppress(DivergenceError):
            simulation.advance(seconds, settle_step(simulation))
