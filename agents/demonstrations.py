"""What certificates and recordings show: every state along them, as the policy sees it, and the cut that comes next."""

import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode

from agents.candidate_policy import read_candidates
from agents.features import Candidates
from agents.recording import place_of, read_recording
from envs.library import play_list
from envs.scene import Scene
from envs.vector import ResectVectorEnv
from gmapspring.errors import GmapspringError

N_ROWS = 32
"""Scenes played side by side."""

TRAIN = "train"
"""The split that training may see."""


class DemonstrationError(GmapspringError, ValueError):
    """A certificate or recording that cannot be followed."""


@dataclass(frozen=True)
class Lesson:
    """Cuts that free the target of a scene."""

    index: int
    """Number of the scene in the list that is played."""
    order: tuple[int, ...] | None
    """The cuts, or None for those of the scene's certificate."""
    source: str
    """Where they are from."""

    def what(self, scene: Scene) -> str:
        """Return what it is, in words."""
        return f"the certificate of {_name(scene)}" if self.order is None else f"{self.source}, of {_name(scene)}"

    @property
    def way_out(self) -> str:
        """Return what to do where it does not lead to the end."""
        return "certify the scenes again" if self.order is None else "record an episode that frees the target"


class Demonstrations(NamedTuple):
    """States, and what to do in each."""

    states: list[Candidates]
    actions: np.ndarray
    """Action ids, int64, shape (n_states,)."""


def together(parts: Sequence[Demonstrations]) -> Demonstrations:
    """Return what several scenes show, one after the other."""
    return Demonstrations([state for part in parts for state in part.states], np.concatenate([part.actions for part in parts]))


def demonstrate(scene: str | Sequence[Scene], split: str, mask: str) -> Demonstrations:
    """Play the certificate of every scene of a split once.

    Raises:
        DemonstrationError: a certificate is missing, makes a cut that the mask forbids, or does not free the
            target with just its last cut.
    """
    envs = _environments(scene, split, mask)
    lessons = [Lesson(index, None, "its certificate") for index in range(len(envs.scenes))]
    return _show(envs, lessons, mask)


def demonstrate_recorded(scenes: Sequence[str | Sequence[Scene]], paths: Sequence[str], mask: str) -> Demonstrations:
    """Play recorded episodes once; each must be of a training scene, and free its target.

    Args:
        scenes: what is trained on; the recordings may be of any of them.
        paths: the recordings.
        mask: what counts as legal in training, whatever it was when they were made.

    Raises:
        RecordingError: a file is no recording, or not of these scenes as they now are.
        DemonstrationError: a recording shows a held-out scene, makes a cut that the mask forbids, or does not free the
            target with just its last cut.
    """
    recordings = {path: read_recording(pathlib.Path(path)) for path in paths}
    for path, recording in recordings.items():
        if recording.split != TRAIN:
            raise DemonstrationError(
                f"{path} shows {recording.title}, which training must not see; record a scene of split {TRAIN!r}"
            )
    parts = []
    for scene in scenes:
        name = play_list(scene, TRAIN)[0].name
        shown = {path: recordings.pop(path) for path in list(recordings) if recordings[path].scene == name}
        if shown:
            envs = _environments(scene, TRAIN, mask)
            lessons = [Lesson(place_of(each, envs.scenes, path), each.actions, path) for path, each in shown.items()]
            parts.append(_show(envs, lessons, mask))
    for path, recording in recordings.items():
        raise DemonstrationError(f"{path} shows {recording.title}, which is not trained on; leave it out of recordings")
    return together(parts)


def _environments(scene: str | Sequence[Scene], split: str, mask: str) -> ResectVectorEnv:
    """Return rows of environments to play lessons in."""
    envs = ResectVectorEnv(N_ROWS, scene, split, mask, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=0)
    return envs


def _show(envs: ResectVectorEnv, lessons: Sequence[Lesson], mask: str) -> Demonstrations:
    """Play lessons, as many side by side as there are rows."""
    states: list[Candidates] = []
    actions: list[int] = []
    for first in range(0, len(lessons), N_ROWS):
        taught = lessons[first : first + N_ROWS]
        observation, shown = _begin(envs, [lesson.index for lesson in taught])
        orders = [_order(*pair) for pair in zip(taught, shown, strict=True)]
        for place in range(max(map(len, orders))):
            rows = [row for row, order in enumerate(orders) if place < len(order)]
            chosen = observation["action_mask"].argmax(axis=1)
            chosen[rows] = [orders[row][place] for row in rows]
            for row in rows:
                if not observation["action_mask"][row, chosen[row]]:
                    raise DemonstrationError(
                        f"{taught[row].what(shown[row])} makes a cut that the mask {mask!r} forbids: "
                        "there is nothing to clone; choose another mask, or no warm_start"
                    )
            seen = read_candidates(observation).split()
            states += [seen[row] for row in rows]
            actions += chosen[rows].tolist()
            observation, _, terminated, truncated, info = envs.step(chosen)
            has_ended = terminated | truncated
            for row in rows:
                is_last = place + 1 == len(orders[row])
                # What a row shows after its end is another scene.
                if has_ended[row] != is_last or (is_last and not info["final_info"]["is_success"][row]):
                    raise DemonstrationError(
                        f"{_name(shown[row])} is not freed by the {len(orders[row])} cuts of {taught[row].source}, or by fewer: "
                        f"there is nothing to clone; {taught[row].way_out}"
                    )
    return Demonstrations(states, np.array(actions))


def _begin(envs: ResectVectorEnv, indices: Sequence[int]) -> tuple[dict[str, np.ndarray], list[Scene]]:
    """Let a row begin each of some scenes; return what is seen, and the scenes."""
    for row, index in enumerate(indices):
        mask = np.arange(envs.num_envs) == row
        observation, _ = envs.reset(options={"index": index, "reset_mask": mask})
    return observation, [envs.scene_of(row) for row in range(len(indices))]


def _order(lesson: Lesson, scene: Scene) -> tuple[int, ...]:
    """Return the cuts of a lesson, those of the scene's certificate where it names none."""
    if lesson.order is not None:
        if not lesson.order:
            raise DemonstrationError(f"{lesson.source} makes no cut: there is nothing to clone; leave it out")
        return lesson.order
    if scene.certificate is None or not scene.certificate.order:
        raise DemonstrationError(f"{_name(scene)} has no certificate: there is nothing to clone")
    return scene.certificate.order


def _name(scene: Scene) -> str:
    return f"scene {scene.name!r}, seed {scene.seed},"
