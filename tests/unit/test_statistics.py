"""Figures over seeds and scenes: the known formulas, and intervals that hold what they promise."""

import numpy as np
import pytest
import scipy.stats

from agents.statistics import CONFIDENCE, estimate, estimate_difference, estimate_share, interquartile_mean


@pytest.mark.parametrize("n", [1, 3, 4, 5, 7, 8, 64, 321])
def test_the_interquartile_mean_is_scipys_trimmed_mean(n):
    values = np.random.default_rng(n).normal(size=(3, n))
    assert interquartile_mean(values) == pytest.approx(scipy.stats.trim_mean(values, 0.25, axis=1), rel=1e-12)


def test_a_single_seed_gives_the_bootstrap_interval_of_scipy():
    values = np.random.default_rng(5).exponential(size=80)
    interval = estimate(values[None], interquartile_mean)
    theirs = scipy.stats.bootstrap(
        (values,), lambda sample, axis: scipy.stats.trim_mean(sample, 0.25, axis=axis), n_resamples=20000,
        confidence_level=CONFIDENCE, method="percentile", rng=np.random.default_rng(1),
    ).confidence_interval  # fmt: skip
    # The 2.5th percentile of 2000 resamples scatters by sqrt(p q / n) / density: a tenth of the interval's width is 3 sigma.
    width = theirs.high - theirs.low
    assert interval.value == pytest.approx(scipy.stats.trim_mean(values, 0.25))
    assert [interval.low, interval.high] == pytest.approx([theirs.low, theirs.high], abs=0.1 * width)


def test_the_interval_of_a_mean_has_the_width_of_its_standard_errors():
    # With effects of seeds (spread a) and of scenes (spread b) alone, the variance of the mean is a^2 / n_seeds + b^2 / n_scenes.
    rng = np.random.default_rng(3)
    seeds, scenes = rng.normal(size=40), rng.normal(size=60)
    values = 0.5 * seeds[:, None] + 2.0 * scenes[None, :]
    variance = 0.25 * seeds.var() / len(seeds) + 4.0 * scenes.var() / len(scenes)
    interval = estimate(values)
    assert interval.high - interval.low == pytest.approx(2 * 1.96 * np.sqrt(variance), rel=0.08)


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    rng = np.random.default_rng(11)
    truth, n_trials, n_held = 1.0, 100, 0
    for _ in range(n_trials):
        values = truth + rng.normal(size=(10, 1)) * 0.5 + rng.normal(size=(1, 40)) + rng.normal(size=(10, 40))
        interval = estimate(values)
        n_held += interval.low <= truth <= interval.high
    # 95 of 100 with a binomial spread of 2.2; few seeds make percentile intervals a little narrow.
    assert 86 <= n_held <= n_trials


def test_the_same_values_give_the_same_interval():
    values = np.random.default_rng(0).normal(size=(5, 30))
    assert estimate(values) == estimate(values.copy())


@pytest.mark.parametrize("has_happened", [True, False])
def test_a_share_of_all_or_none_keeps_the_doubt_that_few_scenes_leave(has_happened):
    interval = estimate_share(np.full((5, 64), has_happened))
    exact = scipy.stats.binomtest(64 * has_happened, 64).proportion_ci(CONFIDENCE, method="exact")
    assert interval == pytest.approx((float(has_happened), exact.low, exact.high))


def test_a_difference_is_of_means_on_the_same_scenes():
    rng = np.random.default_rng(2)
    hardness = rng.normal(size=50)
    base = np.tile(hardness, (3, 1))
    better = np.tile(hardness + 0.25, (5, 1))
    # Scenes differ wildly, policies by a constant: drawn together, the scenes leave no doubt.
    assert estimate_difference(better, base) == pytest.approx((0.25, 0.25, 0.25))
    assert estimate_difference(base, better).value == pytest.approx(-0.25)
