"""What few runs on few scenes allow to say: means with intervals that cover other seeds and other scenes.

After R. Agarwal, M. Schwarzer, P. S. Castro, A. Courville, M. Bellemare, "Deep Reinforcement Learning at the Edge of the
Statistical Precipice" (NeurIPS 2021): the interquartile mean, and percentile bootstrap intervals over runs. Their tasks are fixed
and only runs are drawn anew. Our scenes are themselves a sample, so seeds and scenes are both drawn anew, each with replacement:
an interval covers what another set of seeds would do on another set of scenes, and is wider for it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray[Any, Any]
Statistic = Callable[[Array], Array]
"""A number for each row: (..., n) -> (...)."""

N_RESAMPLES = 2000
CONFIDENCE = 0.95


class Interval(NamedTuple):
    """A figure, and between which values it would fall for other seeds and scenes."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """Return figure and interval."""
        return f"{self.value:.3f} [{self.low:.3f}, {self.high:.3f}]"


def mean(values: Array) -> Array:
    """Return the means over the last axis."""
    return np.asarray(values.mean(axis=-1))


def interquartile_mean(values: Array) -> Array:
    """Return the means of the middle halves over the last axis; a quarter of the values, rounded down, is cut off at each end."""
    n_cut = values.shape[-1] // 4
    return mean(np.sort(values, axis=-1)[..., n_cut : values.shape[-1] - n_cut])


def estimate(values: Array, statistic: Statistic = mean) -> Interval:
    """Return a statistic of values (seeds, scenes) with its bootstrap interval; one seed is taken for the only one there is."""
    rng = np.random.default_rng(0)
    seeds, scenes = _draw(len(values), rng), _draw(values.shape[1], rng)
    return Interval(float(statistic(values.ravel())), *_percentiles(statistic(_resampled(values, seeds, scenes))))


def estimate_share(happened: Array) -> Interval:
    """Return the share of what happened, booleans (seeds, scenes), with its interval.

    Where all or none happened, drawing anew finds no spread; then the bound is the one that as many scenes allow (Clopper and
    Pearson, 1934): seeds share the scenes, and do not count as more of them.
    """
    interval = estimate(happened.astype(float))
    bound = ((1.0 - CONFIDENCE) / 2.0) ** (1.0 / happened.shape[1])
    if happened.all():
        return interval._replace(low=bound)
    return interval if happened.any() else interval._replace(high=1.0 - bound)


def estimate_difference(values: Array, others: Array) -> Interval:
    """Return mean(values) - mean(others), both (seeds, scenes) on the same scenes, drawn together; seeds are drawn apart."""
    rng = np.random.default_rng(0)
    scenes = _draw(values.shape[1], rng)
    first, second = (mean(_resampled(each, _draw(len(each), rng), scenes)) for each in (values, others))
    return Interval(float(values.mean() - others.mean()), *_percentiles(first - second))


def _draw(n: int, rng: np.random.Generator) -> Array:
    """Return n numbers below n, drawn with replacement, for each resample."""
    return rng.integers(n, size=(N_RESAMPLES, n))


def _resampled(values: Array, seeds: Array, scenes: Array) -> Array:
    """Return the values of drawn seeds on drawn scenes, (resamples, seeds * scenes)."""
    return values[seeds[:, :, None], scenes[:, None, :]].reshape(len(seeds), -1)


def _percentiles(statistics: Array) -> tuple[float, float]:
    """Return the ends of the interval."""
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(statistics, [tail, 1.0 - tail])
    return float(low), float(high)
