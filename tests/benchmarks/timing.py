"""Timing on a busy machine: contestants take turns, and what was timed in the same round is compared."""

import gc
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

LOW, HIGH = 10.0, 90.0
"""Percentiles: other processes can only slow a run down, so the low one is near the true time, and steadier than the minimum."""
BLOCK = 5
"""Rounds of a block in which two contestants are compared."""
SLICE = 0.004
"""Aim at this long for one timed call [s]: far above the clock's grain, and often short enough to slip between time slices."""


@dataclass(frozen=True)
class Sample:
    """What one contestant took, round by round."""

    times: np.ndarray
    """Seconds per unit of work, shape (rounds,)."""

    @property
    def low(self) -> float:
        """Return the 10th percentile [s]."""
        return float(np.percentile(self.times, LOW))

    @property
    def median(self) -> float:
        """Return the median [s]."""
        return float(np.median(self.times))

    @property
    def high(self) -> float:
        """Return the 90th percentile [s]."""
        return float(np.percentile(self.times, HIGH))


class Ratio(NamedTuple):
    """One sample over another that was taken in the same rounds."""

    value: float
    """Median over blocks of the ratio of the two shortest times of a block."""
    low: float
    """10th percentile of these ratios."""
    high: float
    """90th percentile of them."""


def ratio(sample: Sample, base: Sample) -> Ratio:
    """Return sample over base, compared block by block of consecutive rounds.

    Within a block the shortest time drops what other processes took; where the clock of the processor drifts, it
    drifts for both contestants of a block alike.
    """
    n_blocks = max(1, len(base.times) // BLOCK)
    shortest, base_shortest = (
        np.array([block.min() for block in np.array_split(times, n_blocks)]) for times in (sample.times, base.times)
    )
    return Ratio(*(float(np.percentile(shortest / base_shortest, share)) for share in (50.0, LOW, HIGH)))


def interleave(contestants: Mapping[str, Callable[[], float]], rounds: int, seed: int = 0) -> dict[str, Sample]:
    """Let contestants take turns, in a new order each round.

    Each is called once per round and returns its seconds per unit of work. The collector of garbage rests meanwhile.
    """
    times: dict[str, list[float]] = {name: [] for name in contestants}
    order, rng = list(contestants), np.random.default_rng(seed)
    gc.collect()
    gc.disable()
    try:
        for _ in range(rounds):
            rng.shuffle(order)
            for name in order:
                times[name].append(contestants[name]())
    finally:
        gc.enable()
    return {name: Sample(np.array(taken)) for name, taken in times.items()}


class Stepper(NamedTuple):
    """A body of some maker, as the clock sees it."""

    restart: Callable[[], None]
    """Go back to the start; not timed."""
    advance: Callable[[int], object]
    """Take so many steps; returns when they are done."""
    positions: Callable[[], np.ndarray]
    """Return the positions of the mesh's points [m], shape (n_points, 3)."""


def calibrated(stepper: Stepper, longest: int = 2000) -> Callable[[], float]:
    """Return a function that restarts a body, times some steps and returns the seconds per step.

    The number of steps is chosen so that they take about SLICE. Call it once the code is warm.
    """
    stepper.restart()
    n_steps, taken = 1, timed(stepper.advance, 1)
    while taken < 0.25 * SLICE and n_steps < longest:
        n_steps *= 4
        stepper.restart()
        taken = timed(stepper.advance, n_steps)
    n_steps = int(np.clip(round(n_steps * SLICE / taken), 1, longest))

    def time_steps() -> float:
        stepper.restart()
        return timed(stepper.advance, n_steps) / n_steps

    return time_steps


def timed(function: Callable[..., object], *arguments: object) -> float:
    """Return how long a call takes [s]."""
    start = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - start


def positions_after(stepper: Stepper, n_steps: int) -> np.ndarray:
    """Return the positions after some steps from the start [m], float64 (n_points, 3); this also warms the code up."""
    stepper.restart()
    stepper.advance(n_steps)
    return np.array(stepper.positions(), dtype=np.float64)


def difference(positions: np.ndarray, expected: np.ndarray, start: np.ndarray) -> float:
    """Return the largest distance of a point from where it should be, over the farthest that any point has moved."""
    moved = np.linalg.norm(expected - start, axis=1).max()
    return float(np.linalg.norm(positions - expected, axis=1).max() / moved)


def sampled(values: Iterable[float]) -> Sample:
    """Return measured seconds as a sample."""
    return Sample(np.fromiter(values, dtype=np.float64))
