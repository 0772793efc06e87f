"""A turn that ends soon after a start or a restart: nothing shows at first that it is not the bias."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from tests.estimation.rest.scenes import DEG, block, noise, rolled

BIAS = np.array([2.0, -0.3, 0.1]) * DEG
RESTART_S = 10.0


def begun(rate_dps: float, axis: int, seconds: float, restart: bool, seed: int) -> SampleBlock:
    """Return 20 s, at the middle or at the begin of which the unit turns for some seconds about x or z."""
    t, gyro, accel = noise(20.0, seed=seed)
    begin = RESTART_S * restart
    rate = np.where((t >= begin) & (t < begin + seconds), rate_dps * DEG, 0.0)
    gyro[:, axis] += rate
    force = rolled(accel, np.cumsum(rate) / 100.0) if axis == 0 else accel
    again = restart & (t >= RESTART_S)
    return block(t - RESTART_S * again, gyro, force).with_columns({"segment": again.astype(np.int64)})


def normalised(samples: SampleBlock) -> tuple[FloatArray, FloatArray]:
    """Return errors of the bias over sigma, and sigma, (n, 3) each."""
    result = RestAndBias().process(samples)
    bias, sd = (np.column_stack([result[f"{of}_{a}"] for a in "xyz"]) for of in ("gyro_bias", "gyro_bias_sd"))
    return np.abs(bias - BIAS) / sd, sd


@pytest.mark.parametrize("axis", [0, 2])
@pytest.mark.parametrize("rate_dps", [0.05, 0.3])
@pytest.mark.parametrize(("seconds", "restart"), [(1.5, True), (1.0, False)])
def test_a_turn_that_ends_soon_after_the_begin_is_in_the_sigma(
    rate_dps: float, axis: int, seconds: float, restart: bool
) -> None:
    for seed in range(2):
        z, _ = normalised(begun(rate_dps, axis, seconds, restart, seed))
        assert np.nanmax(z) < 6.0


def test_a_slow_tilt_from_the_begin_is_in_the_sigma_until_it_shows() -> None:
    for seed in range(2):
        z, _ = normalised(begun(0.05, 0, 4.0, False, seed))
        assert np.nanmax(z) < 6.0


@pytest.mark.parametrize("silent_s", [0.3, 0.6])
def test_a_first_turn_that_silent_accelerometers_do_not_show_is_in_the_sigma(silent_s: float) -> None:
    samples = begun(0.1, 0, 4.0, False, 0)
    t = samples["device_time_ns"] * 1e-9
    for axis in "xyz":
        samples[f"accel_{axis}"][(t >= silent_s) & (t < silent_s + 3.8)] = np.nan
    z, _ = normalised(samples)
    assert np.nanmax(z) < 6.0


def test_a_unit_that_rests_is_as_certain_as_before_within_some_seconds() -> None:
    _, sd = normalised(begun(0.0, 2, 0.0, False, 0))
    assert (sd[450] < 0.03 * DEG).all()
    assert (sd[1000] < 30.0 / 3600.0 * DEG).all()
