"""A session: a person, a policy or a recording plays an episode, and goes back and forth in it. It knows no browser."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from agents.choice import home_of, make_policy
from agents.evaluation import Policy
from agents.motion import Motion
from agents.recording import Recording, RecordingError, fingerprint, place_of
from envs.library import seeds_of
from envs.resect import EpisodeState, ResectEnv
from envs.scene import Scene
from envs.task import Resection
from gmapspring.errors import ConfigError, TopologyError

Array = np.ndarray[Any, Any]

SAME_RETURN = 1e-6
"""How far the return of a recording may be off when it is played again: by the load's last digits, see `fingerprint`."""


@dataclass(frozen=True, eq=False)
class Moment:
    """An episode as it stands between two cuts."""

    state: EpisodeState
    """Body and bookkeeping."""
    actions: tuple[int, ...] = ()
    """The cuts so far."""
    total_return: float = 0.0
    """Sum of the rewards so far."""
    reason: str | None = None
    """Why the episode ended, or None."""

    @property
    def is_over(self) -> bool:
        """Return whether the episode has ended."""
        return self.state.has_ended


class Session:
    """Play scenes of an environment; every moment of the episode is kept, and all of them can be gone back to.

    `motion` may show the body as it moves; whatever the session does puts it back first.
    """

    def __init__(self, env: ResectEnv, split: str, policy: str = "lookahead", seed: int = 0) -> None:
        """Begin the first scene.

        Args:
            env: what is played.
            split: what its scenes are reserved for.
            policy: who gives hints, any name that `agents.choice` knows.
            seed: of what is random in policies.

        Raises:
            ConfigError: there is no such policy.
            CheckpointError: its file is not a usable one.
        """
        self.env, self.split = env, split
        self.motion = Motion()
        self._seed = seed
        self._moments: list[Moment] = []
        self._hint: tuple[Moment, int] | None = None
        self.place = 0
        """Number of the moment in the episode, 0 at its beginning."""
        self.index = 0
        """Number of the scene in the environment's list."""
        self.policy_name, self._policy = policy, self._make(policy)
        self.begin(0)

    @property
    def task(self) -> Resection:
        """Return body and rules."""
        return self.env.task

    @property
    def scene(self) -> Scene:
        """Return what is played."""
        return self.env.scene

    @property
    def moment(self) -> Moment:
        """Return the moment that the episode is at."""
        return self._moments[self.place]

    @property
    def n_moments(self) -> int:
        """Return how many moments are known, those that were undone included."""
        return len(self._moments)

    @property
    def next_action(self) -> int | None:
        """Return what was done next from here and undone, if anything."""
        is_last = self.place + 1 == self.n_moments
        return None if is_last else self._moments[self.place + 1].actions[-1]

    @property
    def legal(self) -> Array:
        """Return the legal actions, bool (n_actions,); none once the episode is over."""
        return self.env.action_masks() & (not self.moment.is_over)

    def begin(self, index: int) -> None:
        """Begin an episode of another scene, or of the same one again.

        Raises:
            ConfigError: there is no scene of that number.
        """
        self.motion.end()
        self._observation, _ = self.env.reset(seed=self._seed, options={"index": index})
        self.index, self.place, self._hint = index, 0, None
        self._moments = [Moment(self.env.save_state())]

    def next_scene(self) -> None:
        """Begin the scene that follows, and after the last the first."""
        self.begin((self.index + 1) % len(self.env.scenes))

    def cut(self, action: int) -> None:
        """Do an action; what had been undone is forgotten.

        Raises:
            TopologyError: it is illegal, or the episode is over; nothing has changed.
        """
        self.motion.end()
        before = self.moment
        if before.is_over:
            raise TopologyError(f"the episode is over ({before.reason}); undo, reset, or go on to the next scene")
        if not 0 <= action < len(self.env.action_masks()) or not self.env.action_masks()[action]:
            raise TopologyError(f"{self.describe(action)} is not legal now; choose another cut")
        self._observation, reward, _, _, info = self.env.step(action)
        after = Moment(
            self.env.save_state(), (*before.actions, int(action)), before.total_return + float(reward), info["reason"]
        )
        self._moments[self.place + 1 :] = [after]
        self.place += 1

    def go_to(self, place: int) -> None:
        """Go to a moment of the episode; beyond its ends, to its first or its last."""
        self.motion.end()
        self.place = min(max(place, 0), self.n_moments - 1)
        self._observation = self.env.load_state(self.moment.state)

    def undo(self) -> None:
        """Go back by one cut, where there is one."""
        self.go_to(self.place - 1)

    def redo(self) -> None:
        """Do again what was undone, where there is something."""
        self.go_to(self.place + 1)

    def show_settling(self) -> None:
        """Let `motion` show how the body settled after the last cut, where there was one."""
        self.motion.end()
        if self.place:
            self.motion.begin(self.task, self._moments[self.place - 1].state.task, self.moment.actions[-1])

    def describe(self, action: int) -> str:
        """Return an action in words."""
        table = self.task.table
        if 0 <= action < table.n_faces:
            one, other = table.face_tetrahedra[action].tolist()
            return f"cutting face {action}, between tetrahedra {one} and {other},"
        return f"removing tetrahedron {action - table.n_faces}"

    # Policies ---------------------------------------------------------------------------------------------------------

    def choose_policy(self, name: str) -> None:
        """Ask somebody else for hints from now on; where that fails, the one before stays."""
        self.motion.end()
        self._policy, self.policy_name, self._hint = self._make(name), name, None

    def hint(self) -> int:
        """Return what the policy would do now; asked again, it says the same.

        Raises:
            TopologyError: the episode is over.
        """
        self.motion.end()
        if self.moment.is_over:
            raise TopologyError(f"the episode is over ({self.moment.reason}): there is nothing left to do")
        if self._hint is None or self._hint[0] is not self.moment:
            first = np.array([self.place == 0])
            action, _ = self._policy.predict(self._observation, None, episode_start=first, deterministic=True)
            self._hint = self.moment, int(action)
        return self._hint[1]

    def follow(self) -> int:
        """Do what the policy would do, and return it."""
        action = self.hint()
        self.cut(action)
        return action

    def _make(self, name: str) -> Policy:
        """Return a policy that plays the environment."""
        home_of(name)
        return make_policy(name, self.env, self._seed)

    # Recordings -------------------------------------------------------------------------------------------------------

    def recording(self) -> Recording:
        """Return what has been done so far, to be kept.

        Raises:
            RecordingError: nothing has been done.
        """
        moment, scene = self.moment, self.scene
        if not moment.actions:
            raise RecordingError("nothing has been cut yet: there is nothing to record")
        return Recording(
            scene=scene.name,
            split=self.split,
            scene_seed=scene.seed,
            mask=self.env.mask_mode,
            fingerprint=fingerprint(scene),
            actions=moment.actions,
            total_return=moment.total_return,
            reason=moment.reason,
        )

    def play(self, recording: Recording, source: str = "the recording") -> None:
        """Play a recording; afterwards the episode stands at its beginning, and what was recorded can be gone through.

        Raises:
            RecordingError: it is of another scene, or does not come to the same here.
        """
        if recording.split != self.split:
            raise RecordingError(f"{source} shows {recording.title}, and the scenes here are of split {self.split!r}")
        self.begin(place_of(recording, self.env.scenes, source))
        try:
            for action in recording.actions:
                self.cut(action)
        except TopologyError as error:
            raise RecordingError(f"{source}, cut {self.place + 1}: {error}") from None
        came_to = self.moment
        if came_to.reason != recording.reason or abs(came_to.total_return - recording.total_return) > SAME_RETURN:
            raise RecordingError(
                f"{source} came to {_outcome(recording)} when it was recorded, and to {_outcome(came_to)} now: "
                "the simulation has changed; record the episode again"
            )
        self.go_to(0)


def place_of_seed(env: ResectEnv, seed: int) -> int:
    """Return which of an environment's scenes has a seed, or raise `ConfigError`."""
    seeds = seeds_of(env.scenes)
    if seed not in seeds:
        near = min(seeds, key=lambda each: abs(each - seed))
        raise ConfigError(f"scene seed {seed} is none of the {len(seeds)} scenes here; the nearest is {near}")
    return seeds.index(seed)


def _outcome(ended: Moment | Recording) -> str:
    """Return in words what an episode came to."""
    return f"a return of {ended.total_return:.6g}, {ended.reason or 'not ended'}"
