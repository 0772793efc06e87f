"""What is searched beside a present model: its drivers, its effects, and what becomes of its constant."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from imumon.effects.base import Effect
from imumon.effects.since_power_on import Drift, WarmUp
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.errors import ImumonError, Reason
from imumon.lab.diagnosis.candidates import Candidate, Finding, Part, Scored
from imumon.lab.diagnosis.claims import choose_claims
from imumon.lab.diagnosis.diagnose import diagnose, likeliest
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.live import LiveDiagnosis, better_models
from imumon.lab.diagnosis.page import compare, write_comparison
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import Run
from imumon.lab.diagnosis.search import PROVEN_GAIN, AxisSearch
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import BiasModel, ChannelModel
from tests.lab.diagnosis.test_live import model as cubic_model
from tests.lab.diagnosis.test_live import said, session
from tests.lab.diagnosis.units import DPH, Bias, ramps, run, three

SECONDS = 2400
OF_SUPPLY = TemperatureCurve(
    driver="supply", middle=5.0, half_span=0.1, first_power=1, powers=1, coefficients=[20.0 * DPH]
)


def nothing(time: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.zeros_like(time)


def with_effect(effect: Effect) -> BiasModel:
    """Return the curve that units have, with an effect beside it."""
    model = cubic_model()
    channel = model.channels["gyro_x"].model_copy(update={"effects": [effect]})
    return model.model_copy(update={"channels": {"gyro_x": channel}})


def supplied(one: Run, volt: float = 5.0) -> Run:
    """Return a run with a supply that does not vary."""
    return replace(one, mean={**one.mean, "supply": np.full(len(one.time_s), volt)})


def with_second_axis(one: Run) -> Run:
    """Return a run of which gyro y reads as gyro x does."""
    return replace(
        one,
        mean={**one.mean, "gyro_y": one.mean["gyro_x"]},
        variance={**one.variance, "gyro_y": one.variance["gyro_x"]},
        count={**one.count, "gyro_y": one.count["gyro_x"]},
    )


def test_channels_that_the_present_model_does_not_have_are_reported() -> None:
    train, test = ([with_second_axis(one) for one in runs] for runs in three(nothing, SECONDS))
    diagnosis = diagnose(train, test, model=cubic_model())
    assert [verdict.name for verdict in diagnosis.verdicts] == ["gyro_x"]
    assert "left out, as the model does not have them: gyro_y" in diagnosis.caveats


def test_a_driver_of_the_present_model_may_be_constant() -> None:
    """It was dropped, and its effect had nothing to be computed from."""
    train, test = ([supplied(one) for one in runs] for runs in three(nothing, SECONDS))
    (verdict,) = diagnose(train, test, model=with_effect(OF_SUPPLY)).verdicts
    assert not verdict.claims
    assert [part.effect.label for part in verdict.after.parts] == ["curve(supply)"]
    assert better_models(supplied(session()), with_effect(OF_SUPPLY), ["gyro_x"]) == []


def test_a_driver_of_the_present_model_that_a_run_hardly_has_is_refused_and_the_monitor_goes_on() -> None:
    train, test = three(nothing, SECONDS)
    for drivers in (None, list[str]()):
        with pytest.raises(ImumonError, match="supply is hardly recorded in run 1, run 2") as error:
            diagnose(train, test, model=with_effect(OF_SUPPLY), drivers=drivers)
        assert error.value.reason is Reason.BAD_DATA
    stage = LiveDiagnosis(with_effect(OF_SUPPLY))
    assert said(session(), stage) == ""
    assert any("not searched: supply is hardly recorded" in text for text in stage.notices())


@pytest.mark.parametrize("spline", [True, False])
def test_an_accelerometer_keeps_its_bias_where_a_present_polynomial_goes_into_the_curve(spline: bool) -> None:
    """What the polynomial had at the middle of the new temperatures was taken for gravity."""
    knots, zero = np.linspace(0.0, 60.0, 8), np.zeros(8)
    curve = (
        SplineCurve(knots_degc=knots.tolist(), values=zero.tolist(), slopes=zero.tolist())
        if spline
        else PolynomialCurve(center_degc=30.0, half_width_degc=30.0, coefficients=[0.0])
    )
    slope = TemperatureCurve(middle=30.0, half_span=30.0, first_power=1, powers=1, coefficients=[0.01])
    channel = ChannelModel(
        unit="m/s^2",
        temperature_column="temperature",
        temperature_range_degc=[0.0, 60.0],
        residual_sd=1e-4,
        curve=curve,
        effects=[slope],
    )
    present = BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels={"accel_x": channel})
    runs = [run(seed, *ramps(SECONDS, seed == 1), nothing, ("accel_x",)) for seed in (1, 2)]
    for one in runs:
        noise = 1e-4 * np.random.default_rng(3).standard_normal(SECONDS)
        one.mean["accel_x"] = 0.01 * (one.mean["temperature"] - 30.0) / 30.0 + 9.8 + noise
    diagnosis = diagnose(runs, [], model=present)
    found = extended_model(diagnosis).channels["accel_x"]

    def bias(of: ChannelModel, degc: float) -> float:
        shapes = [shape for effect in of.effects if (shape := effect.polynomial()) is not None]
        return float(of.curve.value(degc)) + sum(float(shape(degc)) for shape in shapes)

    assert bias(found, 20.0) == pytest.approx(bias(channel, 20.0), abs=1e-4)


def test_models_over_two_thermometers_are_compared_on_one_page(tmp_path: Path) -> None:
    one = run(1, *ramps(SECONDS, True), nothing)
    one.mean["temperature_x"] = one.mean["temperature"] + 2.0
    first = cubic_model()
    other = first.channels["gyro_x"].model_copy(update={"temperature_column": "temperature_x"})
    both = first, first.model_copy(update={"channels": {"gyro_x": other}})
    write_comparison(compare([one], both), ("a", "b"), "session", tmp_path / "page.html")
    assert (tmp_path / "page.html").exists()


class Axis(AxisSearch):
    """A search with findings whose gains are given by name."""

    def __init__(self, findings: list[Finding], gains: dict[str, float]) -> None:
        self.findings, self.given, self.history, self.refused = findings, gains, [], []
        self.channel, self.tables = cast(Any, SimpleNamespace(name="gyro_x")), [{}]
        self.candidates = [one for finding in findings for one in finding.alternatives.values()]
        self.refined_beside: list[int] = []

    def gains(self, tried: Sequence[Candidate], model: Sequence[Candidate]) -> list[Scored]:  # noqa: ARG002
        return [Scored(one, self.given[one.family], 0.0) for one in tried]

    def refined(self, candidate: Candidate, model: Sequence[Candidate]) -> Scored:
        self.refined_beside.append(len(model))
        return Scored(candidate, 0.0, 0.0)

    def criterion(self, model: Sequence[Candidate]) -> float:
        return max([0.0, *(self.given[one.family] for one in model)])


DRIFT, WARM_UP = (Candidate((Part(one),)) for one in (Drift(), WarmUp(time_constant_s=200.0)))


def test_an_exchanged_finding_has_the_gain_of_its_new_effect() -> None:
    """It had that of the effect before it."""
    finding = Finding(DRIFT, 30.0, 80.0, {"drift": 30.0, "warm_up": 25.0}, {"warm_up": WARM_UP})
    Axis([finding], {"drift": 20.0, "warm_up": 22.0})._refine_each(exchange=True)
    assert finding.name == "warm_up"
    assert [*finding.alternatives] == ["drift"]
    assert finding.gain == 25.0
    assert finding.gain_over_axes == 80.0 - 30.0 + 25.0


def test_what_is_left_of_two_findings_is_refined_again() -> None:
    axis = Axis([Finding(DRIFT), Finding(WARM_UP)], {"drift": 0.0, "warm_up": 10.0})
    axis.eliminate()
    assert [one.name for one in axis.findings] == ["warm_up"]
    assert axis.refined_beside == [0]


def test_a_model_fitted_anew_on_any_axis_has_its_price() -> None:
    """Only the first axis was looked at."""

    def axis(refits: bool, criterion: float) -> Any:
        channel = SimpleNamespace(faulty=False, refits_model=refits, offset_per="all")
        return SimpleNamespace(channel=channel, model=[], criterion=lambda _: criterion)

    anew = [axis(False, 0.0), axis(True, 0.9 * PROVEN_GAIN)]
    fixed = [axis(False, 0.0), axis(False, 0.0)]
    assert likeliest(cast(Any, [anew, fixed])) is fixed


def test_a_test_without_the_temperature_of_the_present_model_is_not_used_and_that_is_reported() -> None:
    """Nothing was diagnosed."""
    train, test = three(nothing, SECONDS)
    bare = replace(test[0], name="bare", mean={"gyro_x": test[0].mean["gyro_x"]})
    diagnosis = diagnose(train, [bare, *test], model=cubic_model())
    assert [one.in_slots.name for one in diagnosis.test] == [test[0].name]
    assert "bare: not used, it lacks temperature" in diagnosis.caveats
    with pytest.raises(ImumonError, match="over one: run 1 has temperature; bare has none"):
        diagnose([train[0], bare], [])


@pytest.mark.long
def test_what_an_effect_explains_alone_is_beside_the_effects_of_the_present_model() -> None:
    """Without these nearly nothing was explained."""

    def lacking(time: np.ndarray, degc: np.ndarray) -> np.ndarray:
        bent = 20.0 * ((degc - 25.0) / 15.0) ** 2  # so that the curve has to be fitted anew
        return np.asarray(bent + 100.0 * np.exp(-time / 300.0) + 10.0 * np.sin(2.0 * np.pi * time / 700.0))

    warm_up = WarmUp(time_constant_s=300.0, coefficients=[50.0 * DPH])
    train, test = three(lacking, SECONDS)
    diagnosis = diagnose(train, test, model=with_effect(warm_up))
    (verdict,) = diagnosis.verdicts
    assert "warm_up" in verdict.refit
    content = report(diagnosis)["channels"]["gyro_x"]
    (effect,) = content["effects"]
    assert effect["name"] == "periodic"
    assert effect["evidence"]["explained_share_alone"] > 0.9
    assert content["ranking"][0]["train_rms"] < 0.5 * verdict.before.train_rms


def test_a_test_that_an_effect_of_the_present_model_worsens_does_not_take_it_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The curve was fitted anew without it, and left twice as much of the training as the present model."""
    monkeypatch.setattr("imumon.lab.diagnosis.diagnose.effects_for", lambda _: [])

    def warming(dph: float) -> Bias:
        return lambda time, degc: 20.0 * ((degc - 25.0) / 15.0) ** 2 + dph * np.exp(-time / 300.0)

    present = with_effect(WarmUp(time_constant_s=300.0, coefficients=[50.0 * DPH]))
    for in_test, refit in ((100.0, ["curve", "warm_up"]), (20.0, list[str]())):
        train, test = three(warming(100.0), SECONDS)[0], three(warming(in_test), SECONDS)[1]
        diagnosis = diagnose(train, test, model=present)
        (verdict,) = diagnosis.verdicts
        (effect,) = extended_model(diagnosis).channels["gyro_x"].effects
        assert effect.name == "warm_up"
        assert (verdict.refit, verdict.left_out) == (refit, [])
        assert verdict.prediction.rms <= verdict.test_before.rms


def test_an_effect_of_the_present_model_comes_back_where_what_made_it_needless_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The model was fitted anew with neither."""
    monkeypatch.setattr("imumon.lab.diagnosis.diagnose.effects_for", lambda _: [])

    def warming(time: np.ndarray, degc: np.ndarray) -> np.ndarray:
        return np.asarray(20.0 * ((degc - 25.0) / 15.0) ** 2 + 100.0 * np.exp(-time / 300.0))

    train, test = three(warming, SECONDS)
    warm_up = WarmUp(time_constant_s=300.0, coefficients=[50.0 * DPH])
    (verdict,) = diagnose(train, test, model=with_effect(warm_up)).verdicts
    assert [one.name for one in verdict.search.findings] == ["warm_up"]
    verdict.search.findings = [Finding(DRIFT)]
    trained, _ = choose_claims(verdict.channel, verdict.search)
    assert [part.effect.label for part in trained.after.parts] == ["warm_up"]
