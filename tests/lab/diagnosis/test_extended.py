"""What the extended model states of itself: how far it is off, and how well its curve is known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.effects.base import Scale
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.effects.vibration import SECOND_NS
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model, refitted
from imumon.lab.diagnosis.live import better_models
from imumon.lab.diagnosis.runs import Origin, Run
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import ChannelModel, TrainedOn
from tests.lab.diagnosis.test_live import model
from tests.lab.diagnosis.units import DPH, ramps, run, three

SECONDS = 3000


def jump(time: FloatArray, _: FloatArray) -> FloatArray:
    return np.where(time > 1500.0, 60.0, 0.0)


def test_a_declared_model_alone_is_off_by_the_jump_that_goes_on_in_the_test() -> None:
    """It stated what the test was left with where that jump was known."""
    whole = replace(run(1, *ramps(2 * SECONDS, True), jump), start_ns=0)

    def part(start: int, stop: int) -> Run:
        mean, variance, count = (
            {name: values[start:stop] for name, values in one.items()}
            for one in (whole.mean, whole.variance, whole.count)
        )
        return replace(
            whole,
            name=f"from {start} s",
            time_s=whole.time_s[: stop - start],
            mean=mean,
            variance=variance,
            count=count,
            rest=whole.rest[start:stop],
            start_ns=start * SECOND_NS,
        )

    diagnosis = diagnose([part(0, SECONDS)], [part(SECONDS, 2 * SECONDS)])
    (verdict,) = diagnosis.verdicts
    assert [claim.finding.name for claim in verdict.claims] == ["step"]
    assert verdict.test_after.continues_training
    assert not verdict.predicts
    assert verdict.prediction.rms < 0.2 * verdict.test_before.rms
    stated = extended_model(diagnosis).channels["gyro_x"].residual_sd
    assert stated == pytest.approx(verdict.test_before.rms, rel=0.05)


def test_the_constant_of_a_curve_is_the_mean_over_runs_and_its_sigma_that_of_the_mean() -> None:
    """It was that of the first run's constant: larger by the root of the number of runs."""
    train, test = three(lambda time, _: np.zeros_like(time), 2400)
    train += [replace(one, name=f"{one.name} again") for one in train]
    (verdict,) = diagnose(train, test, "polynomial 3 + offset").verdicts
    base = verdict.channel.base
    of_constant = np.eye(base.shape[1])[0] + np.array([0.0] * 4 + [0.25] * 3)
    white = verdict.channel.floor.sd * np.linalg.norm(of_constant @ np.linalg.pinv(base))
    assert np.sqrt(verdict.declared_covariance[0, 0]) == pytest.approx(white, rel=0.3)
    assert (
        abs(verdict.after.declared[0] - 30.0 * DPH) < 4.0 * np.sqrt(verdict.declared_covariance[0, 0]) + DPH
    )


@pytest.mark.parametrize("spline", [True, False])
def test_a_present_polynomial_of_too_high_a_degree_for_a_curve_stays_an_effect(spline: bool) -> None:
    """The model with it could not be written, though this package had made it."""
    high = TemperatureCurve(middle=26.0, half_span=14.0, first_power=9, powers=6, coefficients=[1e-5] * 6)
    present = model().channels["gyro_x"].model_copy(update={"effects": [high]})
    if spline:
        knots, values = [10.0, 20.0, 42.0], [1e-5, 2e-5, 1e-5]
        curve = SplineCurve(knots_degc=knots, values=values, slopes=[0.0] * 3)
        present = present.model_copy(update={"curve": curve})
    channel: Any = SimpleNamespace(scale=Scale(26.0, 14.0))
    fitted: Any = SimpleNamespace(declared=np.array([0.0, 1e-6]), parts=[])
    found = refitted(present, channel, fitted, 1e-6)
    assert high in found.effects
    assert ChannelModel.model_validate(found.model_dump()) == found
    shapes = [shape for effect in found.effects if (shape := effect.polynomial()) is not None]
    for u in (-0.5, 0.9):
        bias = float(found.curve.value(26.0 + 14.0 * u)) + sum(
            float(shape(26.0 + 14.0 * u)) for shape in shapes
        )
        expected = float(present.curve.value(26.0 + 14.0 * u)) + 1e-6 * u
        expected += sum(1e-5 * u**power for power in range(9, 15))
        assert bias == pytest.approx(expected, rel=1e-9)


def bent(time: FloatArray, degc: FloatArray) -> FloatArray:
    """Return an earth rate, a curve that has to be fitted anew, and a lack."""
    return 12.0 + 20.0 * ((degc - 25.0) / 15.0) ** 2 + 40.0 * np.sin(2.0 * np.pi * time / 700.0)


@pytest.mark.long
@pytest.mark.parametrize("removed", [True, False])
def test_the_earth_rate_of_the_data_goes_into_no_model_that_has_none(removed: bool) -> None:
    """The constant was that of the data, and the file still had: removed."""
    present = model().model_copy(update={"earth_rate": "removed" if removed else "included"})
    train, test = three(bent, 2400)
    found = extended_model(diagnose(train, test, model=present))
    (live,) = better_models(run(1, *ramps(3000, True), bent), present, ["gyro_x"])
    before, degc = present.channels["gyro_x"].curve, 26.0
    for channel in (found.channels["gyro_x"], live.model):
        change = float(channel.curve.value(degc) - before.value(degc)) / DPH
        assert abs(change) < 1.5 if removed else change > 8.0


def test_channels_of_the_present_model_that_are_not_diagnosed_stay() -> None:
    """They were dropped."""
    earlier = TrainedOn(
        session="S", sha256="0" * 64, rest_s=1.0, blocks=1, temperature_range_degc=[10.0, 42.0]
    )
    channels = {"gyro_z": model().channels["gyro_x"], **model().channels}
    present = model().model_copy(update={"channels": channels, "trained_on": [earlier]})
    train, test = three(lambda time, _: np.zeros_like(time), 2400)
    found = extended_model(diagnose(train, test, model=present))
    assert found.channels.keys() == channels.keys()
    assert found.channels["gyro_z"] == channels["gyro_z"]
    assert found.trained_on == [earlier]


def test_a_model_of_another_unit_is_reported() -> None:
    train, test = three(lambda time, _: np.zeros_like(time), 2400)
    test = [replace(one, origin=Origin("S", 0, "0" * 64, serial="7")) for one in test]
    caveats = diagnose(train, test, model=model().model_copy(update={"serial": "8"})).caveats
    assert "the bias model is of unit 8, this is 7" in caveats
