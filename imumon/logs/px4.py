"""Logs of PX4 (.ulg), read with pyulog.

sensor_gyro has x, y, z in rad/s, sensor_accel in m/s², both with a temperature in °C; sensor_mag in gauss,
sensor_baro a pressure in Pa, before v1.14 in millibar.  timestamp_sample, in µs, is the time of validity.
Axes are forward-right-down.
"""

import io
import struct
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from imumon.blocks import IntArray
from imumon.errors import bad_data, missing_package
from imumon.files import readable
from imumon.recordings.map import triple

from .log import GAUSS_TO_TESLA, Damage, Log, Series, beside, named, nanoseconds, pick

SCALING = "the units that uORB defines for sensor_gyro and sensor_accel"
HEAD = b"ULog\x01\x12\x35"
TOPICS = ["sensor_gyro", "sensor_accel", "sensor_mag", "sensor_baro"]
FILE_HEAD = 16
MESSAGE = struct.Struct("<HB")
"""What a message begins with: bytes of its content, and its kind."""
FLAGS, SUBSCRIPTION, DATA = b"BAD"
KINDS = frozenset(b"BFIMPQARDLCSO")
LARGEST = 10_000
"""A message is smaller; pyulog has the same limit."""
OFFSETS = slice(MESSAGE.size + 16, MESSAGE.size + 40)
"""Where FLAGS states that data was appended after a crash; they are messages as all others."""
SURE = 2
"""So many messages must follow one behind a damaged place; behind a good one it is one."""
MILLIBAR_TO_PASCAL = 100.0
LEAST_PASCAL = 1200.0
"""Below, a pressure is in millibar: 1200 Pa are 30 km up, and no weather on the ground has 1200 millibar."""


def read(path: Path, sensor: str | None = None) -> Log:
    """Return a gyro of a log and the accelerometer of the same number, sensor_gyro.0 the first.

    Raises BAD_DATA when it has no sensor_gyro; BAD_CONFIG when not this one.
    """
    try:
        from pyulog import ULog
    except ModuleNotFoundError as error:
        raise missing_package("this log", "pyulog", "autopilot") from error
    with readable(path):
        recorded = path.read_bytes()
    try:
        data, damage = _mended(recorded)
        with redirect_stdout(io.StringIO()):  # where it prints what it makes of damage
            log = ULog(io.BytesIO(data), TOPICS)
    except Exception as error:  # pyulog raises whatever damaged bytes lead to
        raise bad_data(f"{path}: cannot be read as a ULog: {error}") from error
    found = {f"{one.name}.{one.multi_id}": one.data for one in log.data_list}
    gyros = sorted(name for name in found if name.startswith("sensor_gyro."))
    name, others = pick(path, gyros, sensor, damage)
    gyro = named(found[name], ["x", "y", "z", "temperature"], [*triple("gyro"), "temperature"])
    accel = found.get(name.replace("gyro", "accel"))
    mag = beside(found.get("sensor_mag.0"), _time, "xyz", triple("mag"), GAUSS_TO_TESLA)
    # The log does not state the unit of the barometer, and firmwares differ.
    pressure = np.asarray(found.get("sensor_baro.0", {}).get("pressure", ()), np.float64)
    pressure = pressure[np.isfinite(pressure)]
    unit = MILLIBAR_TO_PASCAL if len(pressure) and np.median(pressure) < LEAST_PASCAL else 1.0
    baro = beside(found.get("sensor_baro.0"), _time, ["pressure"], ["pressure"], unit)
    joined = [*beside(accel, _time, "xyz", triple("accel")), *mag, *baro]
    return Log(name, others, Series(_time(found[name]), gyro), joined, "FRD", SCALING, damage)


def _mended(data: bytes) -> tuple[bytearray, Damage]:
    """Return a log without its damaged places: a size that is wrong there would end pyulog's reading."""
    subscribed, mended, damage, good = set[bytes](), bytearray(data[:FILE_HEAD]), Damage(), FILE_HEAD

    def is_message(at: int, more: int) -> bool:
        if at + MESSAGE.size > len(data):
            return at == len(data)
        size, kind = MESSAGE.unpack_from(data, at)
        begin, end = at + MESSAGE.size, at + MESSAGE.size + size
        if kind not in KINDS or size > LARGEST or end > len(data):
            return False
        if kind == SUBSCRIPTION:
            subscribed.add(data[begin + 1 : begin + 3])
        elif kind == DATA and data[begin : begin + 2] not in subscribed:
            return False
        return more == 0 or is_message(end, more - 1)

    at = good
    while at < len(data):
        if not is_message(at, 1 if at == good else SURE):
            at += 1
            continue
        damage = damage.and_at(good, at)
        size, kind = MESSAGE.unpack_from(data, at)
        good = at + MESSAGE.size + size
        message = bytearray(data[at:good])
        if kind == FLAGS:
            message[OFFSETS] = bytes(len(message[OFFSETS]))
        mended += message
        at = good
    return mended, damage.and_at(good, len(data))


def _time(fields: Any) -> IntArray:
    """Return the times of validity in ns, else of logging."""
    sampled = fields.get("timestamp_sample")
    return nanoseconds(sampled if sampled is not None and sampled.any() else fields["timestamp"])
