"""`gmapspring bench`: how fast it is on this machine, in half a minute; `make bench` in a clone compares it with peers."""

import argparse
import time
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

import gmapspring as gs
from agents.commands.command import Command, add_json, number, print_json, say
from agents.progress import ProgressReport
from agents.table import print_table
from envs.frames import STYLES
from envs.library import load_scenes
from envs.pixels import CHANNELS, PixelObservation
from envs.resect import ResectEnv
from envs.scene import Scene
from envs.vector import ResectVectorEnv
from gmapspring import machine
from gmapspring.errors import ConfigError
from gmapspring.render import render_body

N_SUBSTEPS = 50
"""Substeps of one timed call."""
N_CUTS = 40
"""Cuts of one timed call."""
N_ROWS = 64
"""Episodes side by side."""
SCENE = "box-192"
PACKAGES = ("gmapspring", "numba", "numpy")
"""Packages whose versions matter."""
ROUNDS = 9
"""Least number of times that each is timed."""


class Measure(NamedTuple):
    """Something to time."""

    name: str
    unit: str
    """Microseconds or milliseconds of one, or how many in a second."""
    n_units: int
    """How many of it a call does."""
    call: Callable[[], object]


class Result(NamedTuple):
    """What was measured."""

    name: str
    unit: str
    median: float
    low: float
    """10th percentile."""
    high: float
    """90th percentile."""


SCALES = {"µs": 1e6, "ms": 1e3}
"""Units in a second; all others count how many there are in one."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--seconds", type=number, default=2.0, help="time for each row [2]")
    add_json(parser)


def run(parsed: argparse.Namespace, console: Console) -> int:
    """Time everything once warm, row by row."""
    if parsed.seconds == 0.0:
        raise ConfigError("--seconds is 0; give each row some time, such as 1")
    measures, results = list(_measures()), []
    with ProgressReport(say(parsed), "measuring") as report:
        for done, measure in enumerate(measures):
            report.update(done / len(measures), measure.name)
            results.append(timed(measure, parsed.seconds))
    if parsed.json:
        print_json({"machine": machine.describe(), "results": [result._asdict() for result in results]})
        return 0
    headers = ("measure", "unit", "median", "10th to 90th percentile")
    rows = [(each.name, each.unit, f"{each.median:.4g}", f"{each.low:.4g} to {each.high:.4g}") for each in results]
    print_table(console, machine.in_a_line(PACKAGES), headers, rows)
    return 0


def timed(measure: Measure, seconds: float) -> Result:
    """Call something until its time is over, and at least some rounds, after a call that warms it up."""
    measure.call()
    times: list[float] = []
    start = time.perf_counter()
    while len(times) < ROUNDS or time.perf_counter() - start < seconds:
        before = time.perf_counter()
        measure.call()
        times.append((time.perf_counter() - before) / measure.n_units)
    each = np.array(times)
    values = each * SCALES[measure.unit] if measure.unit in SCALES else 1.0 / each
    low, median, high = np.percentile(values, [10.0, 50.0, 90.0]).tolist()
    return Result(measure.name, measure.unit, median, low, high)


def _measures() -> Iterator[Measure]:
    """Yield what is timed; each brings its own warm state along."""
    for dtype in (np.float64, np.float32):
        yield Measure(f"RK4 substep, liver, {dtype.__name__}", "µs", N_SUBSTEPS, _moving(_liver(dtype)))
    yield Measure("cut of a face, liver", "µs", N_CUTS, _cutting())
    yield Measure(f"step of Resect-v0, {SCENE}, one environment", "steps/s", N_ROWS, _playing())
    yield Measure(f"step of Resect-v0, {SCENE}, {N_ROWS} side by side", "steps/s", N_ROWS, _playing_many())
    liver = _liver(np.float64).body
    yield Measure("frame of 480 x 480 pixels, liver", "ms", 1, lambda: render_body(liver))
    for style in STYLES:
        yield Measure(f"frame of 480 x 480 pixels, {SCENE}, {style}", "ms", 1, _framing(style))
    for mode in CHANNELS:
        yield Measure(f"pixel observation of 84 x 84, {SCENE}, {mode}", "ms", 1, _picturing(mode))


def _liver(dtype: Any) -> gs.Simulation:
    """Return the shipped organ, hung from its anchor."""
    mesh = gs.meshes.liver()
    pinned, gravity = np.array(mesh.point_regions["anchor"]), (0.0, 0.0, -9.81)
    return gs.Simulation(mesh, gs.Material(5e3, 1000.0, viscosity=5.0), pinned=pinned, gravity=gravity, dtype=dtype)


def _moving(simulation: gs.Simulation) -> Callable[[], object]:
    """Return what takes some substeps."""
    step = simulation.default_step
    return lambda: simulation.advance(N_SUBSTEPS * step, step)


def _cutting() -> Callable[[], object]:
    """Return what makes some cuts, each where the last one has opened the body, and takes them back."""
    liver = _liver(np.float64)
    start = liver.save_state()
    beyond = liver.body.gmap.image // 24
    pairs = [(tet, int(other)) for tet in range(liver.body.n_tetrahedra) for other in beyond[tet] if other > tet][:N_CUTS]

    def cut() -> None:
        for one, other in pairs:
            liver.split_face(one, other)
        liver.load_state(start)

    return cut


def _playing() -> Callable[[], object]:
    """Return what does legal actions at random, and starts the next episode where one has ended."""
    env, generator = ResectEnv(_one_scene()), np.random.default_rng(0)
    env.reset(seed=0)

    def play() -> None:
        for _ in range(N_ROWS):
            _, _, terminated, truncated, _ = env.step(int(generator.choice(np.flatnonzero(env.action_masks()))))
            if terminated or truncated:
                env.reset()

    return play


def _one_scene() -> list[Scene]:
    """Return a single scene, so that none is built while the clock runs."""
    return load_scenes(SCENE, "test")[:1]


def _playing_many() -> Callable[[], object]:
    """Return what does one legal action at random in each of many episodes."""
    envs, generator = ResectVectorEnv(N_ROWS, _one_scene(), autoreset_mode="SAME_STEP"), np.random.default_rng(0)
    envs.reset(seed=0)

    def play() -> None:
        masks = envs.action_masks()
        envs.step((generator.random(masks.shape, np.float32) * masks).argmax(axis=1))

    return play


def _framing(style: str) -> Callable[[], object]:
    """Return what draws a frame of an episode."""
    env = ResectEnv(_one_scene(), render_mode="rgb_array", render_style=style)
    env.reset(seed=0)
    return env.render


def _picturing(mode: str) -> Callable[[], object]:
    """Return what makes a picture of an observation."""
    plain = ResectEnv(_one_scene())
    pictured, (seen, _) = PixelObservation(plain, mode), plain.reset(seed=0)
    return lambda: pictured.observation(seen)


COMMAND = Command("tell how fast everything is on this machine", "bench --json", add_arguments, run)
