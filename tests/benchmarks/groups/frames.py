"""Frames and pixel observations: how long a picture takes, and how much of that is the memory it has to touch."""

from collections.abc import Callable, Iterator
from typing import NamedTuple
from unittest import mock

import numpy as np

import gmapspring as gs
from envs.frames import SIZE, STYLES
from envs.pixels import CHANNELS, PixelObservation
from envs.resect import ResectEnv
from gmapspring.render import SAMPLES, render_body
from gmapspring.rendering import raster
from tests.benchmarks.groups.environment import LEVEL_2, scenes_of
from tests.benchmarks.rows import Limit, Plan, Row, at_most
from tests.benchmarks.timing import interleave, timed

Draw = Callable[[], np.ndarray]
N_CUTS = 6
"""Cuts before the frames of an episode: an uncut body has no clefts, which cost most."""


class Picture(NamedTuple):
    """What is timed."""

    draw: Draw
    asked: Limit
    """In ms."""


def measure_frames(plan: Plan) -> Iterator[Row]:
    """Yield the time of each kind of picture, and that of touching as much memory."""
    made = pictures()
    for picture in made.values():
        picture.draw()
    buffers = np.empty((2, SAMPLES * SIZE[1], SAMPLES * SIZE[0]), np.float32)
    contest = {name: lambda draw=picture.draw: timed(draw) for name, picture in made.items()}
    samples = interleave(contest | {"floor": lambda: timed(buffers.fill, 0.0)}, plan.rounds)
    for name, picture in made.items():
        sample = samples[name]
        yield Row(
            name, 1e3 * sample.low, "ms", 1e3 * sample.median, 1e3 * sample.high, picture.asked, difference(picture.draw), 0.0,
            "largest difference of a byte from a picture that is not drawn in its window alone",
        )  # fmt: skip
    floor = samples["floor"]
    yield Row(
        f"filling the samples of {SIZE[0]} x {SIZE[1]} pixels once", 1e3 * floor.low, "ms", 1e3 * floor.median, 1e3 * floor.high,
        note="depth and triangle, four samples a pixel: a floor for frames that fill the picture",
    )  # fmt: skip


def pictures() -> dict[str, Picture]:
    """Return all that is timed, by name."""
    found = {}
    for style in STYLES:
        env = cut_open(ResectEnv(scenes_of(LEVEL_2, 1), render_mode="rgb_array", render_style=style))
        found[f"frame of {SIZE[0]} x {SIZE[1]} pixels, {LEVEL_2} cut open, {style}"] = Picture(env.render, at_most(10.0))
    liver = gs.Simulation(gs.meshes.liver(), gs.Material(5e3, 1000.0)).body
    found[f"frame of {SIZE[0]} x {SIZE[1]} pixels, liver"] = Picture(lambda: render_body(liver), at_most(10.0))
    for mode in CHANNELS:
        pictured = PixelObservation(cut_open(ResectEnv(scenes_of(LEVEL_2, 1))), mode)
        found[f"pixel observation, 84 x 84, {mode}"] = Picture(lambda pictured=pictured: pictured.observation({}), at_most(1.0))
    return found


def cut_open(env: ResectEnv) -> ResectEnv:
    """Make the first cuts of the scene's certificate."""
    env.reset(seed=0)
    assert env.scene.certificate is not None
    for action in env.scene.certificate.order[:N_CUTS]:
        env.step(action)
    return env


def difference(draw: Draw) -> float:
    """Return the largest difference of a byte between a picture and the same one drawn without a window."""
    picture = draw().astype(np.int64)
    with mock.patch.object(raster, "find_window", lambda screen, size, grid: raster.Window(0, 0, *size)):
        return float(np.abs(picture - draw()).max())
