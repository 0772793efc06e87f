"""A bias model as the temperature calibration of an autopilot: its cubic, in its parameters.

Both take c0 + c1 d + c2 d² + c3 d³ of d = T - T_ref, °C, off a rate in rad/s or a specific force in m/s², in
the axes of the board, forward-right-down, and hold the correction beyond the range.  Read in one version of
each source, of ArduPilot that with a fixed reference (a development version before 4.1 took the middle of the
range):

- ArduPilot, `AP_InertialSensor_tempcal.cpp`: INS_TCALn_, T_ref is 35 °C, coefficients times 1e6, no
  constant: that is left to its own offsets, which remember the temperature that they are of.
- PX4, `temperature_compensation.cpp`: TC_Gi_ and TC_Ai_, T_ref is TREF, X0 to X3 are the powers, ID is
  that of the sensor.  The gyros' constant goes along; the accelerometers' is zero, as gravity is in it.
"""

from typing import Literal

import numpy as np

from imumon.blocks import FloatArray
from imumon.errors import bad_config, bad_data
from imumon.models.model import BiasModel

Autopilot = Literal["ardupilot", "px4"]
SUFFIX: dict[str, str] = {"ardupilot": ".param", "px4": ".params"}
LEAST_EXPORT_SPAN_DEGC = 10.0  # ArduPilot takes no calibration over less
ARDUPILOT = {"gyro": "GYR", "accel": "ACC"}  # how its parameters call the sensors
PX4 = {"gyro": "TC_G", "accel": "TC_A"}


def parameters(
    model: BiasModel, autopilot: Autopilot, imu: int, ids: tuple[int, int] | None = None
) -> tuple[str, list[str]]:
    """Return a model of `calibrate` as the parameters of an autopilot, and warnings about them.

    Raises BAD_DATA when no sensor is complete or the span is small; BAD_CONFIG when identifiers are missing.

    `autopilot`: "ardupilot" or "px4".
    `imu`: number of the inertial sensor, from 0, as the logs count.
    `ids`: PX4's device identifiers of gyro and accelerometer.
    """
    check_ids(autopilot, ids)
    sensors = [kind for kind in PX4 if all(f"{kind}_{axis}" in model.channels for axis in "xyz")]
    if not sensors:
        raise bad_data("no sensor of the model has a curve on each of x, y and z", "leave --export away")
    ranges = [model.channels[f"{kind}_{axis}"].temperature_range_degc for kind in sensors for axis in "xyz"]
    low, high = max(coldest for coldest, _ in ranges), min(hottest for _, hottest in ranges)
    if high - low < LEAST_EXPORT_SPAN_DEGC:
        raise bad_data(
            f"the channels are known from {low:.1f} to {high:.1f} °C only",
            f"an autopilot's calibration needs {LEAST_EXPORT_SPAN_DEGC:g} °C at least: calibrate over more",
        )
    notes: list[str] = []
    if model.axes is None:
        notes.append(
            "the model does not state its axes: they are taken for those of the board, forward-right-down;"
            " if they are not, the correction has the wrong sign"
        )
    if autopilot == "px4" and model.earth_rate == "included":
        notes.append("the gyros' constant holds the earth rate of the test, up to 15 °/h")
    reference = 35.0 if autopilot == "ardupilot" else 0.5 * (low + high)
    degc = np.linspace(low, high, 201)  # close enough together for any curve of a model
    cubics = {
        kind: [_cubic(model, f"{kind}_{axis}", degc, reference, notes) for axis in "xyz"] for kind in sensors
    }
    if autopilot == "px4" and ids:  # which `check_ids` has made sure of
        return _px4(cubics, imu, ids, {"TMIN": low, "TMAX": high, "TREF": reference}), notes
    return _ardupilot(cubics, imu, low, high), notes


def _ardupilot(cubics: dict[str, list[list[float]]], imu: int, low: float, high: float) -> str:
    rows = {"ENABLE": 1.0, "TMIN": low, "TMAX": high}
    rows |= {
        f"{ARDUPILOT[kind]}{k}_{axis}": cubic[k] * 1e6
        for kind, axes in cubics.items()
        for axis, cubic in zip("XYZ", axes, strict=True)
        for k in (1, 2, 3)
    }
    # It counts from 1.
    return "".join(f"INS_TCAL{imu + 1}_{name},{value:.9g}\n" for name, value in rows.items())


def _px4(cubics: dict[str, list[list[float]]], imu: int, ids: tuple[int, int], degc: dict[str, float]) -> str:
    rows: dict[str, float] = {}
    identifier = dict(zip(PX4, ids, strict=True))
    for kind, axes in cubics.items():
        sensor = PX4[kind]
        rows |= {
            f"{sensor}_ENABLE": 1,
            f"{sensor}{imu}_ID": identifier[kind],
            **{f"{sensor}{imu}_{name}": value for name, value in degc.items()},
        }
        for axis, cubic in enumerate(axes):
            coefficients = [0.0, *cubic[1:]] if kind == "accel" else cubic
            rows |= {f"{sensor}{imu}_X{power}_{axis}": value for power, value in enumerate(coefficients)}
    # The columns of QGroundControl: vehicle, component, name, value, MAVLink's type (6 integer, 9 float).
    return "".join(
        f"1\t1\t{name}\t{value:.9g}\t{6 if name.endswith(('_ENABLE', '_ID')) else 9}\n"
        for name, value in rows.items()
    )


def check_ids(autopilot: Autopilot | None, ids: tuple[int, int] | None) -> None:
    """Raise BAD_CONFIG where identifiers are needed and missing, which is known before any work."""
    if autopilot == "px4" and not ids:
        raise bad_config(
            "PX4 finds the calibration of a sensor by its identifier, which is not in the model",
            "give --device-ids GYRO ACCEL: sensor_gyro.device_id and sensor_accel.device_id of its log",
        )


def _cubic(model: BiasModel, name: str, degc: FloatArray, reference: float, notes: list[str]) -> list[float]:
    """Return the cubic of a channel in the axes of the board, from the constant up; note what it misses."""
    channel = model.channels[name]
    turned = model.axes == "FLU" and name[-1] in "yz"  # unstated axes are taken for the board's
    value = -channel.value(degc) if turned else channel.value(degc)
    coefficients = np.polynomial.polynomial.polyfit(degc - reference, value, 3)
    error = np.sqrt(np.mean((np.polynomial.polynomial.polyval(degc - reference, coefficients) - value) ** 2))
    if error > channel.residual_sd:
        notes.append(
            f"{name}: the cubic misses the curve by {error:.3g} {channel.unit} rms, more than the curve errs"
            f" ({channel.residual_sd:.3g}): calibrate over the temperatures of its work only"
        )
    return list(coefficients)
