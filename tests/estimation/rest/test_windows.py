"""Windows and trial against sums and variances taken the long way."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.rest.stage import RestDetector
from imumon.estimation.rest.state import CAPACITY, LEVELS, State, empty_slots
from imumon.estimation.rest.trial import look, second_differences
from imumon.estimation.rest.windows import seen, vibration_factor
from tests.estimation.rest.scenes import block, detect, noise

DRIFT = np.repeat([1e-4, 1.5e-3], 3)
SD = np.repeat([1e-4, 1e-2], 3)


@pytest.fixture(autouse=True)
def _empty_windows() -> Iterator[None]:
    with np.errstate(invalid="ignore", divide="ignore"):
        yield


def slots(means: FloatArray, samples: int = 12) -> Any:
    """Return slots of samples of these means, (n, 6), an eighth of a second each."""
    made: Any = empty_slots(len(means))
    made["start_s"], made["end_s"] = 0.125 * np.arange(len(means)), 0.125 * np.arange(1, len(means) + 1)
    made["samples"], made["within"], made["reference"] = samples, samples * SD**2, np.nan
    for name in ("average", "smallest", "largest", "first", "last"):
        made[name] = means
    return made


def resting() -> State:
    """Return the state of a unit whose noise is known and white."""
    state = State(at_rest=True)
    windows = state.windows
    windows.known[:], windows.step[:] = True, 0.0
    windows.sample_variance[:] = 12 * SD**2
    windows.variance[:] = SD**2 / 2.0 ** np.arange(LEVELS)[:, np.newaxis]
    windows.low[:], windows.high[:] = -np.inf, np.inf
    return state


def test_the_means_of_any_window_are_those_of_its_samples_though_the_history_is_short() -> None:
    rng = np.random.default_rng(0)
    means, state = rng.normal(size=(2 * CAPACITY, 6)), State()
    counts = rng.integers(0, 4, (2 * CAPACITY, 6)).astype(np.float64)
    taken = slots(means)
    taken["samples"] = counts
    for k in range(len(taken)):
        seen(state, taken, k, k + 1, DRIFT)
    n = state.length
    for length in (1, 7, 128):
        got = state.means(np.array([n - length, n - 2 * length]))[0]
        part = slice(len(means) - 2 * length, len(means) - length)
        total = counts[part].sum(0)
        expected = (means[part] * counts[part]).sum(0) / np.where(total > 0, total, np.nan)
        np.testing.assert_allclose(got, expected, atol=1e-12)


def test_variances_of_windows_of_all_lengths_are_learnt_from_white_noise() -> None:
    state, rng = resting(), np.random.default_rng(1)
    state.windows.variance[:] *= 3.0
    state.windows.gain[:] = 0.2
    taken = slots(SD * rng.standard_normal((20_000, 6)))
    for k in range(len(taken)):
        seen(state, taken, k, k + 1, DRIFT)
    ratio = (state.windows.variance / SD**2).mean(1) * 2.0 ** np.arange(LEVELS)
    assert ratio[:5] == pytest.approx(1.0, abs=0.35)


def test_a_step_shows_in_the_windows_that_are_long_enough_and_in_no_others() -> None:
    # A step of three standard deviations of a slot is one of 3 sqrt(2^j / 2) in windows of 2^j slots: over
    # sqrt(42) from 16 slots on.
    state = resting()
    means = np.zeros((64, 6))
    means[48:, 0] = 3.0 * SD[0]
    found = []
    taken = slots(means)
    for k in range(len(taken)):
        found.append(seen(state, taken, k, k + 1, np.zeros(6))[1])
        state.windows.low[:], state.windows.high[:] = -np.inf, np.inf
        state.windows.variance[:] = SD**2 / 2.0 ** np.arange(LEVELS)[:, np.newaxis]
    first = next(k for k, motion in enumerate(found) if motion)
    motion = found[first]
    assert motion is not None
    assert motion.level == 4
    assert first == 63
    assert motion.seconds == 2.0


def test_second_differences_are_those_of_means_of_all_windows() -> None:
    means = np.random.default_rng(2).normal(size=(32, 6))
    for width in (1, 4, 8):
        got = second_differences(means, width)
        expected = [
            means[k : k + width].mean(0)
            - 2 * means[k + width : k + 2 * width].mean(0)
            + means[k + 2 * width : k + 3 * width].mean(0)
            for k in range(32 - 3 * width + 1)
        ]
        np.testing.assert_allclose(got, expected, atol=1e-14)


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_a_trial_finds_the_noise_and_lets_a_permitted_drift_pass(slope: float) -> None:
    rng, of_1, of_8 = np.random.default_rng(3), [], []
    for _ in range(100):
        state = State()
        state.windows.step[:] = 0.0
        taken = slots(SD * rng.standard_normal((32, 6)) + slope * np.outer(np.arange(32) / 8, DRIFT))
        for k in range(len(taken)):
            seen(state, taken, k, k + 1, DRIFT)
        noise = look(state, DRIFT)
        if noise is not None:
            of_1.append(noise.of_1 / SD**2)
            of_8.append(8 * noise.of_8 / SD**2)
    assert np.mean(of_1) == pytest.approx(1.0, abs=0.03)
    assert np.mean(of_8) == pytest.approx(1.0, abs=0.1)
    assert len(of_1) > 90


def test_the_variance_of_resting_samples_is_below_the_limit_of_vibration() -> None:
    rng = np.random.default_rng(4)
    for count in (3, 12, 125):
        variances = rng.standard_normal((20_000, count)).var(1, ddof=1)
        assert variances.max() < vibration_factor(float(count))


def test_false_alarms_are_rare_whatever_the_rate() -> None:
    for seed, rate_hz in enumerate((4.0, 10.0, 25.0)):
        t, gyro, accel = noise(1200.0, rate_hz, seed=seed)
        rest = detect(block(t, gyro, accel))
        assert np.all(rest[np.argmax(rest) :] == 1)


@pytest.mark.parametrize("step", [1e-3, math.radians(1.0)])
@pytest.mark.parametrize(("sd_steps", "hidden_steps"), [(0.0, 0.5), (0.15, 0.5), (0.5, 0.01)])
def test_what_the_steps_of_a_gyro_hide_is_the_hypothesis(
    sd_steps: float, hidden_steps: float, step: float
) -> None:
    """A mean errs by half a step at most, and less as the noise lets the readings reach the next (Widrow)."""
    t, gyro, accel = noise(120.0, 100.0, sd_steps * step)
    gyro = np.round(gyro / step) * step
    gyro[0] += step  # else nobody knows the step
    said = RestDetector().process(block(t, gyro, accel))["turn_hypothesis_x"]
    assert np.abs(said[6000:]).max() <= (hidden_steps + 0.02) * step
    if hidden_steps == 0.5:
        assert np.abs(said[6000:]).min() > 0.25 * step


@pytest.mark.parametrize("sd_steps", [0.1, 0.26])
def test_readings_that_change_now_and_then_between_coarse_steps_are_rest(sd_steps: float) -> None:
    """Between two codes readings toggle, in the middle of one a change is rare: both are the same noise."""
    t, _, _ = noise(900.0, 25.0)
    steps = sd_steps * np.random.default_rng(5).standard_normal((len(t), 6))
    steps += 0.7 * np.sin(2.0 * np.pi * t / 600.0)[:, np.newaxis] * [1.0, -1.0, 0.8, 0.0, 0.0, 0.0]
    steps += np.array([0.2, 0.0, 0.3, 0.0, 0.02, 0.05])
    readings = np.round(steps) * np.repeat([1e-3, 0.038], 3)
    readings[:, 5] -= 258 * 0.038
    rest = detect(block(t, readings[:, :3], readings[:, 3:]))
    assert rest[t > 10.0].all()
