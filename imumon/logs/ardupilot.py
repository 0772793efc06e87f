"""DataFlash logs of ArduPilot (.BIN): messages without checksum, described by messages FMT among them.

A message is A3 95, its number, and its fields; FMT (number 128) has number, length, name, types and names of
the fields of another one.  IMU has TimeUS in µs, the number of the sensor I, GyrX to GyrZ in rad/s, AccX to
AccZ in m/s², T in °C (before 4.1 each sensor has a message of its own: IMU, IMU2, IMU3); MAG the field in
mGauss and BARO the pressure Press in Pa.  Axes are
forward-right-down.  Source: AP_Logger/LogStructure.h.
"""

import struct
from collections import defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import IntArray
from imumon.files import readable
from imumon.recordings.map import triple

from .log import GAUSS_TO_TESLA, Damage, Log, Series, beside, named, nanoseconds, pick

SCALING = "the units that DataFlash defines for IMU"
GYRO = "GyrX", "GyrY", "GyrZ"
MAG = "MagX", "MagY", "MagZ"
MARK = b"\xa3\x95"
FORMAT = 128
HEAD = MARK + bytes([FORMAT])
"""A log begins with a message that describes the format of another."""
DESCRIPTION = struct.Struct("<BB4s16s64s")
TYPES = {
    "b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "d": "<f8",
    "c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4", "M": "u1",
    "q": "<i8", "Q": "<u8", "g": "<f2",
}  # fmt: skip
"""NumPy's of each type of a number: what is kept has no texts and arrays."""
SENSORS = {"IMU": ("IMU", 0), "IMU2": ("IMU", 1), "IMU3": ("IMU", 2), "MAG": ("MAG", 0), "BARO": ("BARO", 0)}
"""Of the messages that are kept the kind, and the number of the sensor where none (field I) is in them."""
BLOCK = 256
"""The last page of a log that was written in pages is filled up (AP_Logger_Block)."""


def read(path: Path, sensor: str | None = None) -> Log:
    """Return a sensor of a log, by its number, IMU.0 the first.

    Raises BAD_DATA when it has no IMU messages; BAD_CONFIG when not of this sensor.
    """
    found, damage = _messages(path)
    imus = sorted(name for name in found if name.startswith("IMU.") and found[name].keys() >= {*GYRO})
    name, others = pick(path, imus, sensor, damage)
    imu = found[name]
    gyro = named(imu, [*GYRO, "AccX", "AccY", "AccZ"], [*triple("gyro"), *triple("accel")])
    # A sensor without a thermometer reads 0 all the time.
    if np.any(imu.get("T", 0.0)):
        gyro |= named(imu, ["T"], ["temperature"])
    mag = beside(found.get("MAG.0"), _time, MAG, triple("mag"), 1e-3 * GAUSS_TO_TESLA)
    baro = beside(found.get("BARO.0"), _time, ["Press"], ["pressure"])
    return Log(name, others, Series(_time(imu), gyro), [*mag, *baro], "FRD", SCALING, damage)


class _Format(NamedTuple):
    """How messages of a number are read."""

    length: int  # of a message, with its head
    name: str
    fields: Any = None  # NumPy's type of its content, where that is kept


def _described(description: bytes) -> tuple[int, _Format]:
    """Return the number that a message FMT describes, and how it is read.

    Raises ValueError or KeyError when it describes nothing that can be.
    """
    number, length, *texts = DESCRIPTION.unpack(description)
    name, types, columns = (text.split(b"\0")[0].decode("ascii") for text in texts)
    fields, size = None, length - len(HEAD)
    if name in SENSORS:
        fields = np.dtype({"names": columns.split(","), "formats": [TYPES[one] for one in types]})
    if size < 0 or number == FORMAT or (fields is not None and size != fields.itemsize):
        raise ValueError(f"{name}: {length} bytes")
    return number, _Format(length, name, fields)


def _messages(path: Path) -> tuple[dict[str, dict[str, Any]], Damage]:
    """Return the fields of the messages that are kept, by name and number of the sensor, and the damage."""
    with readable(path):
        data = path.read_bytes()
    formats = {FORMAT: _Format(len(HEAD) + DESCRIPTION.size, "FMT")}
    contents, damage, good = defaultdict[_Format, bytearray](bytearray), Damage(), 0
    for at, known in _walk(data, formats):
        damage = damage.and_at(good, at)
        good = at + known.length
        content = data[at + len(HEAD) : good]
        if data[at + len(MARK)] == FORMAT:
            with suppress(ValueError, KeyError):  # damaged, or of itself: its messages are of no known format
                formats.update([_described(content)])
        elif known.fields is not None:
            contents[known] += content
    tail = data[good : good + len(HEAD)]
    # The beginning of another message, which was cut.
    is_begun = MARK.startswith(tail[:2]) and (len(tail) < len(HEAD) or tail[2] in formats)
    if len(data) - good >= BLOCK or is_begun:
        damage = damage.and_at(good, len(data))
    found = {}
    for known, joined in contents.items():
        table, (name, alone) = np.frombuffer(joined, known.fields), SENSORS[known.name]
        columns = {"TimeUS": np.full(len(table), np.nan), "I": np.full(len(table), alone)}
        columns |= {field: table[field] for field in known.fields.names}
        for number in np.unique(columns["I"]).tolist():
            own = columns["I"] == number
            found[f"{name}.{number}"] = {field: values[own] for field, values in columns.items()}
    return found, damage


def _walk(data: bytes, formats: Mapping[int, _Format]) -> Iterator[tuple[int, _Format]]:
    """Yield where a message begins, and its format; `formats` may grow meanwhile.

    A message counts when another one begins where it ends, or none does behind it.
    """
    at = 0
    while 0 <= (at := data.find(MARK, at)) < len(data) - len(MARK):
        known = formats.get(data[at + len(MARK)])
        end = len(data) + 1 if known is None else at + known.length
        if known is None or end > len(data) or (data[end : end + 2] != MARK and data.find(MARK, end) >= 0):
            at += 1
            continue
        yield at, known
        at = end


def _time(fields: dict[str, Any]) -> IntArray:
    return nanoseconds(fields["TimeUS"])
