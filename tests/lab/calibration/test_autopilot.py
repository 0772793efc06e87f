"""A bias model in the parameters of an autopilot corrects as the model does."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.errors import ImumonError, Reason
from imumon.geodesy import DEG_PER_H
from imumon.lab.calibration.autopilot import Autopilot, parameters
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.model import BiasModel, ChannelModel

DEGC = np.linspace(-10.0, 60.0, 300)
UNITS = {"gyro": "rad/s", "accel": "m/s^2"}


def curve(degree: int, scale: float) -> FloatArray:
    u = (DEGC - 20.0) / 40.0
    return np.asarray(
        scale * (1.0 + u - 0.5 * u**2 + 0.3 * u**3 + (2.0 * np.sin(6.0 * u) if degree > 3 else 0.0))
    )


def model(degree: int = 3, kinds: str = "gyro accel", span: tuple[float, float] = (-10.0, 60.0)) -> BiasModel:
    channels = {}
    for kind in kinds.split():
        for number, axis in enumerate("xyz"):
            scale = (number + 1.0) * (30.0 * DEG_PER_H if kind == "gyro" else 0.01)
            points = Points(DEGC, curve(degree, scale), np.ones(len(DEGC)), np.zeros(len(DEGC), np.int64))
            channels[f"{kind}_{axis}"] = ChannelModel.model_validate(
                {
                    "unit": UNITS[kind],
                    "temperature_column": "temperature",
                    "temperature_range_degc": list(span),
                    "residual_sd": 0.01 * scale,
                    "curve": fit_polynomial(points, 9 if degree > 3 else 3),
                }
            )
    return BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels=channels)


def incomplete() -> BiasModel:
    """Return a model without the x axis of its only sensor."""
    unit = model(kinds="gyro")
    return unit.model_copy(update={"channels": {name: unit.channels[name] for name in ("gyro_y", "gyro_z")}})


def of_ardupilot(text: str) -> dict[str, float]:
    return {name: float(value) for name, value in (line.split(",") for line in text.splitlines())}


def of_px4(text: str) -> dict[str, tuple[float, int]]:
    rows = [line.split("\t") for line in text.splitlines()]
    assert all(row[:2] == ["1", "1"] for row in rows)
    return {row[2]: (float(row[3]), int(row[4])) for row in rows}


def test_ardupilot_corrects_from_one_temperature_to_another_as_the_model_does() -> None:
    unit = model()
    found = of_ardupilot(parameters(unit, "ardupilot", 1)[0])
    assert found["INS_TCAL2_ENABLE"] == 1.0
    assert (found["INS_TCAL2_TMIN"], found["INS_TCAL2_TMAX"]) == (-10.0, 60.0)
    for kind, name in (("gyro", "GYR"), ("accel", "ACC")):
        for axis in "xyz":
            c = [found[f"INS_TCAL2_{name}{power}_{axis.upper()}"] * 1e-6 for power in (1, 2, 3)]
            for now, calibrated in ((-5.0, 25.0), (50.0, 25.0), (35.0, 0.0)):
                taken = np.polyval([*c[::-1], 0.0], now - 35.0) - np.polyval(
                    [*c[::-1], 0.0], calibrated - 35.0
                )
                channel = unit.channels[f"{kind}_{axis}"]
                expected = channel.value(now) - channel.value(calibrated)
                assert taken == pytest.approx(float(expected), abs=0.02 * channel.residual_sd)


def test_a_unit_of_other_axes_is_turned_into_those_of_the_board() -> None:
    """Both autopilots are forward-right-down: y and z of a forward-left-up unit point the other way."""
    frd, flu = (model().model_copy(update={"axes": axes}) for axes in ("FRD", "FLU"))
    for kind, name in (("gyro", "GYR"), ("accel", "ACC")):
        board, unit = (of_ardupilot(parameters(one, "ardupilot", 0)[0]) for one in (frd, flu))
        for axis, sign in zip("XYZ", (1.0, -1.0, -1.0), strict=True):
            for power in (1, 2, 3):
                key = f"INS_TCAL1_{name}{power}_{axis}"
                assert unit[key] == sign * board[key] != 0.0, (kind, key)
    board4, unit4 = (of_px4(parameters(one, "px4", 0, (1, 2))[0]) for one in (frd, flu))
    for number, sign in enumerate((1.0, -1.0, -1.0)):
        assert unit4[f"TC_G0_X0_{number}"][0] == sign * board4[f"TC_G0_X0_{number}"][0] != 0.0


def test_axes_that_nobody_stated_are_reported() -> None:
    unstated = parameters(model(), "ardupilot", 0)[1]
    assert any("does not state its axes" in note for note in unstated)
    stated = parameters(model().model_copy(update={"axes": "FRD"}), "ardupilot", 0)[1]
    assert not any("axes" in note for note in stated)


def test_px4_has_the_constant_of_gyros_and_none_of_accelerometers() -> None:
    unit = model()
    found = of_px4(parameters(unit, "px4", 0, (2490378, 2621450))[0])
    assert found["TC_G0_ID"] == (2490378.0, 6)
    assert found["TC_A0_ID"] == (2621450.0, 6)
    assert found["TC_G0_TREF"] == (25.0, 9)
    channel = unit.channels["gyro_y"]
    for now in (-5.0, 25.0, 55.0):
        taken = sum(found[f"TC_G0_X{power}_1"][0] * (now - 25.0) ** power for power in range(4))
        assert taken == pytest.approx(float(channel.value(now)), abs=0.02 * channel.residual_sd)
    force = unit.channels["accel_z"]
    taken = sum(found[f"TC_A0_X{power}_2"][0] * 30.0**power for power in range(4))
    assert taken == pytest.approx(float(force.value(55.0) - force.value(25.0)), abs=0.02 * force.residual_sd)


def test_px4_has_the_identifier_of_the_accelerometers_where_the_gyros_have_no_curve() -> None:
    found = of_px4(parameters(model(kinds="accel"), "px4", 0, (2490378, 2621450))[0])
    assert found["TC_A0_ID"] == (2621450.0, 6)
    assert "TC_G0_ID" not in found


@pytest.mark.parametrize(
    ("unit", "autopilot", "said"),
    [
        (model(span=(20.0, 28.0)), "ardupilot", "known from 20.0 to 28.0 °C only"),
        (model(), "px4", "finds the calibration of a sensor by its identifier"),
        (incomplete(), "ardupilot", "no sensor of the model has a curve on each of x, y and z"),
    ],
)
def test_what_an_autopilot_could_not_use_is_refused(unit: BiasModel, autopilot: Autopilot, said: str) -> None:
    with pytest.raises(ImumonError, match=said) as refused:
        parameters(unit, autopilot, 0)
    assert refused.value.reason in (Reason.BAD_DATA, Reason.BAD_CONFIG)
    assert refused.value.hint


def test_a_cubic_that_misses_the_curve_is_reported() -> None:
    notes = parameters(model(degree=9), "ardupilot", 0)[1]
    assert sum("the cubic misses the curve by" in note for note in notes) == 6
