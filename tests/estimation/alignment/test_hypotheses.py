from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment import hypotheses
from imumon.estimation.alignment.fit import PoseRecord, fit_pose
from imumon.estimation.alignment.hypotheses import (
    NOISES,
    SETTLES,
    SETTLING,
    SIZES,
    SWAYING,
    SWAYS,
    Seen,
    courses,
    told,
)
from tests.estimation.alignment.units import ANY_REST

SLOT_S = 0.25
TRUTH = 5e-5 + 2e-5j
DRIFTS = np.array([1.0, 1.5])
"""Drifts of accelerometers that are noise, over that of the level."""


def _problem(seed: int) -> tuple[Seen, FloatArray, ColumnArray, FloatArray, ColumnArray]:
    """Return what is seen, and the slopes, the gyros, the courses and the accelerometers it is made of."""
    rng, rows, noise, level_sd = np.random.default_rng(seed), 60, 3e-7, 4e-6
    angles = courses(np.arange(rows + 1.0))
    slopes, middles = np.diff(angles, axis=0), 0.5 * (angles[1:] + angles[:-1])
    rate = 2e-7 + noise * (rng.normal(size=rows) + 1j * rng.normal(size=rows))
    level = level_sd * (rng.normal(size=rows) + 1j * rng.normal(size=rows))
    swing = 2e-5 * np.sin(0.2 * np.arange(rows + 1.0))
    rate, level = rate + np.diff(swing), level + 0.5 * (swing[1:] + swing[:-1])
    columns = np.column_stack([np.ones(rows), slopes, rate.real, rate.imag])
    precision = (DRIFTS * level_sd) ** -2.0
    drifts = 2.0 * rows * np.log(1.0 / DRIFTS) - 0.5 * precision * np.vdot(level, level).real - math.log(2.0)
    seen = Seen(
        columns.T @ columns, rows, noise**2 / 16.0, precision[:, None, None] * (middles.T @ middles),
        precision[:, None] * (middles.T @ level), drifts,
    )  # fmt: skip
    return seen, slopes, rate, middles / level_sd, level / level_sd


def _density(values: ColumnArray, covariance: FloatArray) -> float:
    """Return the logarithm of the density of both parts of a complex vector."""
    sign, determinant = np.linalg.slogdet(covariance)
    assert sign > 0.0
    return float(-determinant - 0.5 * (values.conj() @ np.linalg.solve(covariance, values)).real)


@pytest.mark.parametrize("which", [(0, 0, 0), (1, 1, 2), (4, 0, 1)])
@pytest.mark.parametrize("seen_by_all", [True, False])
def test_a_hypothesis_is_the_batch_fit_of_gyros_and_accelerometers(
    which: tuple[int, int, int], seen_by_all: bool
) -> None:
    """Covariances of all rows, the mean rate with a prior so wide that it does not matter."""
    seen, slopes, rate, middles, level = _problem(sum(which))
    family = SWAYS if seen_by_all else hypotheses.UNSEEN
    found, stands = hypotheses._family(seen, family), hypotheses._stands(seen)
    k, drift, size = which
    columns, variance, wide, n = family.columns[k], 1.0 / family.precision[size], 1e-4, len(rate)

    def density(noise: float, accelerometers: float, tilts: bool) -> float:
        left = slopes[:, columns] * np.sqrt(variance) * tilts
        right = middles[:, columns] * np.sqrt(variance) * tilts
        across = left @ right.T if seen_by_all else np.zeros((n, n))
        gyros = left @ left.T + wide**2 + noise * np.eye(n)
        whole = np.block([[gyros, across], [across.T, right @ right.T + accelerometers**2 * np.eye(n)]])
        return _density(np.concatenate([rate, level]), whole)

    def summed(tilts: bool, drifts: FloatArray) -> float:
        every = [density(seen.noise * share, sd, tilts) for share in NOISES for sd in drifts]
        return float(np.logaddexp.reduce(every))

    drifts = DRIFTS[[drift]] if seen_by_all else DRIFTS
    share = math.log(family.share / len(family.columns) / len(SIZES) / ((1.0 - SETTLING) * (1.0 - SWAYING)))
    expected = summed(True, drifts) - summed(False, DRIFTS) + share
    shape = len(family.columns), len(DRIFTS) if seen_by_all else 1, len(SIZES)
    at = np.ravel_multi_index((k, drift if seen_by_all else 0, size), shape)
    assert found.log_weight[at] - stands.log_weight[0] == pytest.approx(expected, abs=1e-2)


def test_prior_probabilities_add_up_to_one() -> None:
    both = 0.5 * SETTLING * SWAYING
    beside = SETTLES.beside(SWAYS, 1, 1, both), SWAYS.beside(SETTLES, 2, 1, both)
    shares = [family.share for family in (SETTLES, SWAYS, hypotheses.UNSEEN, *beside)]
    assert (1.0 - SETTLING) * (1.0 - SWAYING) + sum(shares) == pytest.approx(1.0)
    assert beside[0].columns.shape == (len(SETTLES.columns), 11)
    assert beside[1].precision.shape == (len(SIZES), 11)


@pytest.mark.parametrize(("seconds", "hertz"), [(20.0, 0.05), (20.0, 0.08), (60.0, 0.01), (60.0, 0.07)])
@pytest.mark.parametrize("seen", [1.0, 0.3])
def test_a_sway_of_few_periods_is_told_from_the_earth_rate_or_leaves_a_wide_sigma(
    seconds: float, hertz: float, seen: float
) -> None:
    """The accelerometers may see less of the sway than there is, when it swings to and fro."""
    ratios = []
    for seed in range(5):
        rng, n = np.random.default_rng(seed), round(seconds / SLOT_S)
        angle = 2e-4 * np.sin(2.0 * math.pi * (hertz * SLOT_S * np.arange(n + 1) + rng.uniform()))
        rate = 5.8e-7 * rng.normal(size=(n, 3)) + [TRUTH.real, TRUTH.imag, 4e-5]
        rate[:, 0] += np.diff(angle) / SLOT_S
        level = seen * angle[1:] + 1e-5 * (rng.normal(size=n) + 1j * rng.normal(size=n))
        fit = fit_pose(PoseRecord(SLOT_S * np.arange(0.5, n), np.full(n, 25.0), rate, level), ANY_REST)
        assert fit is not None
        weight = np.exp(fit.log_weight - fit.log_weight.max())
        weight /= weight.sum()
        mean = weight @ fit.mean
        sd = math.sqrt(weight @ (fit.variance + 0.5 * np.abs(fit.mean - mean) ** 2))
        ratios += [(mean - TRUTH).real / sd, (mean - TRUTH).imag / sd]
    assert np.sqrt(np.mean(np.square(ratios))) < 1.8
    assert np.abs(ratios).max() < 5.0


def test_the_noise_is_found_whatever_the_least_that_is_thought_of() -> None:
    seen, *_ = _problem(3)
    small = told(replace(seen, noise=seen.noise / 4.0))
    best = int(np.argmax(told(seen).log_weight))
    assert small.noise[best] == pytest.approx(told(seen).noise[best], rel=0.3)
