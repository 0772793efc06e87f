"""The diagnosis of a running session: what it names, what it passes over, and what a look costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.lab.diagnosis.live import (
    FIRST_SEARCH_S,
    SEARCH_EVERY_S,
    Better,
    Challenger,
    LiveDiagnosis,
    better_models,
)
from imumon.lab.diagnosis.runs import LONGEST_GAP_S, Run
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.model import BiasModel, ChannelModel
from tests.lab.diagnosis.units import DPH, cubic, ramps, run

SECONDS = int(2.5 * FIRST_SEARCH_S)
POSES = np.array([[0, 0, 1], [1, 0, 0], [0, 0, -1], [0, 1, 0]]) * STANDARD_GRAVITY


def model(low: float = 10.0, high: float = 42.0) -> BiasModel:
    """Return the curve that units have, as a calibration between two temperatures finds it."""
    degc = np.linspace(low, high, 200)
    points = Points(degc, cubic(degc) * DPH, np.ones(200), np.zeros(200, np.int64))
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[low, high],
        residual_sd=5.0 * DPH,
        curve=fit_polynomial(points, 3),
    )
    return BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels={"gyro_x": channel})


def nothing(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    return np.zeros_like(time)


def session(bias: FloatArray | None = None, **columns: FloatArray) -> Run:
    """Return a session with a bias in rad/s beside the curve, and these columns."""
    told = run(5, *ramps(SECONDS if bias is None else len(bias), up=True), nothing)
    more = 0.0 if bias is None else bias
    return replace(told, mean={**told.mean, **columns, "gyro_x": told.mean["gyro_x"] + more})


def said(told: Run, stage: LiveDiagnosis) -> str:
    """Return what is said of a session of a sample a second, in the end."""
    n = len(told.time_s)
    columns = {**told.mean, "at_rest": told.rest, "segment": np.zeros(n, np.int64)}
    columns["device_time_ns"] = (told.time_s * 1e9).astype(np.int64)
    stage.process(SampleBlock(columns))
    stage.process(SampleBlock({name: values[-1:] for name, values in columns.items()}))
    return stage.state


def turned(size: float, across: bool) -> Run:
    """Return a session in four poses, ten minutes each and then as it was, whose bias goes with them by so
    many rad/s: as a sensitivity to g does, or as the earth rate across the vertical."""
    which = np.minimum(np.arange(SECONDS) * len(POSES) // SECONDS, len(POSES) - 1)
    accel = POSES[which]
    bias = np.array([0.9, -0.6, 0.1, -0.4])[which] if across else accel[:, 2] / STANDARD_GRAVITY
    return session(size * bias, **{f"accel_{axis}": accel[:, at] for at, axis in enumerate("xyz")})


def test_what_else_was_recorded_is_named_but_not_what_a_stage_made() -> None:
    supply = 5.0 + 0.1 * np.sign(np.sin(2 * np.pi * np.arange(SECONDS) / 700.0))
    told = session(100.0 * DPH * (supply - 5.0), supply_voltage=supply)
    assert said(told, LiveDiagnosis(model())).startswith("MODEL CAN BE BETTER: curve(supply_voltage)")
    assert "supply" not in said(told, LiveDiagnosis(model(), made=lambda: ["supply_voltage"]))


def test_a_sensitivity_to_g_is_named_that_is_more_than_the_earth_rate() -> None:
    assert "g_sensitivity" in said(turned(5.0 * EARTH_RATE, across=False), LiveDiagnosis(model()))
    assert said(turned(EARTH_RATE, across=True), LiveDiagnosis(model())) == ""


def test_a_session_is_searched_at_even_distances(monkeypatch: pytest.MonkeyPatch) -> None:
    times: list[float] = []

    def looked(run: Run, _: object, __: object) -> list[Better]:
        times.append(run.duration_s)
        return []

    monkeypatch.setattr("imumon.lab.diagnosis.live.better_models", looked)
    said(session(), LiveDiagnosis(model()))
    assert times[0] == pytest.approx(FIRST_SEARCH_S, abs=2.0)
    np.testing.assert_allclose(np.diff(times), SEARCH_EVERY_S, atol=2.0)
    assert SECONDS - times[-1] <= SEARCH_EVERY_S


def test_what_one_gyro_hardly_shows_is_named_where_three_show_it() -> None:
    names = [f"gyro_{axis}" for axis in "xyz"]
    told = run(5, *ramps(SECONDS, up=True), lambda time, _: 7.0 * time / SECONDS, tuple(names))
    every = model().model_copy(update={"channels": dict.fromkeys(names, model().channels["gyro_x"])})
    assert [better_models(told, every, [name]) for name in names[1:]] == [[], []]
    assert [(one.channel, one.names) for one in better_models(told, every, names)] == [
        (name, ["drift"]) for name in names
    ]


def test_a_challenger_has_as_much_time_to_win_as_it_was_found_in(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[float] = []

    class Undecided(Challenger):
        def compare(self, _: Run) -> None:
            if self.since_s not in begun:
                begun.append(self.since_s)

    monkeypatch.setattr("imumon.lab.diagnosis.live.Challenger", Undecided)
    seconds = int(2.0 * FIRST_SEARCH_S + 2.0 * SEARCH_EVERY_S)
    swinging = session(40.0 * DPH * np.sin(np.arange(seconds) / 30.0))
    assert said(swinging, LiveDiagnosis(model(), learn=True))
    np.testing.assert_allclose(begun, [FIRST_SEARCH_S, 2.0 * FIRST_SEARCH_S], atol=2.0)


def test_the_log_has_the_same_effects_once() -> None:
    stage = LiveDiagnosis(model())
    assert said(session(8.0 * DPH * np.sin(np.arange(SECONDS) / 90.0)), stage)
    told = [text.partition(": ")[2].partition(":")[0] for text in stage.notices()]
    assert told == ["periodic on x"]


def test_a_unit_that_never_rests_is_searched_in_vain() -> None:
    told = session(40.0 * DPH * np.sin(np.arange(SECONDS) / 30.0))
    assert said(replace(told, rest=np.zeros(SECONDS)), LiveDiagnosis(model())) == ""


def test_a_session_without_any_temperature_is_not_searched_and_the_log_has_that_once() -> None:
    told = session(40.0 * DPH * np.sin(np.arange(SECONDS) / 30.0), temperature=np.full(SECONDS, np.nan))
    stage = LiveDiagnosis(model())
    assert said(told, stage) == ""
    none = "there is no temperature that every run has, and a bias model is over one: this session has none"
    assert stage.notices() == [f"the model is not searched: {none}"]


def test_after_a_gap_of_many_hours_a_run_begins_anew() -> None:
    stage, told = LiveDiagnosis(model()), session(100.0 * DPH * np.sin(np.arange(SECONDS) / 60.0))
    assert said(told, stage)
    late = {name: values[:60] for name, values in told.mean.items()}
    time_ns = np.round((told.time_s[:60] + LONGEST_GAP_S + 2 * SECONDS) * 1e9).astype(np.int64)
    rest, segment = np.ones(60), np.zeros(60, np.int64)
    stage.process(SampleBlock({**late, "device_time_ns": time_ns, "at_rest": rest, "segment": segment}))
    assert stage.state == ""


@pytest.mark.parametrize("period_s", [130.0, 210.0, 555.0])
def test_a_period_is_named_whatever_it_is(period_s: float) -> None:
    swing = 8.0 * DPH * np.sin(2 * np.pi * np.arange(SECONDS) / period_s)
    assert said(session(swing), LiveDiagnosis(model())).startswith("MODEL CAN BE BETTER: periodic on x")


@pytest.mark.long
def test_after_a_week_a_period_of_less_than_an_hour_is_named() -> None:
    """As the session is then: slots of 128 s, whose noise is as of so many seconds."""
    slots, slot_s, period_s = 4725, 128.0, 3300.0
    time, rng = np.arange(0.5, slots) * slot_s, np.random.default_rng(3)
    temperature = 26.0 + 10.0 * np.sin(2 * np.pi * time / 86400.0)
    rate = (cubic(temperature) + 2.0 * np.sin(2 * np.pi * time / period_s) + rng.normal(size=slots)) * DPH
    unknown, count = np.full(slots, np.nan), np.full(slots, 1e4)
    week = Run(
        "a week",
        time,
        {"gyro_x": count, "temperature": count},
        {"gyro_x": rate, "temperature": temperature},
        {"gyro_x": unknown, "temperature": unknown},
        np.ones(slots),
        slot_s=slot_s,
    )
    found = better_models(week, model(), ["gyro_x"])
    assert [one.names for one in found] == [["periodic"]]
    assert found[0].model.effects[-1].model_dump()["period_s"] == pytest.approx(period_s, rel=1e-3)


def test_what_a_curve_leaves_beyond_its_temperatures_is_no_effect() -> None:
    assert said(session(), LiveDiagnosis(model(18.0, 28.0))) == ""


def test_a_better_model_is_compared_also_where_the_thermometer_has_a_reading_in_ten_seconds() -> None:
    """Seconds without a reading counted as outside the temperatures, and nothing was ever compared."""
    degc = session().mean["temperature"].copy()
    degc[np.arange(SECONDS) % 10 != 0] = np.nan
    told = session(20.0 * DPH * np.sin(np.arange(SECONDS) / 90.0), temperature=degc)
    since = 2.0 * FIRST_SEARCH_S
    rest = np.where(told.time_s < since, told.rest, 0.0)
    found = better_models(replace(told, rest=rest), model(), ["gyro_x"])
    compared = Challenger(model(), found, since).compare(told)
    assert compared is not None
    ratio, before, after = compared
    assert ratio > 0.0
    assert after < 0.5 * before


def test_a_model_without_gyros_is_not_searched() -> None:
    """After 20 min the stage failed."""
    accel = model().channels["gyro_x"].model_copy(update={"unit": "m/s^2"})
    without = model().model_copy(update={"channels": {"accel_x": accel}})
    stage = LiveDiagnosis(without)
    assert said(session(accel_x=np.zeros(SECONDS)), stage) == ""
    assert stage.notices() == []


def test_what_a_learned_model_states_is_the_run_that_proved_it() -> None:
    """It was the run at the end, which could be too short for any mean: the model was lost."""
    stage = LiveDiagnosis(model(), learn=True)
    assert said(session(40.0 * DPH * np.sin(np.arange(SECONDS) / 30.0)), stage)
    assert stage.offered is not None
    won = stage.evidence("session", "0" * 64)
    assert won.rest_s > FIRST_SEARCH_S
    again, last = session(), int(10 * SECONDS * 1e9)
    for part in (slice(0, 20), slice(20, 40)):
        time_ns = last + (again.time_s[part] * 1e9).astype(np.int64)
        segment, rest = np.ones(20, np.int64), np.ones(20)
        values = {name: values[part] for name, values in again.mean.items()}
        stage.process(SampleBlock({**values, "device_time_ns": time_ns, "segment": segment, "at_rest": rest}))
    assert stage.evidence("session", "0" * 64) == won
