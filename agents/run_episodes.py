"""Episodes for the page of a training run: its best policy plays held-out scenes, and two of the episodes are shown."""

import io
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from PIL import Image

from agents.choice import make_policy
from agents.evaluation import Episode, evaluate
from agents.run_record import Run
from envs.frames import Frames
from envs.resect import ResectEnv
from gmapspring.errors import GmapspringError

SPLIT = "test"
"""Scenes that no run has learnt from, nor chosen its policy by."""
N_EPISODES = 16
"""Episodes of a run, unless told otherwise: a second or two for the boxes that ship."""
N_FRAMES = 5
FRAME = 240
"""Width and height of a frame [pixels]."""
N_COLORS = 96
"""Colours of a frame, which makes its file a third as large."""


class Played(NamedTuple):
    """The episodes of one run."""

    label: str
    """Of the run."""
    episodes: list[Episode]
    actions: list[tuple[int, ...]]
    """What was done in each of them."""
    places: list[tuple[str, int]]
    """Scene and place in its list of scenes, of each of them."""
    mask: str
    n_scenes: int
    """Scenes that there are in all."""
    problem: str = ""
    """Why there are no episodes."""


class Recorder(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps the actions of the present episode."""

    def __init__(self, env: ResectEnv) -> None:
        """Start with none."""
        super().__init__(env)
        self.actions: list[int] = []

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Start an episode, and forget the last."""
        self.actions = []
        return super().reset(**arguments)

    def step(self, action: int) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Act, and note it."""
        self.actions.append(int(action))
        return super().step(action)


def play(run: Run, n_episodes: int | None = N_EPISODES) -> Played:
    """Let the best policy of a run play test scenes of each scene that it was trained on, all of them for None.

    What keeps it from playing, such as a scene file that is gone, is told in the result.
    """
    mask = str(run.config.get("mask", "all"))
    played = Played(run.label, [], [], [], mask, 0)
    if not run.best.is_file():
        return played._replace(problem="there is no best.zip yet")
    n_scenes = 0
    try:
        for scene in run.scenes:
            env = Recorder(ResectEnv(scene, SPLIT, mask))
            policy = make_policy(str(run.best), env, seed=0)
            there = len(env.unwrapped.scenes)  # type: ignore[attr-defined]
            count = there if n_episodes is None else min(max(n_episodes // len(run.scenes), 1), there)
            n_scenes += there
            evaluate(policy, env, count, name=run.label, on_episode=partial(_keep, played, env, scene))
    except GmapspringError as error:
        return Played(run.label, [], [], [], mask, 0, problem=str(error))
    return played._replace(n_scenes=n_scenes)


def _keep(played: Played, env: Recorder, scene: str, episode: Episode) -> None:
    """Keep an episode with its actions."""
    played.places.append((scene, sum(place == scene for place, _ in played.places)))
    played.episodes.append(episode)
    played.actions.append(tuple(env.actions))


def best_and_worst(all_played: list[Played]) -> tuple[tuple[Played, int], tuple[Played, int]] | None:
    """Return the episodes of highest and of lowest return, as (run, number); of equal ones the first; None without episodes."""
    numbered = [(played, number) for played in all_played for number in range(len(played.episodes))]
    if not numbered:
        return None

    def total(which: tuple[Played, int]) -> float:
        return round(which[0].episodes[which[1]].total_return, 9)

    return max(numbered, key=total), min(numbered, key=total)


def film(played: Played, number: int, n_frames: int = N_FRAMES) -> list[tuple[bytes, str]]:
    """Play an episode again by its actions, and return frames of it with what they show, evenly spread over its cuts."""
    (scene, place), actions = played.places[number], played.actions[number]
    env = ResectEnv(scene, SPLIT, played.mask)
    env.reset(seed=0, options={"index": place})
    drawn = Frames(size=(FRAME, FRAME))
    wanted = set(np.linspace(0, len(actions), n_frames).round().astype(int).tolist())
    frames = [(_frame(env, drawn), "before the first cut")]
    for count, action in enumerate(actions, start=1):
        drawn.note(env.task.simulation.body, action - env.task.table.n_faces)
        *_, info = env.step(action)
        if count in wanted:
            ending = f", the end: {info['reason']}" if count == len(actions) else ""
            frames.append((_frame(env, drawn), f"after cut {count}{ending}"))
    return frames


def _frame(env: ResectEnv, drawn: Frames) -> bytes:
    """Return a picture of the body as a small PNG file."""
    picture = drawn.draw(env.scene, env.task.simulation.body, env.task.strain)
    stream = io.BytesIO()
    Image.fromarray(picture).quantize(N_COLORS).save(stream, "PNG", optimize=True)
    return stream.getvalue()
