"""Units of which a gyro is absent, silent or late."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import EARTH_RATE
from tests.estimation.rest.scenes import DEG, block, noise

TURN_S = 150.0
BIAS = (2.0 * DEG, -0.3 * DEG, 0.1 * DEG)


def turned(rate_dps: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return t, gyro and accel of a level unit that turns about the vertical for 20 s."""
    t, gyro, accel = noise(200.0, 25.0)
    gyro[:, 2] += rate_dps * DEG * np.clip(np.minimum(t - TURN_S, TURN_S + 20.0 - t) / 0.5, 0.0, 1.0)
    return t, gyro, accel


def without(samples: SampleBlock, axes: str, rows: slice) -> SampleBlock:
    """Return samples without readings of gyros in some rows."""
    for axis in axes:
        samples[f"gyro_{axis}"][rows] = np.nan
    return samples


@pytest.mark.parametrize("axes", ["x", "xy"])
@pytest.mark.parametrize("rate_dps", [0.5, 30.0, 300.0])
def test_gyros_that_a_unit_lacks_leave_rest_and_bias_to_the_others(axes: str, rate_dps: float) -> None:
    t, gyro, accel = turned(rate_dps)
    result = RestAndBias().process(without(block(t, gyro, accel), axes, slice(None)))
    rest, turning = result["at_rest"] == 1, (t > TURN_S + 1.0) & (t < TURN_S + 19.0)
    assert not rest[turning].any()
    assert rest[(t > 20.0) & (t < TURN_S)].all()
    assert rest[t > TURN_S + 25.0].all()
    for axis in axes:
        for name in ("gyro_bias", "gyro_bias_sd", "gyro_corrected", "zupt_innovation", "turn_hypothesis"):
            assert np.isnan(result[f"{name}_{axis}"][16:]).all()
    error = np.abs(result["gyro_bias_z"] - BIAS[2])[t > 20.0]
    assert (error < 4.0 * result["gyro_bias_sd_z"][t > 20.0]).all()
    assert error[-1] < 0.01 * DEG


def test_gyros_as_loud_as_white_noise_find_their_rest_beside_one_that_the_unit_lacks() -> None:
    t, gyro, accel = turned(0.0)
    gyro += 0.3 * DEG * 5.0 * np.random.default_rng(1).standard_normal(gyro.shape)
    at_rest = RestAndBias().process(without(block(t, gyro, accel), "z", slice(None)))["at_rest"]
    assert (at_rest[t > 20.0] == 1).all()


def test_a_turn_about_the_gyro_that_a_unit_lacks_widens_the_others_by_the_earth_rate() -> None:
    t, gyro, accel = turned(5.0)
    samples = without(block(t, gyro, accel), "z", slice(None))
    result = RestAndBias(latitude_deg=45.0, heading_deg=0.0).process(samples)
    late = t > TURN_S + 25.0
    for axis in "xy":
        assert (result[f"gyro_bias_sd_{axis}"][late] > 0.5 * EARTH_RATE * np.cos(np.pi / 4.0)).all()


def test_a_stray_reading_makes_no_gyro() -> None:
    t, gyro, accel = noise(100.0, 25.0)
    samples = without(block(t, gyro, accel), "x", slice(None))
    samples["gyro_x"][300] = 0.01
    result = RestAndBias().process(samples)
    assert result["at_rest"][t > 20.0].all()
    assert np.isfinite(result["gyro_bias_z"][t > 20.0]).all()


@pytest.mark.parametrize("axes", ["x", "xyz"])
def test_a_turn_while_a_gyro_is_silent_is_no_rest(axes: str) -> None:
    t, gyro, accel = turned(30.0)
    silent = slice(np.searchsorted(t, 100.0), np.searchsorted(t, 180.0))
    result = RestAndBias().process(without(block(t, gyro, accel), axes, silent))
    assert not result["at_rest"][(t > 105.0) & (t < 180.0)].any()
    assert result["at_rest"][t > 190.0].all()


def test_a_gyro_that_comes_late_has_a_bias_like_the_others_however_the_samples_come() -> None:
    t, gyro, accel = noise(100.0, 25.0)
    samples = without(block(t, gyro, accel), "y", slice(0, 1000))
    result = RestAndBias().process(samples)
    assert np.isnan(result["gyro_bias_y"][:1000]).all()
    for k, axis in enumerate("xyz"):
        error = np.abs(result[f"gyro_bias_{axis}"] - BIAS[k])[t > 60.0]
        assert (error < 4.0 * result[f"gyro_bias_sd_{axis}"][t > 60.0]).all()
    stage = RestAndBias()
    cuts: IntArray = np.r_[0, np.arange(7, 2500, 63), 2500]
    parts = [stage.process(samples.rows(a, b)) for a, b in pairwise(cuts)]
    for name, values in result.items():
        np.testing.assert_array_equal(np.concatenate([part[name] for part in parts]), values)


def coarse(t: FloatArray, rate_dps: float) -> FloatArray:
    """Return gyros with steps of 2000 °/s / 2^15, whose readings are all zero but for a turn about z."""
    step, gyro = 2000.0 * DEG / 2**15, np.zeros((len(t), 3))
    gyro[(t > 60.0) & (t < 64.0), 2] = rate_dps * DEG
    return np.round(gyro / step) * step


def test_gyros_that_read_zero_in_a_turn_about_another_axis_are_not_missing() -> None:
    t, _, accel = noise(120.0, 50.0)
    stage = RestAndBias(latitude_deg=45.0, heading_deg=0.0)
    result = stage.process(block(t, coarse(t, 20.0), accel))
    before, after = result["gyro_bias_sd_x"][[2900, -1]]
    assert result["at_rest"][2900]
    assert result["at_rest"][-1]
    assert np.sqrt(after**2 - before**2) < 0.1 * EARTH_RATE * np.cos(np.pi / 4.0)


def test_gyros_that_read_zero_before_they_fell_silent_are_missing() -> None:
    t, _, accel = noise(120.0, 50.0)
    stage = RestAndBias()
    result = stage.process(without(block(t, coarse(t, 0.0), accel), "xyz", slice(3000, None)))
    assert result["at_rest"][2900]
    assert not result["at_rest"][t > 65.0].any()
    assert stage.unrest == "a gyro is silent"
