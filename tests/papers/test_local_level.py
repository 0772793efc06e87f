"""Noise of a local level, against brute force and simulated truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from imumon.blocks import FloatArray, IntArray
from imumon.filters.slots import SlotGatherer
from imumon.papers.local_level import (
    SLOT_S,
    ExponentialMean,
    LocalLevel,
    RestMean,
    RestMeans,
    filtered,
    fit_local_level,
    from_noise,
    level_after,
)

RNG = np.random.default_rng(0)


def means_of(time_ns: IntArray, reading: FloatArray) -> list[RestMean]:
    """Return the means of a recording at rest, reading (n,) in rad/s, NaN where it is not."""
    gatherer = SlotGatherer(1, round(SLOT_S * 1e9))
    slots = gatherer.process(time_ns, np.zeros(len(time_ns), np.int64), reading[:, np.newaxis])
    return [row[0] for row in RestMeans().process(slots)]


def seconds(values: list[float], covered_s: float = 1.0) -> list[RestMean]:
    return [RestMean(k == 0, 1.0, 0.0 if math.isnan(v) else covered_s, v, 0.01) for k, v in enumerate(values)]


@pytest.mark.parametrize("ratio", [0.0, 1e-3, 0.3])
def test_the_likelihood_is_that_of_the_differences_from_the_first_mean(ratio: float) -> None:
    values = np.cumsum(RNG.normal(size=40)) * 0.3 + RNG.normal(size=40)
    values[[7, 20]] = math.nan
    deviance, white, *_ = filtered(seconds(values.tolist()), np.array([ratio]))
    at = np.flatnonzero(np.isfinite(values))
    walk = ratio * np.minimum.outer(at[1:], at[1:])
    covariance = walk + np.eye(len(at) - 1) + 1.0
    d = values[at[1:]] - values[0]
    scale = float(d @ np.linalg.solve(covariance, d)) / len(d)
    assert white[0] == pytest.approx(scale, rel=1e-9)
    log = multivariate_normal(np.zeros(len(d)), scale * covariance).logpdf(d)
    n = len(d)
    assert deviance[0] == pytest.approx(-2 * log - n * math.log(2 * math.pi) - n, rel=1e-9)


def test_white_noise_and_walk_come_out_as_they_went_in() -> None:
    white, walk = 4e-7, 4e-10
    n = 3600
    level = np.cumsum(math.sqrt(walk) * RNG.standard_normal(n))
    fit = fit_local_level(seconds((level + math.sqrt(white) * RNG.standard_normal(n)).tolist()))
    assert fit.white == pytest.approx(white, rel=0.1)
    assert walk / 3.0 < fit.walk < 3.0 * walk


def test_a_minute_does_not_show_a_walk_and_the_filters_get_one_all_the_same() -> None:
    assert fit_local_level(seconds((1e-3 * RNG.standard_normal(60)).tolist())).walk > 0.0


def test_a_constant_reading_has_next_to_no_noise() -> None:
    assert 0.0 < fit_local_level(seconds([0.25] * 100)).white < 1e-20


def test_the_level_is_that_of_the_last_segment() -> None:
    noise = LocalLevel(1e-6, 1e-12)
    means = seconds([5.0] * 10) + seconds([1.0, 1.0, 1.0, 1.0])
    level, variance = level_after(means, noise)
    assert level == pytest.approx(1.0)
    assert variance == pytest.approx(1e-6 / 4, rel=1e-3)


def test_known_noise_gives_the_walk_of_the_best_average() -> None:
    """Without flicker it is the walk itself; with flicker alone 1/T = 2h."""
    assert from_noise(1e-4, None, 1e-6).walk == pytest.approx(1e-12)
    flicker = from_noise(1e-4, 1e-5, None)
    h = (1e-5**2 / (math.pi / math.log(10))) / math.log(10) / 1e-8
    assert flicker.walk == pytest.approx((2 * h) ** 2 * 1e-8)
    assert flicker.white / 0.01 == pytest.approx(1e-6)


def test_means_of_a_recording_leave_out_seconds_that_are_mostly_missing() -> None:
    reading = np.repeat(np.arange(10.0), 100)
    reading[330:390] = np.nan
    means = means_of(np.arange(1000) * 10_000_000, reading)
    assert [mean.mean for mean in means][:3] == pytest.approx([0.0, 1.0, 2.0])
    assert math.isnan(means[3].mean)
    assert means[3].covered_s == 0.0
    assert means[4].covered_s == pytest.approx(1.0)


def test_the_exponential_mean_is_the_plain_mean_first_and_the_hold_stays() -> None:
    values = RNG.normal(size=300).tolist()
    fading, held = ExponentialMean(100.0), ExponentialMean(math.inf, 60.0)
    shown, kept = (np.array([mean.step(new) for new in seconds(values)]) for mean in (fading, held))
    np.testing.assert_allclose(shown[:100], np.cumsum(values)[:100] / np.arange(1, 101), rtol=1e-9)
    step = shown[200] - shown[199]
    assert step == pytest.approx((1 - math.exp(-0.01)) * (values[200] - shown[199]))
    np.testing.assert_allclose(kept[59:], np.mean(values[:60]), rtol=1e-12)
