"""A steady turn about the vertical and a bias that has changed look alike: what tells them apart."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias, RestDetector
from imumon.estimation.rest.parameters import RestParameters
from tests.estimation.rest.scenes import DEG, GRAVITY, block, detect, flicker, noise, rolled

BEGIN_S = 150.0
FIELD = np.array([20.0, 5.0, 40.0])
SMALL = (0.1 * DEG, -0.05 * DEG, 0.03 * DEG)
"""A bias against which no turn of half a degree per second looks like the smaller mean."""
FLICKER = 52.0 / 3600.0 * DEG
"""Of each process: together 40 °/h, as an MPU-6050 has it."""


def turn(
    rate_dps: float,
    minutes: float,
    ramp_s: float,
    gyro_sd: float = 5e-4,
    bias: tuple[float, float, float] = (2.0 * DEG, -0.3 * DEG, 0.1 * DEG),
) -> tuple[SampleBlock, FloatArray]:
    """Return 150 s of rest, a turn that begins and ends evenly in ramp_s, and 90 s of rest; and its rate."""
    seconds = 60.0 * minutes + ramp_s
    t, gyro, accel = noise(BEGIN_S + seconds + 90.0, 25.0, gyro_sd, bias=bias)
    since = t - BEGIN_S
    rate = rate_dps * DEG * np.clip(np.minimum(since, seconds - since) / ramp_s, 0.0, 1.0)
    gyro[:, 2] += rate
    return block(t, gyro, accel), rate


def with_field(samples: SampleBlock, rate: FloatArray) -> SampleBlock:
    """Add a magnetometer that turns at this rate about z."""
    angle = -np.cumsum(rate) / 25.0
    x = np.cos(angle) * FIELD[0] - np.sin(angle) * FIELD[1]
    y = np.sin(angle) * FIELD[0] + np.cos(angle) * FIELD[1]
    field = np.column_stack([x, y, np.full(len(x), FIELD[2])])
    field += 0.3 * np.random.default_rng(9).standard_normal(field.shape)
    return samples.with_columns({f"mag_{axis}": field[:, i] for i, axis in enumerate("xyz")})


def found(
    samples: SampleBlock, parameters: RestParameters | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time, at_rest and the hypothesis of a turn about z."""
    result = RestDetector(parameters).process(samples)
    return samples["device_time_ns"] * 1e-9, result["at_rest"], result["turn_hypothesis_z"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate_dps", "minutes", "ramp_s"),
    [(0.5, 6, 0.5), (-0.5, 12, 10.0), (30.0, 6, 20.0), (0.5, 15, 120.0)],
)
def test_a_steady_turn_is_no_rest_and_the_rest_after_it_is_found(
    rate_dps: float, minutes: float, ramp_s: float
) -> None:
    samples, rate = turn(rate_dps, minutes, ramp_s, bias=SMALL)
    t, rest, hypothesis = found(samples)
    moving = rate != 0.0
    assert rest[moving].mean() <= 0.03
    stop = t[np.flatnonzero(moving)[-1]]
    assert np.all(rest[t > stop + 20.0] == 1)
    full = (np.abs(rate) >= abs(rate_dps) * DEG * 0.999) & (t > BEGIN_S + ramp_s + 40.0)
    assert np.abs(hypothesis[full]).max() < 0.6 * abs(rate_dps) * DEG  # the root of one half, at the most
    before, after = t < BEGIN_S, t > stop + 20.0
    assert np.abs(hypothesis[(before | after) & (rest == 1)]).max() < 0.03 * abs(rate_dps) * DEG


def test_a_slow_drift_of_all_axes_is_rest_and_of_the_vertical_alone_is_undecided_at_the_same_rate() -> None:
    t, gyro, accel = noise(300.0, 25.0, 2e-4)
    slope = 2e-5 * np.clip(t - BEGIN_S, 0.0, 100.0)
    vertical = gyro.copy()
    vertical[:, 2] += slope
    gyro += slope[:, np.newaxis]
    assert found(block(t, gyro, accel))[1][200:].mean() > 0.98
    assert not found(block(t, vertical, accel))[1][(t > 200.0) & (t < 240.0)].any()


@pytest.mark.parametrize("jump", [0.8, 3.0, 30.0])
def test_a_jump_that_is_not_about_the_vertical_is_bias_for_gravity_would_have_turned(jump: float) -> None:
    t, gyro, accel = noise(100.0, 25.0)
    gyro[t > 40.0, 1] += jump * DEG
    rest = found(block(t, gyro, accel))[1]
    assert not rest[(t > 40.1) & (t < 41.0)].any()
    assert rest[t > 44.0].all()


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
def test_a_turn_about_a_level_axis_is_no_rest_for_gravity_turns_as_the_gyros_say(seed: int) -> None:
    """0.5 °/s for 10 min: the means of two seconds are alike to their noise, as those of a rest are."""
    t, gyro, accel = noise(BEGIN_S + 690.0, 25.0, 0.025 * DEG, 0.02, seed=seed)
    since = t - BEGIN_S
    rate = 0.5 * DEG * np.clip(np.minimum(since, 600.0 - since) / 60.0, 0.0, 1.0)
    gyro += flicker(gyro, 25.0, FLICKER, seed)
    gyro[:, 0] += rate
    rest = found(block(t, gyro, rolled(accel, np.cumsum(rate) / 25.0)))[1]
    assert rest[rate != 0.0].mean() < 0.06
    assert not rest[(t > BEGIN_S + 30.0) & (t < BEGIN_S + 560.0)].any()
    assert rest[t > BEGIN_S + 620.0].all()


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 3])
def test_a_turn_about_a_level_axis_that_slows_down_is_no_rest_in_another_pose(seed: int) -> None:
    """The sensitivity to gravity makes the prediction so wide that 200 °/h fit; gravity turns with them."""
    t, gyro, accel = noise(BEGIN_S + 400.0, 25.0, 4.4e-6, 2.5e-3, seed=seed)
    rate = 0.5 * DEG * np.clip(np.minimum(t - BEGIN_S, BEGIN_S + 390.0 - t) / 120.0, 0.0, 1.0)
    gyro[:, 1] += rate
    angle = np.cumsum(rate) / 25.0
    accel[:, 0] += GRAVITY * np.sin(angle)
    accel[:, 2] += GRAVITY * (1.0 - np.cos(angle))
    _, rest, _ = found(block(t, gyro, accel))
    slowing = (t > BEGIN_S + 300.0) & (rate > 20.0 / 3600.0 * DEG)
    assert rest[slowing].mean() < 0.07


@pytest.mark.parametrize("seed", range(2))
def test_a_turn_that_may_be_wander_is_rest_and_the_hypothesis_until_it_is_over(seed: int) -> None:
    """A gyro with 30 °/h of flicker, turned by 0.1 °/s: five of the deviations that it wanders by."""
    ramp_s = 10.0
    t, gyro, accel = noise(900.0, 25.0, 0.03 * DEG)
    gyro += flicker(gyro, 25.0, 38.0 / 3600.0 * DEG, seed)
    gyro[:, 2] += 0.1 * DEG * np.clip(np.minimum(t - BEGIN_S, 750.0 - t) / ramp_s, 0.0, 1.0)
    _, rest, hypothesis = found(block(t, gyro, accel))
    full = (t > BEGIN_S + ramp_s + 20.0) & (t < 740.0 - ramp_s)
    assert ((rest == 0) | (hypothesis > 0.02 * DEG))[full].mean() > 0.9
    assert rest[t > 790.0].mean() > 0.9


@pytest.mark.parametrize("seed", range(2))
def test_level_axes_that_wander_do_not_make_a_turn_a_bias(seed: int) -> None:
    """0.2 °/s for 10 min, seven sigmas of the wander: whatever is said of rest, the hypothesis covers it."""
    t, gyro, accel = noise(750.0, 25.0, 0.025 * DEG)
    gyro += flicker(gyro, 25.0, FLICKER, seed)
    gyro[:, 2] += 0.2 * DEG * np.clip(np.minimum(t - BEGIN_S, 750.0 - t) / 0.5, 0.0, 1.0)
    _, rest, hypothesis = found(block(t, gyro, accel))
    turning = (t > BEGIN_S + 30.0) & (t < 745.0)
    assert ((rest == 0) | (hypothesis > 0.02 * DEG))[turning].mean() > 0.96


def test_a_noisy_gyro_does_not_take_a_turn_for_the_old_mean_because_it_cannot_tell_yet() -> None:
    """Means of a quarter of a second have 0.06 °/s: both the old mean and that of the turn fit."""
    t, still, accel = noise(220.0, 25.0, 0.15 * DEG)
    for seed in (2, 5, 8, 11):
        gyro = 0.15 * DEG * np.random.default_rng(seed).standard_normal(still.shape)
        gyro[t > BEGIN_S, 2] += 0.2 * DEG
        _, rest, hypothesis = found(block(t, gyro, accel))
        assert ((rest == 0) | (hypothesis > 0.06 * DEG))[t > BEGIN_S + 10.0].all()


@pytest.mark.parametrize("warms", [True, False])
def test_the_vertical_alone_creeps_with_temperature_and_turns_without(warms: bool) -> None:
    t, gyro, accel = noise(400.0, 25.0, 2e-4)
    since = np.clip(t - BEGIN_S, 0.0, 100.0)
    gyro[:, 2] += 2e-5 * since  # 0.11 °/s in 100 s
    temperature = 25.0 + (5.0 * since / 100.0 if warms else 0.0 * t)
    _, rest, _ = found(block(t, gyro, accel).with_columns({"temperature": temperature}))
    assert rest[200:].all() == warms
    assert rest[(t > 200.0) & (t < 250.0)].any() == warms


def test_a_jump_about_the_vertical_stays_undecided_and_reports_it() -> None:
    t, gyro, accel = noise(400.0, 25.0)
    gyro[t > 40.0, 2] += 0.8 * DEG
    _, rest, hypothesis = found(block(t, gyro, accel))
    assert not rest[t > 40.1].any()
    assert np.abs(hypothesis[t > 45.0]).min() > 0.2 * DEG


@pytest.mark.parametrize("every", [1, 12, 50])
@pytest.mark.parametrize("turns", [True, False])
def test_a_magnetometer_decides_however_slow_it_is(turns: bool, every: int) -> None:
    samples, rate = turn(0.8, 3.0, 1.0)
    samples = with_field(samples, rate if turns else np.zeros_like(rate))
    for axis in "xyz":
        samples[f"mag_{axis}"][np.arange(len(samples)) % every > 0] = np.nan
    t, rest, hypothesis = found(samples)
    during = (t > BEGIN_S + 60.0) & (t < BEGIN_S + 180.0)
    assert np.all(rest[during] == (0 if turns else 1))
    widened = np.abs(hypothesis[during]).max() / (0.8 * DEG)
    # One that is stuck shows no turn either: then the sigma holds the turn, and not much more.
    assert widened < 0.04 if turns else 0.4 < widened < 0.6
    assert np.all(rest[t > BEGIN_S + 220.0] == 1) or not turns


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_so_does_the_yaw_of_the_device_whatever_its_sense(sense: float) -> None:
    samples, rate = turn(0.8, 3.0, 1.0)
    yaw = sense * np.cumsum(rate) / 25.0
    t, rest, hypothesis = found(samples.with_columns({"yaw": (yaw + np.pi) % (2 * np.pi) - np.pi}))
    during = (t > BEGIN_S + 60.0) & (t < BEGIN_S + 180.0)
    assert not rest[during].any()
    assert np.abs(hypothesis[during]).max() < 0.01 * DEG


def test_a_yaw_that_stays_is_of_a_unit_that_stands() -> None:
    samples, _ = turn(0.8, 3.0, 1.0)
    t, still, _ = found(samples.with_columns({"yaw": np.full(len(samples), 3.1)}))
    assert still[(t > BEGIN_S + 60.0) & (t < BEGIN_S + 180.0)].all()


@pytest.mark.parametrize("rate_dps", [0.6, -8.0, 30.0])
def test_with_a_magnetometer_a_recording_that_begins_in_a_turn_is_not_at_rest(rate_dps: float) -> None:
    t, gyro, accel = noise(200.0, 25.0)
    rate = np.where(t < 100.0, rate_dps * DEG, 0.0)
    gyro[:, 2] += rate
    _, rest, hypothesis = found(with_field(block(t, gyro, accel), rate))
    turning = (t > 15.0) & (t < 100.0)
    assert not rest[turning].any()
    assert np.abs(hypothesis[turning]).min() > 0.8 * abs(rate_dps) * DEG  # the whole of it may be in the bias
    assert rest[t > 110.0].all()
    assert np.abs(hypothesis[t > 110.0]).max() < 0.02 * DEG


@pytest.mark.parametrize("rate_dps", [0.01, 0.02])
def test_a_first_slow_turn_that_is_taken_for_rest_is_in_the_sigma(rate_dps: float) -> None:
    samples, _ = turn(rate_dps, 5, 0.5, gyro_sd=5e-6)
    result = RestAndBias().process(samples)
    turning = samples["device_time_ns"] * 1e-9 > BEGIN_S + 1.0
    off = np.abs(result["gyro_bias_z"] - 0.1 * DEG) / result["gyro_bias_sd_z"]
    assert off[turning].max() < 7.0


@pytest.mark.parametrize("degrees", [1.0, 8.0])
def test_who_swings_has_no_bias_that_jumps_twice_a_period(degrees: float) -> None:
    t, gyro, accel = noise(400.0, 25.0, 2e-4)
    largest = degrees * DEG * 2.0 * np.pi / 20.0
    gyro[:, 2] += np.where(t > 100.0, largest * np.cos(2.0 * np.pi * t / 20.0), 0.0)
    _, rest, hypothesis = found(block(t, gyro, accel))
    assert rest[t > 100.0].mean() < 0.04
    late = np.abs(hypothesis[t > 250.0])
    assert np.sqrt((late**2).mean()) < 0.5 * largest  # one in as many as there were


def test_a_slow_tilt_to_and_fro_is_hardly_ever_rest() -> None:
    t, gyro, accel = noise(400.0, 50.0)
    angle = DEG * np.sin(2 * np.pi * np.maximum(t - 100.0, 0.0) / 60.0)
    gyro[:, 0] += np.gradient(angle, t)
    accel[:, 1] -= GRAVITY * np.sin(angle)
    rest = found(block(t, gyro, accel))[1]
    assert rest[(t > 5.0) & (t < 100.0)].all()
    assert rest[t > 100.0].mean() < 0.25


def test_road_vibration_is_no_rest_and_an_idling_engine_is() -> None:
    t, gyro, accel = noise(60.0, 100.0)
    rng = np.random.default_rng(3)
    road = accel + 0.4 * rng.standard_normal(accel.shape)
    shaken = gyro + 0.5 * DEG * rng.standard_normal(gyro.shape)
    assert not found(block(t, shaken, road))[1].any()
    idle = accel + 0.2 * np.sin(2 * np.pi * 25.3 * t)[:, np.newaxis]
    assert found(block(t, gyro + 0.2 * DEG * np.sin(2 * np.pi * 25.3 * t)[:, np.newaxis], idle))[1][
        500:
    ].all()


@pytest.mark.parametrize("tau_s", [0.1, 10.0])
def test_a_turntable_that_ran_at_first_is_at_rest_when_it_has_stopped(tau_s: float) -> None:
    """No gyro with 2 °/s on one axis has 12 °/s on another: it is the first mean that was no bias."""
    t, gyro, accel = noise(300.0, 25.0)
    coasting = 12.0 * DEG * np.exp(-np.maximum(t - 60.0, 0.0) / tau_s)
    gyro[:, 2] += coasting
    _, rest, hypothesis = found(block(t, gyro, accel))
    stop_s = 60.0 + tau_s * np.log(12.0 / 0.01)
    assert not rest[(t > 62.0) & (coasting > 0.2 * DEG)].any()
    assert rest[t > stop_s + 25.0].all()
    assert np.abs(hypothesis[t > 290.0]).max() > 0.05 * DEG  # that it may be the other way round stays said


@pytest.mark.parametrize("tau_s", [2.2, 9.0])
def test_a_turntable_that_coasts_down_is_no_rest_while_a_good_gyro_sees_it(tau_s: float) -> None:
    """180 °/h are no more than a bias may change from rest to rest, but a rate that falls is none."""
    t, gyro, accel = noise(330.0, 25.0, 1.5e-5, 1e-3)
    rate = 1.2 * DEG * np.clip((t - 60.0) / 50.0, 0.0, 1.0)
    rate *= np.exp(-np.maximum(t - 170.0, 0.0) / tau_s)
    gyro[:, 2] += rate
    _, rest, _ = found(block(t, gyro, accel))
    assert not rest[(t > 80.0) & (rate > 10.0 / 3600.0 * DEG)].any()
    assert rest[t > 170.0 + tau_s * np.log(1.2 * 3600.0) + 25.0].all()


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_turn_that_makes_the_bias_look_smaller_is_a_turn_still(sense: float) -> None:
    t, gyro, accel = noise(400.0, 25.0, bias=(0.3 * DEG, -0.8 * DEG, 0.9 * DEG))
    gyro[t > BEGIN_S, 2] += 0.7 * sense * DEG
    assert not found(block(t, gyro, accel))[1][t > BEGIN_S + 0.5].any()


def test_a_quiet_gyro_whose_bias_moves_by_less_than_any_turn_is_at_rest() -> None:
    """2 °/h about the vertical, fifty times the noise of a mean over 16 s."""
    t, gyro, accel = noise(300.0, gyro_sd=2e-6, accel_sd=1e-4)
    gyro[t > 120.0, 2] += np.radians(2.0 / 3600.0)
    at_rest = detect(block(t, gyro, accel))
    assert at_rest[t > 130.0].mean() > 0.98


def test_patience_is_with_a_steady_rate_and_not_with_one_that_changes() -> None:
    """A turntable goes through rates of half a minute each for longer than `undecided_s`."""
    t, gyro, accel = noise(300.0)
    after = t > 60.0
    gyro[after, 2] += np.radians(0.3 + 0.1 * ((t[after] // 30.0) % 4))
    at_rest = detect(block(t, gyro, accel), RestParameters(undecided_s=60.0))
    assert at_rest[t > 70.0].mean() < 0.05


def test_a_yaw_that_the_device_integrates_with_its_bias_is_a_turn_that_sigma_contains() -> None:
    t, gyro, accel = noise(200.0, 25.0)
    gyro[:, 2] += 0.5 * DEG
    yaw = np.cumsum(gyro[:, 2]) / 25.0
    samples = block(t, gyro, accel).with_columns({"yaw": (yaw + np.pi) % (2 * np.pi) - np.pi})
    _, rest, hypothesis = found(samples)
    assert not rest[t > 60.0].any()
    assert np.abs(hypothesis[t > 60.0]).min() > 0.4 * DEG


def test_samples_that_are_lost_do_not_make_an_undecided_rate_last_longer() -> None:
    t, gyro, accel = noise(200.0)
    gyro[t > 40.0, 2] += 0.8 * DEG
    kept = (t < 20.0) | (np.random.default_rng(1).random(len(t)) < 0.4)
    t, rest, _ = found(block(t[kept], gyro[kept], accel[kept]), RestParameters(undecided_s=60.0))
    assert not rest[(t > 41.0) & (t < 95.0)].any()
    assert rest[t > 110.0].all()


@pytest.mark.parametrize("rate_dps", [0.5, 2.0])
def test_accelerometers_that_are_silent_exclude_no_turn(rate_dps: float) -> None:
    t, gyro, accel = noise(70.0)
    silent = (t >= 60.0) & (t < 63.9)
    turning = rate_dps * DEG * silent
    gyro[:, 0] += turning
    force = rolled(accel, np.cumsum(turning) / 100.0)
    force[silent] = np.nan
    result = RestAndBias().process(block(t, gyro, force))
    assert not result["at_rest"][(t > 61.0) & silent].any()
    assert (np.abs(result["gyro_bias_x"] - 2.0 * DEG) / result["gyro_bias_sd_x"])[t > 60.0].max() < 4.0


@pytest.mark.parametrize("stall_s", [0.0, 20.0])
def test_samples_that_come_in_a_burst_do_not_shorten_the_time_of_later_ones(stall_s: float) -> None:
    """A buffer that is emptied at once, at the start or after a stall, with times of arrival."""
    t, gyro, accel = noise(200.0)
    gyro[t > 40.0, 1] += 0.05 * DEG
    late = (t >= stall_s) & (t < stall_s + 0.7)
    t[late] = stall_s + 0.7 - 1e-4 * np.arange(late.sum(), 0, -1)
    t, rest, _ = found(block(t, gyro, accel))
    result = RestAndBias().process(block(t, gyro, accel))
    assert rest[t > 45.0].all()
    assert np.abs(result["turn_hypothesis_y"][t > 70.0]).max() < 1e-3 * DEG
    assert result["gyro_bias_sd_y"][-1] < 8.0 / 3600.0 * DEG
