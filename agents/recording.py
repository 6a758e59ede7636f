"""Recordings: what somebody did in an episode, in a small file that can be played again and learnt from.

A recording names its scene, the cuts, and what they came to. A fingerprint of the scene goes with it: of another scene, or of
one that has changed since, it shows nothing.
"""

import hashlib
import json
import pathlib
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from envs.action_table import action_table
from envs.library import seeds_of
from envs.scene import Scene
from gmapspring.config import Config, check_config
from gmapspring.errors import ConfigError, GmapspringError
from gmapspring.paths import write_atomically


class RecordingError(GmapspringError, ValueError):
    """A recording that cannot be read, or does not show what it was made of."""


class Recording(Config):
    """One episode, from its beginning as far as it went."""

    format: Literal[1] = 1
    """Version of these files."""
    scene: str
    """Name of the scene's configuration."""
    split: str
    """What the scene's seed is reserved for: train, validation or test."""
    scene_seed: int
    mask: str
    """What counted as legal, a name of `envs.actions.MASKS`."""
    fingerprint: str
    """What the scene was; see `fingerprint`."""
    actions: tuple[Annotated[int, Field(ge=0)], ...]
    """Action ids, in the order of the cuts."""
    total_return: float
    """Sum of the rewards."""
    reason: str | None
    """Why the episode ended, or None where it was broken off."""

    @property
    def title(self) -> str:
        """Return what it shows, in words."""
        return f"scene {self.scene!r}, {self.split} seed {self.scene_seed}"


def write_recording(path: pathlib.Path, recording: Recording) -> None:
    """Write a recording in one go, and its folder where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, (json.dumps(recording.model_dump(mode="json"), indent=1) + "\n").encode())


def read_recording(path: pathlib.Path) -> Recording:
    """Return the recording in a file.

    Raises:
        RecordingError: the file is missing, truncated, or no recording.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise RecordingError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise RecordingError(f"{path} is no recording, or only a part of one ({error}); record the episode again") from None
    try:
        return check_config(found, Recording, source=str(path))
    except ConfigError as error:
        raise RecordingError(f"{error}\nrecord the episode again") from None


def fingerprint(scene: Scene) -> str:
    """Return a hash of all that the course of an episode depends on: mesh, target, stiffness, load, rules and physics."""
    digest = hashlib.sha256()
    exact = (scene.mesh.points, scene.mesh.tetrahedra, scene.target, scene.vessel, scene.pinned, scene.young_modulus)
    for array in exact:
        digest.update(np.ascontiguousarray(array).tobytes())
    # The size of the load goes through a power, whose last digit libraries of mathematics do not share.
    rules: dict[str, Any] = {
        "load": [f"{value:.9e}" for value in scene.load],
        "spacing": scene.spacing,
        "physics": scene.physics.model_dump(mode="json"),
        "limits": scene.limits.model_dump(mode="json"),
        "budget": scene.budget,
        "tool_radius": scene.tool_radius,
    }
    digest.update(json.dumps(rules, sort_keys=True).encode())
    return digest.hexdigest()[:16]


def place_of(recording: Recording, scenes: Sequence[Scene], source: str) -> int:
    """Return which of some scenes a recording is of.

    Args:
        recording: what was recorded.
        scenes: those of the split that it names.
        source: what to call the recording in messages.

    Raises:
        RecordingError: it is of none of them, of one that has changed since, or makes a cut that there is not.
    """
    seeds = seeds_of(scenes)
    if recording.scene_seed not in seeds:
        raise RecordingError(f"{source} shows {recording.title}, which is none of the {len(seeds)} scenes here")
    place = seeds.index(recording.scene_seed)
    scene = scenes[place]
    if scene.name != recording.scene:
        raise RecordingError(f"{source} shows {recording.title}; here scene {scene.name!r} is played: name the other one")
    if fingerprint(scene) != recording.fingerprint:
        raise RecordingError(f"{source} shows {recording.title}, as it was before it changed; record the episode again")
    n_actions = action_table(scene.mesh).n_actions
    if (highest := max(recording.actions, default=0)) >= n_actions:
        raise RecordingError(f"{source} makes the cut {highest}, where there are 0 to {n_actions - 1}; record the episode again")
    return place
