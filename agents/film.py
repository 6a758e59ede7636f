"""Frames of episodes as they are played, the settling between two cuts included; what is played does not change by it."""

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np

from envs.collapse import SEPARATED
from envs.frames import Frames
from envs.resect import ResectEnv
from envs.task import Resection, ResectionState

Array = np.ndarray[Any, Any]

PARTS = 4
"""Frames of a cut, the last of them the settled body."""


@dataclass
class Reel:
    """The frames of one episode, and what is written under each."""

    frames: list[Array] = field(default_factory=list)
    """Pictures, uint8 (height, width, 3)."""
    captions: list[str] = field(default_factory=list)
    """As many lines."""

    def add(self, frame: Array, caption: str) -> None:
        """Add a frame."""
        self.frames.append(frame)
        self.captions.append(caption)


class Filmed(gym.Wrapper[dict[str, Array], Any, dict[str, Array], Any]):
    """Film whatever is played on an environment.

    After each step, the cut is made once more on a copy of the body, which is let settle in parts with a frame after each.
    The last frame of a step is the body of the episode itself; those before it are the copy's, whose substeps are divided
    otherwise and so differ in the last digits. The episode is never touched.
    """

    def __init__(self, env: ResectEnv, frames: Frames) -> None:
        """Film an environment with these frames."""
        super().__init__(env)
        self.reel = Reel()
        """The frames since the last reset."""
        self._frames, self._copy = frames, _Copy()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Array], dict[str, Any]]:
        """Start an episode and a new reel."""
        found = self.env.reset(seed=seed, options=options)
        self.reel = Reel()
        self._frames.forget()
        self._add(self._task, None)
        return found

    def step(self, action: Any) -> tuple[dict[str, Array], Any, bool, bool, dict[str, Any]]:
        """Take a step, then film it."""
        task = self._task
        before = task.save_state()
        found = self.env.step(action)
        info = found[-1]
        if not info["is_illegal"]:
            self._film(task, before, int(action))
        self._add(task, 1.0, "illegal" if info["is_illegal"] else _outcome(info["reason"]))
        return found

    @property
    def _task(self) -> Resection:
        task: Resection = self.env.unwrapped.task  # type: ignore[attr-defined]
        return task

    def _film(self, task: Resection, before: ResectionState, action: int) -> None:
        """Make a cut on the copy and add frames of its settling, all but the last."""
        copy = self._copy.at(task, before)
        self._frames.note(copy.simulation.body, action - task.table.n_faces)
        copy.apply(action)
        for part in range(1, PARTS):
            copy.settle(task.scene.physics.settle_seconds / PARTS)
            self._add(copy, part / PARTS)

    def _add(self, task: Resection, fade: float | None, outcome: str = "") -> None:
        """Add a frame of a body; the numbers under it are those of the episode."""
        env: ResectEnv = self.env.unwrapped  # type: ignore[assignment]
        frame = self._frames.draw(task.scene, task.simulation.body, task.strain, fade)
        ratio = env.task.cost / env.optimum
        n_cuts = f"{env.n_steps} cut" + ("s" if env.n_steps != 1 else "")
        self.reel.add(frame, f"{n_cuts}, cost {ratio:.2f} J*" + (f", {outcome}" if outcome else ""))


class _Copy:
    """A body to show things on, kept from step to step of an episode."""

    def __init__(self) -> None:
        """Build nothing yet."""
        self._task: Resection | None = None

    def at(self, task: Resection, state: ResectionState) -> Resection:
        """Return a copy of a task in one of its states."""
        if self._task is None or self._task.scene is not task.scene:
            self._task = Resection(task.scene)
        self._task.load_state(state)
        return self._task


def _outcome(reason: str | None) -> str:
    """Return how an episode ended in a word, or nothing while it goes on."""
    return "" if reason is None else "freed" if reason == SEPARATED else reason
