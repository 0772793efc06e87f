"""The textbook filter against numbers that were worked out apart from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dense_record import DenseRun, dense_filter

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import body_to_ned
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.papers.dense_zupt import DenseSettings, DenseZupt
from tests.estimation.gyro_bias.records import ARW, DPH, GRAVITY, Truth, local_earth, record

SETTINGS = DenseSettings(0.01)


def response(settings: DenseSettings, axis: int, seconds: float) -> FloatArray:
    """Return what is left of a residual of 15 deg/h, in deg/h: without noise, for P needs no data."""
    n = round(seconds / settings.interval_s)
    gyro, accel = np.tile(local_earth(), (n, 1)), np.tile([0.0, 0.0, -GRAVITY], (n, 1))
    start = np.zeros(3)
    start[axis] = 15.0 * DPH
    return dense_filter(settings, gyro, accel, start, every=10).bias[:, axis] / DPH


@pytest.mark.parametrize(
    ("k", "p0", "expected", "below_s"),
    [
        (0.0, 2.2, [13.33, 10.21, 7.57, 4.98, 2.96], 368.6),
        (0.5, 2.2, [12.94, 7.86, 3.34, 0.57, 0.02], 76.4),
        (0.5, 15.0, [2.18, 0.59, 0.20, 0.03, 0.00], 10.5),
    ],
)
def test_a_residual_decays_as_the_random_walk_and_the_start_have_it(
    k: float, p0: float, expected: list[float], below_s: float
) -> None:
    settings = replace(SETTINGS, bias_random_walk=k * DPH, bias_sd=p0 * DPH)
    left = response(settings, 0, 400.0)
    assert left[[999, 2999, 5999, 11999, 23999]] == pytest.approx(expected, abs=0.015)
    assert (np.flatnonzero(left < 2.063)[0] + 1) / 100 == pytest.approx(below_s, abs=0.2)
    if p0 < 3.0:
        assert left[999] - response(settings, 2, 10.0)[999] == pytest.approx(0.5, abs=0.15)


def test_the_sigma_reaches_the_information_limit() -> None:
    settings = replace(SETTINGS, bias_random_walk=0.0, bias_sd=1000 * DPH)
    n = 30000
    gyro, accel = np.tile(local_earth(), (n, 1)), np.tile([0.0, 0.0, -GRAVITY], (n, 1))
    run = dense_filter(settings, gyro, accel, np.zeros(3), every=10)
    at = [999, 2999, 5999, 11999, 29999]
    assert run.bias_sd[at, 0] / DPH == pytest.approx([6.21, 3.21, 2.22, 1.55, 0.97], rel=0.01)
    limit = ARW / np.sqrt((np.array(at) + 1) / 100)
    assert (run.bias_sd[at] >= 0.999 * limit[:, np.newaxis]).all()
    assert run.bias_sd[at, 2] == pytest.approx(limit, rel=0.02)


def both(seed: int, attitude: FloatArray) -> tuple[DenseRun, DenseRun, FloatArray]:
    """Return the filter on calibrated data and the filter with increments on raw data, at equal K and p0."""
    n = 30000
    temperature = np.interp(np.arange(n) / 100, [0, 60, 264, 300], [27.28, 27.28, 34.08, 34.08])
    thermal = DPH * np.column_stack([40 * temperature, -65 * temperature, temperature**2 / 5])
    block, _ = record(Truth(), 300.0, seed, thermal, attitude=attitude, earth=local_earth())
    gyro, accel = block.gyro, block.accel
    assert gyro is not None
    assert accel is not None
    settings = replace(SETTINGS, heading_deg=30.0)
    up = attitude @ [0.0, 0.0, -1.0]
    calibrated = dense_filter(settings, gyro - thermal, accel, np.zeros(3), up=up, every=10)
    drift = np.diff(thermal, axis=0, prepend=thermal[:1])
    return calibrated, dense_filter(settings, gyro, accel, thermal[0], drift, up, 10), thermal


def test_on_calibrated_data_and_with_increments_it_is_one_filter() -> None:
    up = np.array([0.3, -0.5, 0.8])
    attitude = body_to_ned(up / np.linalg.norm(up), np.radians(30.0)).T
    calibrated, compensated, thermal = both(3, attitude)
    assert np.abs(calibrated.bias + thermal - compensated.bias).max() / DPH < 3e-3
    np.testing.assert_allclose(calibrated.bias_sd, compensated.bias_sd, rtol=1e-4)


def test_steps_of_ten_samples_are_the_filter_at_every_sample() -> None:
    block, _ = record(Truth(), 30.0, 4, earth=local_earth())
    gyro, accel = block.gyro, block.accel
    assert gyro is not None
    assert accel is not None
    up = np.array([0.0, 0.0, -1.0])
    printed = dense_filter(SETTINGS, gyro, accel, np.zeros(3), up=up)
    tenth = dense_filter(SETTINGS, gyro, accel, np.zeros(3), up=up, every=10)
    last = slice(999, None, 10)
    assert np.abs(printed.bias - tenth.bias)[last].max() < 0.1 * printed.bias_sd[last].min()
    np.testing.assert_allclose(tenth.bias_sd[last], printed.bias_sd[last], rtol=0.01)


def warming_model(slope_dph: float) -> BiasModel:
    curve = PolynomialCurve(
        center_degc=30.0, half_width_degc=10.0, coefficients=[0.0, 10.0 * slope_dph * DPH]
    )
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[20.0, 40.0],
        residual_sd=DPH,
        curve=curve,
    )
    return BiasModel(
        made_by="test", created="2026-01-01T00:00:00Z", channels={f"gyro_{a}": channel for a in "xyz"}
    )


@pytest.mark.parametrize("method", ["dense_zupt", "dense_tczupt"])
def test_live_it_follows_a_ramp_and_holds_in_motion(method: str) -> None:
    n = 15000
    temperature = 25.0 + np.maximum(np.arange(n) / 100 - 60.0, 0.0) / 30.0
    thermal = 40.0 * DPH * (temperature - 30.0)
    block, _ = record(Truth(), n / 100, 6, thermal[:, np.newaxis] * np.ones(3), earth=local_earth())
    rest = np.ones(n, np.int64)
    rest[10000:11000] = 0
    rate = np.where(np.arange(n) < 6000, 0.0, 1 / 30.0)
    block = block.with_columns({"temperature": temperature, "temperature_rate": rate, "at_rest": rest})
    block = block.with_columns({"gyro_x": block["gyro_x"] + 0.5 * (1 - rest)})
    settings = replace(SETTINGS, bias_sd=3.0 * DPH)

    whole = DenseZupt(method, settings, warming_model(40.0)).process(block)
    bias, sd = whole[f"{method}_gyro_bias_x"], whole[f"{method}_gyro_bias_sd_x"]
    assert np.isnan(bias[:5990]).all()
    error = (bias - thermal) / DPH
    # The zeroing leaves 60 ARW/√60 s = 2.2 deg/h; four sigma of that.
    assert np.abs(error[6100:]).max() < 8.8
    assert (np.diff(sd[10100:11000]) >= 0.0).all()
    assert sd[10990] > sd[9990]


def slow(rate_hz: float, seconds: float, hole: tuple[float, float] = (0.0, 0.0)) -> SampleBlock:
    """Return a unit at rest, warming by 12 °C/h, in motion from 120 s on, without the samples of a hole."""
    t = np.arange(round(rate_hz * seconds)) / rate_hz
    t = t[(t <= hole[0]) | (t >= hole[1])]
    random = np.random.default_rng(1)
    columns = {f"gyro_{a}": 40.0 * DPH * t / 300.0 + DPH * random.standard_normal(len(t)) for a in "xyz"}
    force = np.array([0.0, 0.0, -GRAVITY]) + 1e-4 * random.standard_normal((len(t), 3))
    return SampleBlock(
        {
            "device_time_ns": np.rint(t * 1e9).astype(np.int64),
            "segment": np.zeros(len(t), np.int64),
            "temperature": 25.0 + t / 300.0,
            "temperature_rate": np.full(len(t), 1.0 / 300.0),
            "at_rest": (t < 120.0).astype(np.int64),
            **columns,
            **{f"accel_{a}": force[:, i] for i, a in enumerate("xyz")},
        }
    )


@pytest.mark.parametrize("rate_hz", [5.0, 3.0, 1.0])
def test_a_slow_stream_is_the_filter_of_a_fast_one(rate_hz: float) -> None:
    settings = replace(SETTINGS, latitude_deg=None, heading_deg=None)
    fast, found = (
        {
            name: column[round(hz * 240.0) - 2] / DPH
            for name, column in DenseZupt("dense_tczupt", settings, warming_model(40.0))
            .process(slow(hz, 240.0))
            .items()
        }
        for hz in (20.0, rate_hz)
    )
    for axis in "xyz":
        sd = fast[f"dense_tczupt_gyro_bias_sd_{axis}"]
        assert found[f"dense_tczupt_gyro_bias_sd_{axis}"] == pytest.approx(sd, rel=0.05)
        assert found[f"dense_tczupt_gyro_bias_{axis}"] == pytest.approx(32.0, abs=3.0)


@pytest.mark.parametrize(("hole_s", "known"), [(0.9, True), (30.0, True), (36000.0, False)])
def test_what_is_not_measured_is_not_counted_as_rest(hole_s: float, known: bool) -> None:
    settings = replace(SETTINGS, latitude_deg=None, heading_deg=None)
    block = slow(20.0, 100.0 + hole_s + 20.0, (100.0, 100.0 + hole_s))
    whole = DenseZupt("dense_zupt", settings, assume_rest=True)
    columns = dict(block.columns)
    del columns["at_rest"]
    sd = whole.process(SampleBlock(columns))["dense_zupt_gyro_bias_sd_x"] / DPH
    after = int(np.searchsorted(block["device_time_ns"], (100.0 + hole_s) * 1e9)) + 15
    assert np.isfinite(sd[after]) == known
    if known:
        grown = np.hypot(sd[after - 25], 0.1 * np.sqrt(hole_s))
        assert sd[after] == pytest.approx(grown if hole_s > 1.25 else sd[after - 25], rel=0.01)


def test_a_stream_of_less_than_a_packet_a_second_has_no_values() -> None:
    found = DenseZupt("dense_zupt", SETTINGS).process(slow(0.5, 300.0))
    assert all(np.isnan(column).all() for column in found.values())


def test_after_a_restart_sigma_begins_as_at_first() -> None:
    block = slow(20.0, 400.0)
    columns = dict(block.columns)
    again = block["device_time_ns"] > 200.0 * 1e9
    columns["segment"] = again.astype(np.int64)
    columns["at_rest"] = np.ones(len(block), np.int64)
    moving = (block["device_time_ns"] > 70.0 * 1e9) & (block["device_time_ns"] < 80.0 * 1e9)
    columns["at_rest"][moving] = 0  # it is levelled anew behind that
    found = DenseZupt("dense_zupt", SETTINGS).process(SampleBlock(columns))["dense_zupt_gyro_bias_sd_x"]
    first, second = (found[rows][np.isfinite(found[rows])][0] for rows in (~again, again))
    assert second == pytest.approx(first, rel=1e-6)
