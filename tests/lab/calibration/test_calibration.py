"""From recordings to a model: the truth is found, the sigma is true, and what cannot work is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.geodesy import EARTH_RATE
from imumon.intake import Intake
from imumon.lab.calibration import selection
from imumon.lab.calibration.calibration import Calibration, calibrate
from imumon.lab.calibration.cells import channel_of, find_rest, record_of
from imumon.models.curves.points import folds
from imumon.models.curves.polynomial import fit_polynomial
from imumon.protocols.ranges import Ranges
from tests.lab.calibration.records import DEG_H, GRAVITY, record, samples, soak, true_bias, true_slope

GYROS, ACCELS = ([f"{sensor}_{axis}" for axis in "xyz"] for sensor in ("gyro", "accel"))
INSIDE = np.linspace(-20.5, 48.0, 500)


@pytest.fixture(scope="module")
def soaked() -> Calibration:
    """A calibration of the published soak with half-hour levels."""
    return calibrate([record(soak())], serial="A1")


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the networks out where they are not what is tested: they take nearly all of the time."""
    monkeypatch.setattr(selection, "MOST_NEURONS", 0)


def errors(model_values: FloatArray, truth: FloatArray) -> float:
    return float(np.sqrt(np.mean((model_values - truth) ** 2)) / DEG_H)


@pytest.mark.long
def test_the_true_curves_and_slopes_are_found(soaked: Calibration) -> None:
    for j, name in enumerate(GYROS):
        channel = soaked.model.channels[name]
        assert errors(channel.value(INSIDE), true_bias(INSIDE)[:, j]) < 2.5
        assert errors(channel.slope(INSIDE), true_slope(INSIDE)[:, j]) < 0.9


def test_the_residual_is_that_of_the_truth(soaked: Calibration) -> None:
    for j, name in enumerate(GYROS):
        channel = soaked.model.channels[name]
        actual = errors(channel.value(INSIDE), true_bias(INSIDE)[:, j])
        assert 0.5 * actual < channel.residual_sd / DEG_H < 6.0


def test_points_scatter_about_the_curve_by_the_noise_of_their_samples(soaked: Calibration) -> None:
    for fit in soaked.fits.values():
        points = fit.points
        left = points.value - fit.choice.curve.value(points.temperature)
        assert 0.8 < np.sqrt(np.mean(left**2 / points.white)) < 1.4


def test_every_kind_of_curve_was_tried_and_the_worst_is_not_chosen(soaked: Calibration) -> None:
    for fit in soaked.fits.values():
        rms = fit.choice.held_out_rms
        assert {"polynomial 1", "polynomial 9", "spline", "network 1", "network 2", "network 3"} <= set(rms)
        assert rms[fit.choice.name] <= 1.05 * min(rms.values())
        assert rms["polynomial 1"] > 10 * rms[fit.choice.name]


def test_the_model_states_where_it_comes_from(soaked: Calibration) -> None:
    model = soaked.model
    assert (model.serial, model.earth_rate, model.block_s) == ("A1", "included", 10.0)
    assert len(model.levels_degc) == 15
    np.testing.assert_allclose(model.levels_degc, [*np.arange(-20.53, 46.0, 5.0), 48.08], atol=0.3)
    (run,) = model.trained_on
    assert run.sha256 == "0" * 64
    assert run.rest_s == pytest.approx(len(soak()), rel=0.01)
    channel = model.channels["gyro_x"]
    assert channel.temperature_column == "temperature"
    np.testing.assert_allclose(channel.temperature_range_degc, [-20.53 - 0.34, 48.08 + 0.34], atol=0.05)


def test_a_split_by_sample_shows_no_error_where_levels_left_out_do() -> None:
    """Levels alone, 13 coefficients for 15 of them: between them the curve is wild, and one split sees it."""
    t = np.repeat([*np.arange(-20.53, 46.0, 5.0), 48.08], 1800)
    points = channel_of(find_rest([record(t)], None, None), "gyro_z")
    assert points is not None
    part = np.random.default_rng(0).permutation(len(points)) % 20
    curve = fit_polynomial(points.only(part < 13), 12)
    rms = [
        float(np.sqrt(np.mean((points.value - curve.value(points.temperature))[mine] ** 2))) / DEG_H
        for mine in (part < 13, (part >= 13) & (part < 17), part >= 17)
    ]
    between = errors(curve.value(INSIDE), true_bias(INSIDE)[:, 2])
    assert max(rms) < 2.0 * min(rms) < 5.0
    assert between > 5.0 * max(rms)
    apart = []
    for out in folds(points.level, 5):
        left = fit_polynomial(points.only(~out), 9)
        apart.append(points.value[out] - left.value(points.temperature[out]))
    assert float(np.sqrt(np.mean(np.concatenate(apart) ** 2))) / DEG_H > 5.0 * max(rms)


@pytest.mark.usefixtures("fast")
def test_turn_on_offsets_are_found_and_the_curve_is_their_mean() -> None:
    t = soak(600.0)
    offsets = np.array([0.0, 30.0, -12.0]) * DEG_H
    records = [record(t, f"s{i}", seed=i, offset=offset) for i, offset in enumerate(offsets)]
    found = calibrate(records)
    for j, name in enumerate(GYROS):
        fit = found.fits[name]
        np.testing.assert_allclose(fit.offset / DEG_H, (offsets - offsets.mean()) / DEG_H, atol=1.0)
        assert fit.repeatability is not None
        assert fit.repeatability / DEG_H == pytest.approx(np.std([0, 30, -12], ddof=1), abs=1.0)
        expected = true_bias(INSIDE)[:, j] + offsets.mean()
        assert errors(found.model.channels[name].value(INSIDE), expected) < 2.5
    assert [run.session for run in found.model.trained_on] == ["s0", "s1", "s2"]
    assert found.model.trained_on[1].offset["gyro_x"] == found.fits["gyro_x"].offset[1]


@pytest.mark.usefixtures("fast")
def test_runs_without_a_common_temperature_get_no_offset_and_that_is_reported() -> None:
    t = soak(600.0)
    half = len(t) // 2
    found = calibrate([record(t[:half], "cold"), record(t[half + 500 :], "warm", seed=1)])
    assert np.isnan(found.fits["gyro_x"].offset).any()
    apart = found.model.trained_on[1]
    assert (
        f"gyro_x: runs {apart.run} of {apart.session} have no temperature in common with the others:"
        " taken as they are, without a turn-on offset"
    ) in found.warnings


@pytest.mark.usefixtures("fast")
def test_accelerometers_at_fewer_than_three_common_temperatures_have_no_curve_and_that_is_reported() -> None:
    ripple = 0.2 * np.sin(np.arange(900) / 100.0)
    alone = [
        record(degc + ripple, seed=i, accel=(0.0, 0.0, GRAVITY)) for i, degc in enumerate((0, 10, 20, 30))
    ]
    block = samples(soak(300.0), accel=(0.0, 0.0, GRAVITY))
    elsewhere = np.abs(np.arange(len(block)) - 3100) > 100
    once = block.with_columns({name: np.where(elsewhere, np.nan, block[name]) for name in ACCELS})
    for records in (alone, [record_of([once], "accelerometers at one level", "0" * 64)]):
        found = calibrate(records)
        assert set(found.model.channels) == set(found.fits) == set(GYROS)
        for name in ACCELS:
            assert f"{name}: fewer than 3 temperature levels: no curve" in found.warnings


@pytest.mark.usefixtures("fast")
def test_a_last_run_without_accelerometers_has_no_offset_of_theirs() -> None:
    parts = [samples(soak(300.0), seed, accel=(0.0, 0.0, GRAVITY), segment=seed) for seed in range(3)]
    parts[2] = parts[2].with_columns({f"accel_{axis}": np.full(len(parts[2]), np.nan) for axis in "xyz"})
    found = calibrate([record_of(parts, "three runs", "0" * 64)])
    runs = found.model.trained_on
    assert [set(run.offset) for run in runs] == [{*GYROS, *ACCELS}, {*GYROS, *ACCELS}, set(GYROS)]
    assert np.isnan(found.fits["accel_z"].offset).tolist() == [False, False, True]
    assert not any("in common" in text for text in found.warnings)


@pytest.mark.usefixtures("fast")
def test_sessions_of_different_units_are_reported() -> None:
    one = record(soak(600.0))._replace(serial="SN1")
    other = record(soak(600.0), seed=1)._replace(serial="SN2", sha256="1" * 64)
    assert "the sessions are of different units: SN1, SN2" in calibrate([one, other]).warnings


def test_sessions_in_different_body_axes_are_refused() -> None:
    records = [record(soak(300.0))._replace(axes=axes) for axes in ("FRD", None, "FLU")]
    with pytest.raises(ImumonError, match="different body axes: FLU, FRD") as caught:
        calibrate(records)
    assert caught.value.reason is Reason.BAD_DATA


@pytest.mark.parametrize("axes", ["xyz", "y"])
def test_sessions_with_different_thermometers_are_refused(axes: str) -> None:
    t = soak(300.0)
    block = samples(t)
    own = block.with_columns({f"temperature_{axis}": block["temperature"] for axis in axes})
    message = f"different thermometers: temperature, temperature_{axes[0]}$"
    with pytest.raises(ImumonError, match=f"(?m){message}") as caught:
        calibrate([record(t), record_of([own], "own", "1" * 64)])
    assert caught.value.reason is Reason.BAD_DATA


@pytest.mark.usefixtures("fast")
def test_a_gyros_own_thermometer_may_be_far_off_the_others() -> None:
    block = samples(soak(300.0))
    own = block.with_columns(
        {f"temperature_{a}": block["temperature"] + 80.0 * k for k, a in enumerate("xyz")}
    )
    alone, found = (calibrate([record_of([one], "s", "0" * 64)]) for one in (block, own))
    for name in GYROS:
        np.testing.assert_array_equal(found.fits[name].points.level, alone.fits[name].points.level)
        assert found.fits[name].lag_rms == pytest.approx(alone.fits[name].lag_rms, rel=0.05)


@pytest.mark.usefixtures("fast")
def test_a_restart_within_a_session_is_a_run_of_its_own() -> None:
    t = soak(300.0)
    blocks = [samples(t, 0), samples(t, 1, offset=20.0 * DEG_H, segment=1)]
    found = calibrate([record_of(blocks, "s", "0" * 64)])
    assert [run.run for run in found.model.trained_on] == [0, 1]
    assert np.ptp(found.fits["gyro_y"].offset) / DEG_H == pytest.approx(20.0, abs=1.5)


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize(
    ("accel", "earth"),
    [
        ((0.0, 0.0, -GRAVITY), (0.6408, 0.3700, -0.6728)),  # FRD, level
        ((0.0, 0.0, GRAVITY), (0.6408, -0.3700, 0.6728)),  # FLU, level: y and z the other way
    ],
)
def test_the_earth_rate_is_removed_with_latitude_and_heading(
    accel: tuple[float, float, float], earth: tuple[float, float, float]
) -> None:
    """At 42.28° north, heading -30°: 0.7399 of the rate is north (0.866 of it on x, 0.5 on y), 0.6728 up."""
    t = soak(600.0)
    block = samples(t, accel=accel)
    rate = EARTH_RATE * np.array(earth)
    turned = {f"gyro_{axis}": block[f"gyro_{axis}"] + rate[j] for j, axis in enumerate("xyz")}
    found = calibrate([record_of([block.with_columns(turned)], "s", "0" * 64)], 42.28, -30.0)
    assert found.model.earth_rate == "removed"
    for j, name in enumerate(GYROS):
        value = found.model.channels[name].value(INSIDE)
        assert abs(float(np.mean(value - true_bias(INSIDE)[:, j]))) < 0.03 * EARTH_RATE


@pytest.mark.usefixtures("fast")
def test_a_bias_that_is_another_in_each_pose_is_reported_and_gravity_is_no_turn_on_offset() -> None:
    t = soak(600.0)
    down, up = (samples(t, accel=(0.0, 0.0, sign * GRAVITY)) for sign in (-1.0, 1.0))
    up = up.with_columns({"gyro_x": up["gyro_x"] + np.radians(20.0) / 3600.0})
    found = calibrate([record_of([one], name, name * 64) for name, one in (("0", down), ("1", up))])
    assert found.at_rest.turned
    assert [text for text in found.warnings if text.startswith("gyro_x: the bias differs by 14.1 °/h")]
    assert found.fits["accel_z"].repeatability is None
    assert "accel_z" not in found.model.trained_on[0].offset


@pytest.mark.usefixtures("fast")
def test_accelerometer_curves_are_the_change_from_the_middle_of_the_range() -> None:
    t = soak(300.0)
    block = samples(t, accel=(0.0, 0.0, -GRAVITY))
    moved = {"accel_x": block["accel_x"] + 1e-3 * (t - 14.0)}
    model = calibrate([record_of([block.with_columns(moved)], "s", "0" * 64)]).model
    middle = float(np.mean(model.channels["accel_x"].temperature_range_degc))
    assert float(model.channels["accel_x"].value(middle)) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(model.channels["accel_x"].slope(INSIDE), 1e-3, rtol=0.02)
    assert np.abs(model.channels["accel_z"].value(INSIDE)).max() < 1e-3


@pytest.mark.usefixtures("fast")
def test_motion_is_left_out() -> None:
    t = soak(600.0)
    block = samples(t, accel=(0.0, 0.0, -GRAVITY))
    moving = slice(3000, 3600)
    random = np.random.default_rng(1)
    shaken = {name: np.array(block[name]) for name in ("gyro_x", "gyro_y", "gyro_z", "accel_x")}
    for name in GYROS:
        shaken[name][moving] += 0.1 + 0.3 * random.standard_normal(600)
    shaken["accel_x"][moving] += random.standard_normal(600)
    found = calibrate([record_of([block.with_columns(shaken)], "s", "0" * 64)])
    assert found.at_rest.seconds.sum() == pytest.approx(len(t) - 600, abs=40)
    channel = found.model.channels["gyro_x"]
    assert errors(channel.value(INSIDE), true_bias(INSIDE)[:, 0]) < 2.5


def test_the_rest_detector_is_believed_where_there_is_one() -> None:
    t = soak(300.0)
    block = samples(t)
    judged = block.with_columns({"at_rest": np.where(np.arange(len(t)) < 2000, 0, 1)})
    rest = record_of([judged], "s", "0" * 64).rest
    assert not rest[:200].any()
    assert rest[201:].all()


def without(*names: str) -> dict[str, Any]:
    return dict.fromkeys(names, np.nan)


@pytest.mark.parametrize(
    ("temperature", "change", "said"),
    [
        (np.linspace(20.0, 24.0, 3000), {}, "spans 4.0"),
        (np.linspace(20.0, 30.0, 500), {}, "s at rest, of"),
        (np.linspace(20.0, 20.001, 2), {}, "0 s at rest, of 1 s with several samples in 10 s"),
        (np.linspace(298.0, 338.0, 3000), {}, "there is no temperature"),
        (np.repeat([20.0, 50.0], 2000), {}, "nothing at rest from 20"),
        (np.repeat([0.0, 4.5, 9.0, 13.5, 40.0], 600), {}, "nothing at rest from 13"),
        (np.tile(np.concatenate([np.linspace(25, 34, 60), np.linspace(34, 25, 60)]), 10), {}, "°C/min"),
        (np.linspace(0.0, 40.0, 3000), without("temperature"), "there is no temperature"),
        (np.linspace(0.0, 40.0, 3000), without("gyro_y"), "no values of gyro_y"),
        (np.linspace(0.0, 40.0, 3000), {"gyro_z": 0.0}, "gyro_z never changes from 0 rad/s"),
    ],
)
def test_what_cannot_give_a_model_is_refused_with_its_numbers(
    temperature: FloatArray, change: dict[str, float], said: str
) -> None:
    block = samples(temperature)
    block = SampleBlock({**block.columns, **{k: np.full(len(block), v) for k, v in change.items()}})
    with pytest.raises(ImumonError) as caught:
        calibrate([record_of([Intake(Ranges()).process(block).block], "bench", "0" * 64)])
    assert caught.value.reason is Reason.BAD_DATA
    assert said in caught.value.seen
    assert caught.value.hint


def moving_at_the_end(block: SampleBlock, names: list[str]) -> SampleBlock:
    """Return samples in which these gyros are 0 at rest, and change in motion only."""
    moving = np.arange(len(block)) > len(block) - 400
    turns = np.where(moving, 0.3 * np.random.default_rng(1).standard_normal(len(block)), 0.0)
    return block.with_columns({**dict.fromkeys(names, turns), "at_rest": np.where(moving, 0, 1)})


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("accel", [None, (0.0, 0.0, GRAVITY)])
def test_gyros_that_change_in_motion_only_are_refused(accel: tuple[float, float, float] | None) -> None:
    block = moving_at_the_end(samples(soak(300.0), accel=accel), GYROS)
    with pytest.raises(ImumonError, match="no gyro ever changes at rest") as caught:
        calibrate([record_of([block], "bench", "0" * 64)])
    assert caught.value.reason is Reason.BAD_DATA


@pytest.mark.usefixtures("fast")
@pytest.mark.parametrize("place", [(None, None), (50.0, 20.0)])
def test_a_gyro_that_changes_in_motion_only_has_no_curve_and_that_is_reported(
    place: tuple[float | None, float | None],
) -> None:
    """Also in two poses with a place: the earth rate that is taken off differs between them."""
    poses = [(0.0, 0.0, GRAVITY), (0.0, GRAVITY, 0.0)]
    blocks = [
        moving_at_the_end(samples(soak(300.0), k, accel=pose), ["gyro_y"]) for k, pose in enumerate(poses)
    ]
    found = calibrate(
        [record_of([one], name, name * 64) for name, one in zip("01", blocks, strict=True)], *place
    )
    assert set(found.model.channels) == {"gyro_x", "gyro_z", *ACCELS}
    assert "gyro_y: it never changes at rest: no curve" in found.warnings


def test_half_of_a_place_is_refused() -> None:
    with pytest.raises(ImumonError, match="there is no heading"):
        calibrate([record(soak(60.0))], latitude_deg=40.0)


def test_a_place_without_accelerometers_is_refused() -> None:
    with pytest.raises(ImumonError, match="cannot be removed"):
        calibrate([record(soak(60.0))], latitude_deg=40.0, heading_deg=0.0)


@pytest.mark.usefixtures("fast")
def test_what_goes_one_way_or_is_there_twice_is_reported() -> None:
    one = record(soak(300.0))
    both = record(np.concatenate([soak(200.0), soak(200.0)[::-1]]))
    assert any("no session both warms and cools" in text for text in calibrate([one]).warnings)
    assert not any("no session both warms and cools" in text for text in calibrate([both]).warnings)
    assert any("there twice" in text for text in calibrate([one, one]).warnings)
    of_two = [one._replace(serial="SN 1"), both._replace(serial="SN 2")]
    assert [calibrate(some).model.serial for some in (of_two[:1], of_two)] == ["SN 1", None]
    assert calibrate(of_two, serial="SN 3").model.serial == "SN 3"
