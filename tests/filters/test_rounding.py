"""What the steps of a sensor hide, told from the readings alone."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.filters.rounding import digits, mean_error


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5])
@pytest.mark.parametrize("steps", [0.3, 0.5, 1.0])
def test_the_noise_before_rounding_is_found_wherever_between_two_steps_the_mean_lies(
    steps: float, phase: float
) -> None:
    readings = 0.01 * np.round(steps * np.random.default_rng(3).normal(size=20_000) + phase)
    found = digits(readings)
    assert found is not None
    assert found.step == pytest.approx(0.01)
    assert found.ratio == pytest.approx(steps, rel=0.15)


@pytest.mark.parametrize("phase", [0.3, 0.5])
def test_readings_that_toggle_between_two_steps_have_little_noise(phase: float) -> None:
    """Their variance is that of noise of a third of a step."""
    found = digits(np.round(0.05 * np.random.default_rng(4).normal(size=20_000) + phase))
    if phase == 0.5:
        assert found is not None
        assert found.error > 0.4
    else:
        assert found is None  # never another value


def test_a_reading_that_changes_once_an_hour_has_no_noise_to_see() -> None:
    readings = np.zeros(100_000)
    readings[70_001:70_004] = 0.2
    found = digits(readings)
    assert found is not None
    assert found.step == 0.2
    assert found.error > 0.4


def test_fine_digits_and_none_at_all_are_no_steps() -> None:
    rng = np.random.default_rng(5)
    assert digits(rng.normal(size=20_000)) is None
    assert digits(np.round(rng.normal(size=20_000) * 20.0)) is None
    assert digits(rng.normal(size=10)) is None


@pytest.mark.parametrize("ratio", [0.2, 0.35])
def test_the_mean_of_rounded_samples_errs_by_no_more(ratio: float) -> None:
    noise = np.random.default_rng(6).normal(size=200_000)
    at = np.linspace(-0.5, 0.5, 21)
    errors = [np.round(ratio * noise + place).mean() - place for place in at]
    assert np.max(np.abs(errors)) == pytest.approx(mean_error(1.0, ratio), rel=0.1, abs=0.002)


@pytest.mark.parametrize("ratio", [0.02, 0.083, 0.167, 0.3])
def test_the_mean_of_rounded_samples_errs_by_no_more_than_is_reported_and_by_that_somewhere(
    ratio: float,
) -> None:
    at, normal = np.linspace(0.0, 0.5, 401), np.random.default_rng(5).standard_normal((20_000, 1))
    errors = np.abs([np.round(x + ratio * normal).mean() - x for x in at])
    assert errors.max() == pytest.approx(0.1 * mean_error(10.0, ratio), abs=0.02)
    assert mean_error(1.0, 0.0) == 0.5


@pytest.mark.parametrize("seed", range(6))
def test_mirrored_readings_have_the_same_noise(seed: int) -> None:
    """Where the mean lies halfway, which of the two steps is the middle one depends on the sign."""
    rng = np.random.default_rng(seed)
    readings = np.round(rng.uniform(-0.5, 0.5) + 0.2 * rng.normal(size=20_480))
    assert digits(readings) == digits(-readings)
