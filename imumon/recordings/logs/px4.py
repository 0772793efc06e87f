"""Logs of PX4 (.ulg), read with pyulog.

sensor_gyro has x, y, z in rad/s, sensor_accel in m/s², both with a temperature in °C; sensor_mag in gauss,
sensor_baro a pressure in Pa.  timestamp_sample, in µs, is the time of validity.  Axes are forward-right-down.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import NO_INT
from imumon.errors import ImumonError, Reason
from imumon.recordings.logs.log import GAUSS_TO_TESLA, UNITS, Log, Series, named, needs, pick, triple

HEAD = b"ULog\x01\x12\x35"
MICROSECOND_NS = 1000
EXACT = 2**53
"""µs; a later time is damage."""
TOPICS = ["sensor_gyro", "sensor_accel", "sensor_mag", "sensor_baro"]


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
        raise needs("pyulog", "autopilot", error) from error
    try:
        with path.open("rb") as file:  # given a name, pyulog leaves it open when the log is damaged
            log = ULog(file, TOPICS)
    except Exception as error:  # pyulog raises whatever damaged bytes lead to
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read as a ULog: {error}") from error
    found = {f"{one.name}.{one.multi_id}": one.data for one in log.data_list}
    gyros = sorted(name for name in found if name.startswith("sensor_gyro."))
    name = pick(path, gyros, sensor)
    number = name.rpartition(".")[2]
    gyro = named(found[name], [*"xyz", "temperature"], [*triple("gyro"), "temperature"])
    beside = []
    for topic, names, targets, scale in (
        (f"sensor_accel.{number}", [*"xyz"], triple("accel"), 1.0),
        ("sensor_mag.0", [*"xyz"], triple("mag"), GAUSS_TO_TESLA),
        ("sensor_baro.0", ["pressure"], ["pressure"], 1.0),
    ):
        if topic in found:
            beside.append(Series(_time(found[topic]), named(found[topic], names, targets, scale)))
    others = [one for one in gyros if one != name]
    return Log(name, others, Series(_time(found[name]), gyro), beside, UNITS, "FRD")


def _time(fields: Any) -> Any:
    """Return the time of validity in ns, else of logging; of a damaged row the earliest there is."""
    sampled = fields.get("timestamp_sample")
    time_us = sampled if sampled is not None and sampled.any() else fields["timestamp"]
    there = time_us < EXACT
    return np.where(there, np.where(there, time_us, 0).astype(np.int64) * MICROSECOND_NS, NO_INT)
