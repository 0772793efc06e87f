"""Blackbox logs of Betaflight and its relatives, as the CSV that blackbox_decode makes.

time is in µs; gyroADC is the rate behind the filters of the firmware and gyroUnfilt before them, accSmooth
the specific force, in raw numbers.  The scale is in the "H" lines of the log itself, which blackbox_decode
does not copy: they are taken from the head of the table, else from the log beside it.  Axes are
forward-left-up.
"""

import io
import math
import re
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from imumon.blocks import FloatArray
from imumon.errors import bad_config, bad_data
from imumon.files import readable
from imumon.geodesy import STANDARD_GRAVITY
from imumon.recordings.map import triple

from .log import Damage, Log, Series, named, nanoseconds, pick

BEGIN = b"H Product:Blackbox"
TABLE = re.compile(rb"\s*loopIteration\s*,\s*time \(")
TIME = "time (us)"
LINE = re.compile(rb"H ([^:\n]+):([^\r\n]*)\r?\n")
LOGS = (".bbl", ".bfl", ".txt", ".cfl")
GYROS = ("gyroADC", "gyroUnfilt")
FIRMWARES = ("Cleanflight", "Betaflight", "INAV", "EmuFlight")
"""Whose gyro_scale is in °/s; that of Baseflight is not, and of others it is not known."""
HIGH_RESOLUTION = 10.0
"""With blackbox_high_resolution the firmware writes rates times this (its blackbox.c), which blackbox_decode
leaves as they are."""
HINT = (
    "leave the log beside the table (LOG.bbl beside LOG.01.csv, as blackbox_decode does), put its lines that"
    " begin with H at the head of the table, or give --map MAP.yaml with the units"
)
Lines = Mapping[str, str]
"""The H lines of a log: its settings by name."""


def read(path: Path, sensor: str | None = None) -> Log:
    """Return the gyro of a table, gyroADC unless gyroUnfilt is requested, and accSmooth.

    Raises BAD_DATA when it cannot be read; BAD_CONFIG when it was not decoded, when the scale of its gyro
    is not stated, or it has no such gyro.
    """
    with readable(path):
        data = path.read_bytes()
    settings, begin = _settings(data)
    end = data.find(b"\n", begin) + 1 or len(data)
    if TABLE.match(data, begin) is None:
        raise bad_config(f"{path}: is a blackbox log as it was recorded", f"blackbox_decode {path}")
    titles = [title.strip() for title in data[begin:end].decode(errors="replace").split(",")]
    gyros = [one for one in GYROS if set(_parts(one)) <= set(titles)]
    if TIME not in titles or not gyros:
        raise bad_config(
            f"{path}: has no {TIME}, or no {_parts(GYROS[0])[0]} of raw numbers",
            "decode the log without options for units, or give --map MAP.yaml",
        )
    name, others = pick(path, gyros, sensor)
    lines, source = (settings, f"the head of {path.name}") if settings else _beside(path)
    force = _parts("accSmooth") if set(_parts("accSmooth")) <= set(titles) else []
    values, damage = _read_table(path, data[end:], titles, [TIME, *_parts(name), *force])
    rate, remark = _rate_scale(path, lines)
    gyro = named(values, _parts(name), triple("gyro"), rate)
    one_g = lines.get("acc_1G", "")
    if force and one_g.isdecimal() and int(one_g):
        gyro |= named(values, force, triple("accel"), STANDARD_GRAVITY / int(one_g))
        remark += f", accelerometer raw / {one_g} g"
    elif force:
        remark += ", accelerometer left out, as the log has no acc_1G"
    time = nanoseconds(np.nan_to_num(values[TIME], nan=-1.0))
    return Log(name, others, Series(time, gyro), [], "FLU", f"gyro {remark}, by {source}", damage)


def _rate_scale(path: Path, lines: Lines) -> tuple[float, str]:
    """Return rad/s for a raw number of the gyro, and what that is in words."""
    firmware = lines.get("Firmware type", "none")
    if firmware not in FIRMWARES:
        raise bad_config(
            f"{path}: the firmware is {firmware!r}, of which the unit of gyro_scale is not known",
            f"known are: {', '.join(FIRMWARES)}; else give --map",
        )
    text = lines.get("gyro_scale", lines.get("gyro.scale", ""))
    try:
        (scale,) = struct.unpack(">f", bytes.fromhex(text.removeprefix("0x").zfill(8)))
    except (ValueError, struct.error):
        scale = math.nan
    if not 0.0 < scale < math.inf:
        raise bad_config(f"{path}: its gyro_scale is {text!r}, no number", HINT)
    if lines.get("blackbox_high_resolution", "0") != "0":
        how = "as blackbox_high_resolution is on"
        return math.radians(scale) / HIGH_RESOLUTION, f"raw x {scale:.6g} °/s/10, {how}"
    return math.radians(scale), f"raw x {scale:.6g} °/s"


def _read_table(
    path: Path, data: bytes, titles: list[str], wanted: list[str]
) -> tuple[dict[str, FloatArray], Damage]:
    """Return columns as float64 by title, and the rows that are cut."""
    rows = [row.rstrip(b"\r") for row in data.split(b"\n")]
    cut = [row for row in rows if row.strip() and row.count(b",") != len(titles) - 1]
    whole = b"\n".join(row for row in rows if row.count(b",") == len(titles) - 1)
    numbers = csv.ConvertOptions(include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64()))
    try:
        table = csv.read_csv(io.BytesIO(whole), csv.ReadOptions(column_names=titles), convert_options=numbers)
    except (pa.ArrowException, UnicodeDecodeError) as error:
        raise bad_data(f"{path}: cannot be read as a table: {error}") from error
    values = {title: table[title].to_numpy() for title in wanted}
    return values, Damage(len(cut), sum(map(len, cut)))


def _parts(name: str) -> list[str]:
    return [f"{name}[{k}]" for k in range(3)]


def _beside(path: Path) -> tuple[Lines, str]:
    """Return the H lines of the log that a table was made of, which lies beside it, and where they stand.

    Raises BAD_CONFIG where there is none.
    """
    name, _, number = path.stem.rpartition(".")
    if not (name and number.isdecimal()):
        name, number = path.stem, "1"
    for log in sorted(path.parent.glob("*")):
        if log.stem == name and log.suffix.lower() in LOGS and log.is_file():
            data = log.read_bytes()
            starts = [found.start() for found in re.finditer(BEGIN, data)]
            if 0 < int(number) <= len(starts):
                return _settings(data, starts[int(number) - 1])[0], f"log {int(number)} of {log.name}"
    raise bad_config(
        f"{path}: the scale of its gyro is not stated, nor whether the log has blackbox_high_resolution", HINT
    )


def _settings(data: bytes, at: int = 0) -> tuple[dict[str, str], int]:
    """Return the H lines that begin there, and where they end."""
    found = dict[str, str]()
    while (line := LINE.match(data, at)) is not None:
        name, value = (part.decode("ascii", "replace").strip() for part in line.groups())
        found[name] = value
        at = line.end()
    return found, at
