"""Logs of PX4 (.ulg), read with pyulog.

sensor_gyro has x, y, z in rad/s, sensor_accel in m/s², both with a temperature in °C; sensor_mag in gauss,
sensor_baro a pressure in Pa.  timestamp_sample, in µs, is the time of validity.  Axes are forward-right-down.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from imumon.blocks import IntArray
from imumon.errors import ImumonError, Reason, missing_package
from imumon.recordings.logs.log import (
    GAUSS_TO_TESLA,
    Log,
    Series,
    Wanted,
    beside,
    named,
    nanoseconds,
    pick,
    triple,
)

SCALING = "the units that uORB defines for sensor_gyro and sensor_accel"
HEAD = b"ULog\x01\x12\x35"
TOPICS = ["sensor_gyro", "sensor_accel", "sensor_mag", "sensor_baro"]
BESIDE = (
    Wanted("sensor_mag.0", [*"xyz"], triple("mag"), GAUSS_TO_TESLA),
    Wanted("sensor_baro.0", ["pressure"], ["pressure"]),
)


def is_one(_: Path, head: bytes) -> bool:
    """Tell whether a file is such a log."""
    return head.startswith(HEAD)


def read(path: Path, sensor: str | None = None) -> Log:
    """Return a gyro of a log and the accelerometer of the same number, sensor_gyro.0 the first.

    Raises
    ------
    ImumonError
        BAD_DATA when it has no sensor_gyro; BAD_CONFIG when not this one.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise missing_package("this log", "pyulog", "autopilot") from error
    try:
        with path.open("rb") as file:  # given a name, pyulog leaves it open when the log is damaged
            log = ULog(file, TOPICS)
    except Exception as error:  # pyulog raises whatever damaged bytes lead to
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read as a ULog: {error}") from error
    found = {f"{one.name}.{one.multi_id}": one.data for one in log.data_list}
    gyros = sorted(name for name in found if name.startswith("sensor_gyro."))
    name, others = pick(path, gyros, sensor)
    gyro = named(found[name], [*"xyz", "temperature"], [*triple("gyro"), "temperature"])
    accel = Wanted(f"sensor_accel.{name.rpartition('.')[2]}", [*"xyz"], triple("accel"))
    joined = beside(found, (accel, *BESIDE), _time)
    return Log(name, others, Series(_time(found[name]), gyro), joined, "FRD", SCALING)


def _time(fields: Any) -> IntArray:
    """Return the times of validity in ns, else of logging."""
    sampled = fields.get("timestamp_sample")
    return nanoseconds(sampled if sampled is not None and sampled.any() else fields["timestamp"])
