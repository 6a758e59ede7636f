"""The environment: what a reset costs, what a step costs, and how much of the batch's time is physics."""

import contextlib
import os
import pathlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from envs.library import load_scene_config, load_scenes
from envs.resect import ResectEnv
from envs.scene import Scene, build_scene
from gmapspring.errors import ConfigError
from tests.benchmarks import prototype_worker
from tests.benchmarks.rows import Plan, Row, at_least, at_most, failed, reason_of
from tests.benchmarks.timing import Sample, interleave, timed

LEVEL_2 = "box-192"
N_SCENES = 6
WRITTEN_PROTOTYPE = 2200.0
"""Steps per second of the prototype on a Zen 5 core, for where it cannot run in turns with ours."""
PROTOTYPE_FOLDER = "GMAPSPRING_PROTOTYPE"
"""Environment variable that points to the prototypes; its subfolder task is used."""
N_ROWS = 64
CHUNK = 100
"""Steps between two turns."""


def scenes_of(name: str, count: int = N_SCENES) -> list[Scene]:
    """Return some scenes; where none is certified yet, uncertified ones from the same configuration."""
    try:
        certified = load_scenes(name, "train")
        return [certified[i] for i in range(min(count, len(certified)))]
    except ConfigError:
        config = load_scene_config(name)
        return [build_scene(config, seed) for seed in range(count)]


class Player:
    """A single environment under random legal actions."""

    def __init__(self, name: str, count: int = N_SCENES):
        """Build and settle all scenes, so that no step or reset does it on the clock."""
        scenes = scenes_of(name, count)
        self.env = ResectEnv(scenes)
        for index in range(len(scenes)):
            self.env.reset(seed=index, options={"index": index})
        self.rng = np.random.default_rng(0)
        self.has_ended = False

    def legal(self) -> int:
        """Return a random legal action."""
        return int(self.rng.choice(np.flatnonzero(self.env.action_masks())))

    def step(self) -> float:
        """Take a step and return its time [s]; resets come in between, untimed."""
        if self.has_ended:
            self.env.reset()
        action = self.legal()
        begin = time.perf_counter()
        _, _, terminated, truncated, _ = self.env.step(action)
        taken = time.perf_counter() - begin
        self.has_ended = terminated or truncated
        return taken

    def steps(self) -> float:
        """Take some steps and return the seconds per step."""
        return sum(self.step() for _ in range(CHUNK)) / CHUNK

    def resets(self) -> float:
        """Cut once and reset, some times; return the seconds per reset."""
        total = 0.0
        for _ in range(10):
            self.step()
            total += timed(self.env.reset)
        self.has_ended = False
        return total / 10

    def observations(self) -> float:
        """Build an observation, some times; return the seconds of each."""
        observe = getattr(self.env, "_observe", None)
        if observe is None:
            raise AttributeError("the environment has no _observe to time alone")
        return sum(timed(observe) for _ in range(10)) / 10


def measure_reset(plan: Plan) -> Iterator[Row]:
    """Yield the time of a reset beside the observation it returns, for each level."""
    for name in ("box-108", LEVEL_2) if plan.is_quick else ("box-48", "box-108", LEVEL_2, "liver"):
        row_name = f"reset beside observation, {name}"
        try:
            player = Player(name, 2)
            player.resets(), player.observations()
            samples = interleave({"reset": player.resets, "observe": player.observations}, plan.rounds)
        except Exception as error:
            yield failed(row_name, reason_of(error), unit="µs", asked=at_most(50.0))
            continue
        reset, observe = samples["reset"], samples["observe"]
        beside = 1e6 * (reset.times - observe.times)
        yield Row(
            row_name, 1e6 * (reset.low - observe.low), "µs", float(np.percentile(beside, 10)), float(np.percentile(beside, 90)),
            at_most(50.0), reset_error(player), 0.0, "largest difference between two observations of the same reset",
            "LapGym: a new process", f"whole reset {1e6 * reset.low:.0f} µs, of scenes that have been played before",
        )  # fmt: skip


def reset_error(player: Player) -> float:
    """Return the largest difference between the observations of one scene before and after it has been played."""
    before, _ = player.env.reset(options={"index": 0})
    kept = {key: np.array(value, dtype=np.float64) for key, value in before.items()}
    player.has_ended = False
    for _ in range(3):
        player.step()
    after, _ = player.env.reset(options={"index": 0})
    player.has_ended = False
    return max(float(np.abs(np.asarray(after[key], np.float64) - kept[key]).max()) for key in kept)


def measure_single(plan: Plan) -> Iterator[Row]:
    """Yield the steps per second of one environment, against the prototype in turns where it can be had."""
    player = Player(LEVEL_2)
    player.steps()
    contest: dict[str, Callable[[], float]] = {"ours": player.steps}
    rounds = 7 if plan.is_quick else 21
    with contextlib.ExitStack() as stack:
        reference = f"the prototype's written {WRITTEN_PROTOTYPE:.0f} steps/s; set {PROTOTYPE_FOLDER} to time it in turns"
        if os.environ.get(PROTOTYPE_FOLDER):
            try:
                contest["prototype"] = stack.enter_context(prototype())
                reference = "prototype, timed in turns"
            except Exception as error:
                plan.say(f"the prototype cannot be timed: {reason_of(error)}")
        samples = interleave(contest, rounds)
    theirs = 1.0 / samples["prototype"].median if "prototype" in samples else WRITTEN_PROTOTYPE
    yield rate_row("single environment, level 2, random legal actions, full step", samples["ours"], at_least(3.0 * theirs),
                   f"{reference}: {theirs:.0f} steps/s")  # fmt: skip
    if "prototype" in samples:
        paired = samples["prototype"].times / samples["ours"].times
        low, high = (float(np.percentile(paired, p)) for p in (10, 90))
        value = float(np.median(paired))
        yield Row("single environment, level 2: ours / prototype, steps per second", value, "", low, high, at_least(3.0))


def rate_row(name: str, sample: Sample, asked: Any, reference: str = "", factor: float = 1.0, note: str = "") -> Row:
    """Return a row of steps per second: the median, since the steps themselves differ."""
    rates = factor / sample.times
    low, high = (float(np.percentile(rates, p)) for p in (10, 90))
    return Row(name, factor / sample.median, "steps/s", low, high, asked, reference=reference, note=note)


@contextlib.contextmanager
def prototype() -> Iterator[Callable[[], float]]:
    """Start the prototype in a process of its own, which writes into a passing folder only."""
    folder = pathlib.Path(os.environ[PROTOTYPE_FOLDER]) / "task"
    with tempfile.TemporaryDirectory() as scratch:
        environment = os.environ | {"NUMBA_CACHE_DIR": scratch, "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, prototype_worker.__file__, str(folder)]
        with subprocess.Popen(command, cwd=scratch, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                              stderr=subprocess.DEVNULL) as process:  # fmt: skip

            def steps() -> float:
                assert process.stdin and process.stdout
                process.stdin.write(f"{CHUNK}\n")
                process.stdin.flush()
                return float(process.stdout.readline())

            try:
                while (line := process.stdout.readline() if process.stdout else "") != "ready\n":
                    if not line:
                        raise RuntimeError(f"the prototype in {folder} ends before its first step")
                steps()
                yield steps
            finally:
                process.kill()


def measure_vector(plan: Plan) -> Iterator[Row]:
    """Yield the throughput of the vector environment and the part of its time that is physics."""
    name = f"vector environment, {N_ROWS} rows, level 2: physics of all time"
    try:
        batch, physics = VectorPlayer(make_vector()), SettlePlayer()
        for _ in range(20):
            batch.step()
    except Exception as error:
        yield failed(name, reason_of(error), unit="%", asked=at_least(80.0))
        return
    samples = interleave({"step": batch.step, "settle": physics.settle}, 20 if plan.is_quick else 80)
    step, settle = samples["step"], samples["settle"]
    yield rate_row(f"vector environment, {N_ROWS} rows, level 2, random legal actions", step, None, factor=N_ROWS)
    shares = 100.0 * np.array(batch.physics[-len(step.times) :]) / step.times
    note = (
        "physics is the call that settles all rows, timed within the step: "
        f"{1e6 * np.median(batch.physics) / N_ROWS:.0f} µs a row; "
        f"a settle alone, of single bodies after two random cuts: {1e6 * settle.median:.0f} µs"
    )
    low, high = (float(np.percentile(shares, p)) for p in (10, 90))
    yield Row(name, float(np.median(shares)), "%", low, high, at_least(80.0), note=note)


def make_vector(count: int = 16) -> Any:
    """Return the vector environment, on scenes that have all been settled, so that no step does it on the clock."""
    from envs.vector import ResectVectorEnv

    env = ResectVectorEnv(num_envs=N_ROWS, scene=scenes_of(LEVEL_2, count), autoreset_mode=AutoresetMode.SAME_STEP)
    for index in range(count):
        env.reset(options={"index": index})
    return env


class VectorPlayer:
    """A vector environment under random legal actions."""

    def __init__(self, env: Any):
        """Reset all rows."""
        self.env, self.rng = env, np.random.default_rng(0)
        self.observation, _ = env.reset(seed=0)
        self.physics: list[float] = []
        """Seconds of each step in the kernel that settles the bodies [s]."""
        advance = env._rows.integrator.advance
        env._rows.integrator = env._rows.integrator._replace(advance=lambda *given: self.physics.append(timed(advance, *given)))

    def step(self) -> float:
        """Step all rows once; return the seconds [s]."""
        noise = self.rng.random(self.observation["action_mask"].shape)
        actions = np.argmax(noise * self.observation["action_mask"], axis=1)
        begin = time.perf_counter()
        self.observation = self.env.step(actions)[0]
        return time.perf_counter() - begin


class SettlePlayer:
    """The bodies of single environments in mid-episode, settled alone."""

    def __init__(self, count: int = 16):
        """Cut each body twice at random."""
        self.bodies = []
        for index, scene in enumerate(scenes_of(LEVEL_2, count)):
            env = ResectEnv(scene)
            env.reset(seed=index)
            rng = np.random.default_rng(index)
            for _ in range(2):
                if env.action_masks().any() and not env.step(int(rng.choice(np.flatnonzero(env.action_masks()))))[2]:
                    continue
                env.reset()
            simulation = env.task.simulation
            self.bodies.append((simulation, simulation.save_state(), scene.physics.settle_seconds))
        self.n_substeps = 0

    def settle(self) -> float:
        """Let a body settle for the time of one action; return the mean over all bodies [s]."""
        total = 0.0
        for simulation, start, seconds in self.bodies:
            simulation.load_state(start)
            begin = time.perf_counter()
            self.n_substeps = simulation.advance(seconds, step=simulation.stable_step)
            total += time.perf_counter() - begin
        return total / len(self.bodies)


