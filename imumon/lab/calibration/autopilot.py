"""A bias model as the temperature calibration of an autopilot: its cubic, in its parameters.

Both take c0 + c1 d + c2 d² + c3 d³ of d = T - T_ref off a rate or a force, in the axes of the board,
forward-right-down, and hold the correction beyond the range.  Read in one version of each source, of
ArduPilot that with a fixed reference (a development version before 4.1 took the middle of the range):

- ArduPilot, `AP_InertialSensor_tempcal.cpp`: INS_TCALn_, T_ref is 35 °C, coefficients times 1e6, no
  constant: that is left to its own offsets, which remember the temperature that they are of.
- PX4, `temperature_compensation.cpp`: TC_Gi_ and TC_Ai_, T_ref is TREF, X0 to X3 are the powers, ID is
  that of the sensor.  The gyros' constant goes along; the accelerometers' is zero, as gravity is in it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.polynomial import Polynomial

from imumon.blocks import FloatArray
from imumon.errors import ImumonError, Reason
from imumon.models.model import BiasModel

Autopilot = Literal["ardupilot", "px4"]
SUFFIX: dict[str, str] = {"ardupilot": ".param", "px4": ".params"}
ARDUPILOT_REFERENCE_DEGC, ARDUPILOT_SCALE = 35.0, 1e6
POINTS = 201
"""Where the cubic is fitted to the curve."""
LEAST_SPAN_DEGC = 10.0
"""ArduPilot takes no calibration over less."""
INT, FLOAT = 6, 9
"""MAVLink's types of a parameter, as QGroundControl's files have them."""
KINDS = {"gyro": ("GYR", "G"), "accel": ("ACC", "A")}
TO_BOARD = {"FRD": (1.0, 1.0, 1.0), "FLU": (1.0, -1.0, -1.0), None: (1.0, 1.0, 1.0)}
"""What x, y, z of a model are times in the axes of the board; unstated ones are taken for the board's."""


@dataclass(frozen=True, slots=True)
class Exported:
    """The parameters as text, and what to know of them."""

    text: str
    notes: list[str]


@dataclass(frozen=True, slots=True)
class _Cubic:
    """The cubics of x, y, z, (3, 4) from the constant up; their range, and rms errors."""

    coefficients: FloatArray
    low: float
    high: float
    errors: dict[str, float]


def parameters(
    model: BiasModel, autopilot: Autopilot, imu: int, ids: tuple[int, int] | None = None
) -> Exported:
    """Return a model as the parameters of an autopilot.

    Raises BAD_DATA when the span is too small, or a channel has more than a curve; BAD_CONFIG when
    identifiers or gyros are missing.

    Parameters
    ----------
    autopilot : "ardupilot" or "px4"
    imu : int
        Number of the inertial sensor, from 0, as the logs count.
    ids : tuple of int, optional
        PX4's device identifiers of gyro and accelerometer.
    """
    check_ids(autopilot, ids)
    kinds = [kind for kind in KINDS if all(f"{kind}_{axis}" in model.channels for axis in "xyz")]
    if "gyro" not in kinds:
        raise ImumonError(Reason.BAD_CONFIG, "the model has not all three gyros", "calibrate all of them")
    reference = ARDUPILOT_REFERENCE_DEGC
    if autopilot == "px4":
        low, high = model.channels["gyro_x"].temperature_range_degc
        reference = 0.5 * (low + high)
    cubics = {kind: _cubic(model, kind, reference) for kind in kinds}
    if autopilot == "ardupilot":
        lines = [f"{name},{value:.9g}" for name, value in _ardupilot(cubics, imu + 1)]
    else:
        lines = [
            f"1\t1\t{name}\t{value:.9g}\t{INT if isinstance(value, int) else FLOAT}"
            for name, value in _px4(cubics, imu, reference, dict(zip(KINDS, ids or (), strict=True)))
        ]
    return Exported("\n".join(lines) + "\n", _notes(model, cubics, autopilot))


def check_ids(autopilot: Autopilot, ids: tuple[int, int] | None) -> None:
    """Raise BAD_CONFIG where identifiers are needed and missing, which is known before any work."""
    if autopilot == "px4" and ids is None:
        raise ImumonError(
            Reason.BAD_CONFIG,
            "PX4 finds the calibration of a sensor by its identifier, which is not in the model",
            "give --device-ids GYRO ACCEL: sensor_gyro.device_id and sensor_accel.device_id of its log",
        )


def _cubic(model: BiasModel, kind: str, reference: float) -> _Cubic:
    channels = [model.channels[f"{kind}_{axis}"] for axis in "xyz"]
    low = max(one.temperature_range_degc[0] for one in channels)
    high = min(one.temperature_range_degc[1] for one in channels)
    if high - low < LEAST_SPAN_DEGC:
        raise ImumonError(
            Reason.BAD_DATA,
            f"the {kind}s are known from {low:.1f} to {high:.1f} °C only",
            f"an autopilot's calibration needs {LEAST_SPAN_DEGC:g} °C at least: calibrate over more",
        )
    degc = np.linspace(low, high, POINTS)
    found, errors = [], dict[str, float]()
    for axis, channel, sign in zip("xyz", channels, TO_BOARD[model.axes], strict=True):
        if channel.effects:
            names = ", ".join(dict.fromkeys(effect.name for effect in channel.effects))
            raise ImumonError(
                Reason.BAD_DATA,
                f"{kind}_{axis} has more than a curve over temperature ({names}), which no autopilot knows",
                "export a model of imumon calibrate without effects, and see what it errs by in diagnose",
            )
        value = sign * channel.value(degc)
        cubic = Polynomial.fit(degc - reference, value, 3)
        errors[f"{kind}_{axis}"] = float(np.sqrt(np.mean((cubic(degc - reference) - value) ** 2)))
        found.append(cubic.convert().coef)
    return _Cubic(np.array([np.pad(one, (0, 4 - len(one))) for one in found]), low, high, errors)


def _ardupilot(cubics: dict[str, _Cubic], number: int) -> Iterator[tuple[str, float]]:
    head = f"INS_TCAL{number}"
    yield f"{head}_ENABLE", 1
    yield f"{head}_TMIN", max(cubic.low for cubic in cubics.values())
    yield f"{head}_TMAX", min(cubic.high for cubic in cubics.values())
    for kind, cubic in cubics.items():
        for power in (1, 2, 3):
            for axis, row in zip("XYZ", cubic.coefficients, strict=True):
                yield f"{head}_{KINDS[kind][0]}{power}_{axis}", row[power] * ARDUPILOT_SCALE


def _px4(
    cubics: dict[str, _Cubic], number: int, reference: float, ids: dict[str, int]
) -> Iterator[tuple[str, float | int]]:
    for kind, cubic in cubics.items():
        letter = KINDS[kind][1]
        head = f"TC_{letter}{number}"
        yield f"TC_{letter}_ENABLE", 1
        yield f"{head}_ID", ids[kind]
        yield f"{head}_TMIN", cubic.low
        yield f"{head}_TMAX", cubic.high
        yield f"{head}_TREF", reference
        for power in range(4):
            for axis, row in enumerate(cubic.coefficients):
                constant = power == 0 and kind == "accel"
                yield f"{head}_X{power}_{axis}", 0.0 if constant else float(row[power])


def _notes(model: BiasModel, cubics: dict[str, _Cubic], autopilot: Autopilot) -> list[str]:
    low = max(cubic.low for cubic in cubics.values())
    high = min(cubic.high for cubic in cubics.values())
    notes = [
        f"outside {low:.1f} to {high:.1f} °C the correction stands still: do not trust offsets that the"
        " autopilot finds at power-on there"
    ]
    for cubic in cubics.values():
        for name, error in cubic.errors.items():
            channel = model.channels[name]
            if error > channel.residual_sd:
                notes.append(
                    f"{name}: the cubic misses the curve by {error:.3g} {channel.unit} rms, more than the"
                    f" curve itself errs ({channel.residual_sd:.3g}): calibrate over the temperatures of its"
                    " work only"
                )
    if model.axes is None:
        notes.append(
            "the model does not say its axes: they are taken for those of the board, forward-right-down;"
            " if they are not, the correction has the wrong sign"
        )
    if autopilot == "px4" and model.earth_rate == "included":
        notes.append("the gyros' constant holds the earth rate of the test, up to 15 °/h")
    if len(model.trained_on) < 2:
        notes.append("the model is from one run: that it holds in another is not shown")
    return notes
