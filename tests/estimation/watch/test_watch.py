"""The watch over the bias filter: silent while it is right, and it says why when it is not."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.estimation.watch import stage as evidence
from imumon.estimation.watch.stage import ModelWatch, Pattern
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.biases import curve_value
from imumon.simulation.unit.scenario import Scenario
from tests.estimation.gyro_bias.records import GIVEN
from tests.lanes import texts

HOURS = 2.0
RATE_HZ, SECONDS = 2.0, 1800.0


def drive(seed: int, hours: float = HOURS) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return slots of a right filter, the temperature up and down: time, innovations, T, its rate."""
    random = np.random.default_rng(seed)
    n = int(hours * 7200)
    seconds = 0.5 * np.arange(n, dtype=np.float64)
    temperature = 25 + 10 * np.sin(2 * np.pi * seconds / 3000 + random.uniform(0, 6))
    rate = np.gradient(temperature, 0.5)
    return seconds, random.standard_normal((n, 3)), _three(temperature), _three(rate)


def _three(values: FloatArray) -> FloatArray:
    return np.tile(values[:, np.newaxis], (1, 3))


def alarm(
    seconds: FloatArray, innovation: FloatArray, temperature: FloatArray, rate: FloatArray, hours: float
) -> int:
    state, alarm_at = evidence.State(), evidence.limit(hours)
    for i, now_s in enumerate(seconds.tolist()):
        if evidence.step(state, now_s, innovation[i], temperature[i], rate[i]) >= alarm_at:
            return i
    return -1


def highest_sum(gains: FloatArray) -> float:
    """Return the largest sum of neighbours: what a CUSUM finds."""
    sums = np.concatenate([[0.0], np.cumsum(gains)])
    return float(max((sums[k + 1 :] - sums[k]).max() for k in range(len(gains))))


def test_the_evidence_is_the_largest_sum_of_logarithms_of_e_factors() -> None:
    seconds, innovation, temperature, rate = drive(1, 0.15)
    temperature[100:150] = np.nan
    rate[300:] = np.nan
    innovation[:, 1] += 0.5
    innovation[700:720] *= 9.0
    state = evidence.State()
    for i, now_s in enumerate(seconds.tolist()):
        evidence.step(state, now_s, innovation[i], temperature[i], rate[i])
    v = np.clip(innovation, -evidence.CLIP, evidence.CLIP)[evidence.LEARNING :, 1]
    past = np.clip(
        np.clip(innovation, -evidence.CLIP, evidence.CLIP)[evidence.LEARNING - 1 : -1, 1] / 3, -1, 1
    )
    for pattern, r in ((Pattern.TIME, np.ones(len(v))), (Pattern.AUTOCORRELATION, past)):
        first = int(np.argmax(pattern == evidence.PATTERNS))
        for k, theta in enumerate(evidence.THETAS[:3]):
            gains = theta * (r * v - evidence.TOLERANCE * np.abs(r)) - theta**2 * r**2 * evidence.KAPPA / 2
            blocks = gains[: len(v) // 10 * 10].reshape(-1, 10).sum(1)
            expected = max(highest_sum(blocks), 0.0)
            assert state.peaks[1, first + k] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    assert state.peaks[1].max() > 50.0


def test_a_pause_forgets_the_extremes_of_the_temperature() -> None:
    seconds, innovation, temperature, rate = drive(1, 0.05)
    seconds[200:] += 4 * evidence.SCALE_S
    temperature[:200] += 100.0 * np.sin(seconds[:200, np.newaxis])
    temperature[200:], rate[:] = 25.0, 0.0
    state = evidence.State()
    for i, now_s in enumerate(seconds.tolist()):
        evidence.step(state, now_s, innovation[i], temperature[i], rate[i])
    assert state.scale[:, 0] == pytest.approx(100.0 * np.exp(-4.0), rel=0.5)
    assert state.scale[:, 1:] == pytest.approx(0.003)


@pytest.mark.long
def test_false_alarms_are_as_rare_as_promised() -> None:
    # The mean time to one is 0.8 h at least: of 60 times 0.1 h, 7.5 would have one at the most, in the mean.
    alarms = sum(alarm(*drive(seed, 0.1), 0.8) >= 0 for seed in range(60))
    assert alarms <= 7.5 + 2 * np.sqrt(7.5)


@pytest.mark.parametrize("what", ["rate", "temperature", "constant", "past", "size"])
def test_each_fault_is_found_within_half_an_hour_or_so(what: str) -> None:
    seconds, innovation, temperature, rate = drive(3)
    if what == "rate":
        innovation[:, 0] += 0.6 * rate[:, 0] / np.abs(rate[:, 0]).max()
    elif what == "temperature":
        high = temperature[:, 0] - temperature[:, 0].mean()
        innovation[:, 0] += 0.6 * high / np.abs(high).max()
    elif what == "constant":
        innovation[:, 0] += 0.3
    elif what == "past":
        for i in range(1, len(innovation)):
            innovation[i, 0] = 0.4 * innovation[i - 1, 0] + 0.92 * innovation[i, 0]
    else:
        innovation[:, 0] *= 1.4
    at = alarm(seconds, innovation, temperature, rate, 24.0)
    assert at >= 0
    assert seconds[at] < 2400.0


def test_a_knock_is_no_alarm() -> None:
    seconds, innovation, temperature, rate = drive(4, 0.5)
    innovation[2000:2003] = 50.0
    assert alarm(seconds, innovation, temperature, rate, 24.0) < 0


def test_a_restart_of_the_device_clears_the_suspicion() -> None:
    seconds, innovation, temperature, rate = drive(5, 1.0)
    innovation += np.where(seconds < 1000.0, 0.8, 0.0)[:, np.newaxis]
    segment = (seconds > 1800.0).astype(np.int64)
    block = SampleBlock(
        {
            "device_time_ns": np.round(seconds * 1e9).astype(np.int64),
            "segment": segment,
            "temperature_estimate": temperature[:, 0],
            "temperature_rate": rate[:, 0],
            **{f"zupt_innovation_{axis}": innovation[:, j] for j, axis in enumerate("xyz")},
        }
    )
    watch = ModelWatch(modelled=True)
    assert texts(watch) == {"model": "waiting for rest"}
    assert texts(ModelWatch()) == {"model": "no model; waiting for rest"}
    suspect = watch.process(block)["model_suspect"]
    first = int(np.argmax(suspect))
    assert seconds[first] < 1000.0
    assert suspect[first : np.argmax(segment)].all()
    assert not suspect[segment == 1].any()
    assert texts(watch) == {"model": "MODEL OK"}
    said = watch.notices()
    assert len(said) == 1
    assert "imumon diagnose --train SESSION" in said[0]


def test_a_unit_that_lacks_a_gyro_is_watched_by_the_others() -> None:
    seconds, innovation, _, _ = drive(6, 0.5)
    block = SampleBlock(
        {
            "device_time_ns": np.round(seconds * 1e9).astype(np.int64),
            "segment": np.zeros(len(seconds), np.int64),
            **{f"zupt_innovation_{axis}": innovation[:, j] for j, axis in enumerate("xyz")},
            "zupt_innovation_y": np.full(len(seconds), np.nan),
        }
    )
    watch = ModelWatch(modelled=True)
    assert not watch.process(block)["model_suspect"].any()
    assert texts(watch) == {"model": "MODEL OK"}


def scenario(gyro_lag_s: float) -> Scenario:
    base = load_scenario("crs05-ramp")
    steps = [
        {"hold_s": 200},
        {"to_degc": 40, "rate_degc_per_min": 2, "hold_s": 300},
        {"to_degc": 25, "rate_degc_per_min": 2},
    ]
    chamber = {**base.chamber.model_dump(), "start_degc": 25.0, "steps": steps}
    unit = {**base.unit.model_dump(), "gyro_lag_s": gyro_lag_s}
    return Scenario.model_validate(
        {**base.model_dump(), "rate_hz": RATE_HZ, "duration_s": SECONDS, "chamber": chamber, "unit": unit}
    )


def true_model() -> BiasModel:
    """Return the curves that the simulated unit has."""
    unit = SimulatedUnit(scenario(0.0), seed=0)
    at = np.linspace(20.0, 45.0, 400)
    channels = {}
    for axis in "xyz":
        values = np.radians(curve_value(getattr(unit.scenario.unit.gyro_bias_deg_per_s, axis), at))
        series = np.polynomial.Chebyshev.fit(at, values, 8, domain=[20.0, 45.0])
        channels[f"gyro_{axis}"] = ChannelModel(
            unit="rad/s",
            temperature_column="temperature_estimate",
            temperature_range_degc=[20.0, 45.0],
            residual_sd=2e-6,
            curve=PolynomialCurve(center_degc=32.5, half_width_degc=12.5, coefficients=series.coef.tolist()),
        )
    return BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels=channels)


@cache
def followed(gyro_lag_s: float) -> SampleBlock:
    """Return what the stages before the watch say of a unit."""
    sent, _ = SimulatedUnit(scenario(gyro_lag_s), seed=1).run(int(SECONDS * RATE_HZ))
    sent = sent.with_columns({"at_rest": np.ones(len(sent), np.int64)})
    for stage in (TemperatureRate(), RestAndBias(GIVEN, model=true_model(), mode="thermal")):
        sent = sent.with_columns(stage.process(sent))
    return sent


def watched(gyro_lag_s: float, size: int) -> tuple[ModelWatch, FloatArray]:
    """Return a watch that has seen a unit in blocks of this size, and what it said."""
    watch, sent = ModelWatch(modelled=True), followed(gyro_lag_s)
    parts = [sent.rows(at, min(at + size, len(sent))) for at in range(0, len(sent), size)]
    return watch, np.concatenate([watch.process(part)["model_suspect"] for part in parts])


@pytest.mark.long
def test_a_unit_that_is_as_its_model_states_is_not_suspected() -> None:
    watch, _ = watched(0.0, 10_000)
    assert texts(watch) == {"model": "MODEL OK"}
    assert watch.notices() == []


@pytest.mark.long
def test_a_lag_that_the_model_lacks_is_suspected_whatever_the_blocks() -> None:
    watch, whole = watched(60.0, 3600)
    assert watch.lanes()["model"].text.startswith("MODEL SUSPECT: innovations follow")
    (said,) = watch.notices()
    assert "thermal_lag" in said
    assert "imumon diagnose --train SESSION" in said
    np.testing.assert_array_equal(whole, watched(60.0, 777)[1])
    np.testing.assert_array_equal(whole, watched(60.0, 9)[1])


def test_rarer_false_alarms_take_more_evidence() -> None:
    assert evidence.limit(100.0) > evidence.limit(1.0)
