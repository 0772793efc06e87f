"""DataFlash logs of ArduPilot (.BIN): messages without checksum, described by messages FMT among them.

A message is A3 95, its number, and its fields; FMT (number 128) has number, length, name, types and names of
the fields of another one.  IMU has TimeUS in µs, the number of the sensor I, GyrX to GyrZ in rad/s, AccX to
AccZ in m/s², T in °C (before 4.1 each sensor has a message of its own: IMU, IMU2, IMU3); MAG the field in
mGauss and BARO the pressure Press in Pa.  Axes are
forward-right-down.  Source: AP_Logger/LogStructure.h.
"""

import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import IntArray
from imumon.files import readable
from imumon.logs import log
from imumon.logs.log import Damage, Log, Series, named, triple

SCALING = "the units that DataFlash defines for IMU"
MARK = b"\xa3\x95"
FORMAT = 128
HEAD = MARK + bytes([FORMAT])
"""A log begins with a message that describes the format of another."""
DESCRIPTION = struct.Struct("<BB4s16s64s")
TYPES = {
    "a": ("64s", 0.0), "b": ("b", 1.0), "B": ("B", 1.0), "h": ("h", 1.0), "H": ("H", 1.0), "i": ("i", 1.0),
    "I": ("I", 1.0), "f": ("f", 1.0), "d": ("d", 1.0), "n": ("4s", 0.0), "N": ("16s", 0.0), "Z": ("64s", 0.0),
    "c": ("h", 0.01), "C": ("H", 0.01), "e": ("i", 0.01), "E": ("I", 0.01), "L": ("i", 1e-7), "M": ("B", 1.0),
    "q": ("q", 1.0), "Q": ("Q", 1.0), "g": ("e", 1.0),
}  # fmt: skip
"""Of each type its code for `struct`, and what a number is times; 0 where it is none."""
KEPT = {
    "IMU": ("TimeUS", "GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T"),
    "MAG": ("TimeUS", "MagX", "MagY", "MagZ"),
    "BARO": ("TimeUS", "Press"),
}
NUMBER = "I"
OWN = {"IMU2": ("IMU", 1), "IMU3": ("IMU", 2)}
"""Messages that are of one sensor, in logs whose messages have no number of it."""
BLOCK = 256
"""The last page of a log that was written in pages is filled up (AP_Logger_Block)."""
BESIDE = (
    log.Wanted("MAG.0", ["MagX", "MagY", "MagZ"], triple("mag"), 1e-3 * log.GAUSS_TO_TESLA),
    log.Wanted("BARO.0", ["Press"], ["pressure"]),
)


def read(path: Path, sensor: str | None = None) -> Log:
    """Return a sensor of a log, by its number, IMU.0 the first.

    Raises BAD_DATA when it has no IMU messages; BAD_CONFIG when not of this sensor.
    """
    found, damage = _messages(path)
    imus = sorted(name for name in found if name.startswith("IMU."))
    name, others = log.pick(path, imus, sensor, damage)
    imu = found[name]
    gyro = named(imu, ["GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ"], [*triple("gyro"), *triple("accel")])
    # A sensor without a thermometer reads 0 all the time.
    if np.any(imu["T"] != 0.0):
        gyro |= named(imu, ["T"], ["temperature"])
    return Log(
        name, others, Series(_time(imu), gyro), log.beside(found, BESIDE, _time), "FRD", SCALING, damage
    )


class _Format(NamedTuple):
    """How messages of a number are read."""

    length: int
    """Of a message, with its head."""
    name: str
    layout: struct.Struct = DESCRIPTION
    """Of its fields, where some are kept."""
    kept: tuple[tuple[int, float] | None, ...] = ()
    """Of each value that is kept its place among the fields, and its factor; None where it is absent."""
    number: int | None = None
    """Where the number of the sensor stands."""
    sensor: int = 0
    """Its number where none stands."""

    def row(self, data: bytes, at: int) -> tuple[str, list[float]]:
        """Return name and number of the sensor of the message that begins there, and what is kept of it."""
        values = self.layout.unpack_from(data, at + len(HEAD))
        sensor = self.sensor if self.number is None else values[self.number]
        kept = [np.nan if one is None else values[one[0]] * one[1] for one in self.kept]
        return f"{self.name}.{sensor}", kept


def _described(description: bytes) -> tuple[int, _Format]:
    """Return the number that a message FMT describes, and how it is read.

    Raises ValueError when it describes nothing that can be.
    """
    number, length, *texts = DESCRIPTION.unpack(description)
    name, types, columns = (text.split(b"\0")[0].decode("ascii") for text in texts)
    if length < len(HEAD) or number == FORMAT:
        raise ValueError(f"{name}: {length} bytes")
    name, sensor = OWN.get(name, (name, 0))
    if name not in KEPT:
        return number, _Format(length, name)
    names = columns.split(",")
    if not set(types) <= set(TYPES) or len(names) != len(types):
        raise ValueError(f"{name}: {types}")
    layout = struct.Struct("<" + "".join(TYPES[one][0] for one in types))
    if length != len(HEAD) + layout.size:
        raise ValueError(f"{name}: {length} bytes")
    at = {one: (k, TYPES[types[k]][1]) for k, one in enumerate(names)}
    kept = tuple(at.get(one) for one in KEPT[name])
    return number, _Format(length, name, layout, kept, at[NUMBER][0] if NUMBER in at else None, sensor)


def _messages(path: Path) -> tuple[dict[str, dict[str, Any]], Damage]:
    """Return the fields of the messages that are kept, by name and number of the sensor, and the damage."""
    with readable(path):
        data = path.read_bytes()
    formats = {FORMAT: _Format(len(HEAD) + DESCRIPTION.size, "FMT")}
    rows, damage, good = dict[str, list[list[float]]](), Damage(), 0
    for at, known in _walk(data, formats):
        end = at + known.length
        damage = damage.and_at(good, at)
        good = end
        if data[at + len(MARK)] == FORMAT:
            try:
                number, made = _described(data[at + len(HEAD) : end])
            except ValueError:
                continue  # of itself, or damaged: then its messages are of no known format
            formats[number] = made
        elif known.kept:
            name, row = known.row(data, at)
            rows.setdefault(name, []).append(row)
    tail = data[good : good + len(HEAD)]
    # The beginning of another message, which was cut.
    is_begun = MARK.startswith(tail[:2]) and (len(tail) < len(HEAD) or tail[2] in formats)
    if len(data) - good >= BLOCK or is_begun:
        damage = damage.and_at(good, len(data))
    return {
        name: dict(zip(KEPT[name.partition(".")[0]], np.array(found, np.float64).T, strict=True))
        for name, found in rows.items()
    }, damage


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
    return log.nanoseconds(fields["TimeUS"])
