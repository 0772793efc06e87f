"""A known place: what the earth rate adds to the sigma where pose or north are lost."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest import odds
from imumon.estimation.rest.slots import Measurement
from imumon.geodesy import EARTH_RATE
from tests.estimation.gyro_bias.records import GIVEN, LATITUDE_DEG, vector
from tests.estimation.gyro_bias.test_poses import in_the_hand


@pytest.mark.parametrize("seed", range(3))
def test_a_turn_without_accelerometers_leaves_the_earth_rate_in_the_sigma(seed: int) -> None:
    block, bias, _, rest = in_the_hand(0.0, seed, rests=3)
    turned = np.flatnonzero(np.diff(rest) < 0)[0]
    silent = {
        f"accel_{axis}": np.where(np.arange(len(rest)) < turned, block[f"accel_{axis}"], np.nan)
        for axis in "xyz"
    }
    stage = RestAndBias(GIVEN, latitude_deg=LATITUDE_DEG, heading_deg=0.0)
    result = stage.process(block.with_columns(silent))
    sigma, last = vector(result, "gyro_bias_sd")[-1], slice(-100, None)
    assert (np.abs(vector(result, "gyro_bias")[last] - bias[last]).max(0) < 4.0 * sigma).all()
    assert (sigma > 0.5 * EARTH_RATE).all()


def test_a_pose_that_comes_back_has_its_earth_rate_again() -> None:
    block, bias, _, rest = in_the_hand(0.0, 1, rests=5)
    turns, ends = np.flatnonzero(np.diff(rest) < 0), np.flatnonzero(np.diff(rest) > 0)
    at = np.arange(len(rest))
    silent = {
        f"accel_{axis}": np.where((at > turns[1]) & (at < turns[2]), np.nan, block[f"accel_{axis}"])
        for axis in "xyz"
    }
    restarted = {"segment": np.where(at < ends[3], 0, 1)}
    given = block.with_columns(silent)
    for parts in (given, given.with_columns(restarted)):
        result = RestAndBias(GIVEN, latitude_deg=LATITUDE_DEG, heading_deg=0.0).process(parts)
        z = (vector(result, "gyro_bias") - bias) / vector(result, "gyro_bias_sd")
        known = np.flatnonzero((rest == 1) & np.isfinite(z).all(1))
        assert np.abs(z[known[known > ends[0]]]).max() < 5.0


def test_a_heading_of_which_one_axis_is_missing_decides_nothing() -> None:
    zero = np.zeros(3)
    slots = [
        Measurement(
            float(k),
            1.0,
            1.0,
            np.full(3, 0.01),
            np.array([0.0, 0.0, 9.81]),
            zero,
            zero,
            np.array([0.3, np.nan, 0.5]),
        )
        for k in range(8)
    ]
    assert (odds.heading(slots, np.zeros((1, 3))) == 0.0).all()
