"""Blackbox logs of Betaflight and its relatives, as the CSV that blackbox_decode makes.

time is in µs; gyroADC is the rate behind the filters of the firmware and gyroUnfilt before them, accSmooth
the specific force.  Their numbers are raw unless blackbox_decode was told a unit, which then stands in the
column's name.  The scale is in the "H" lines of the log itself, which blackbox_decode does not copy: they are
taken from the head of the table, else from the log beside it.  Axes are forward-left-up.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import csv

from imumon.errors import ImumonError, Reason
from imumon.files import readable
from imumon.geodesy import STANDARD_GRAVITY
from imumon.logs.log import AXES, Damage, Log, Series, named, nanoseconds, pick, triple

BEGIN = b"H Product:Blackbox"
TABLE = re.compile(rb"\s*loopIteration\s*,\s*time \(")
COLUMN = re.compile(r"(?P<name>.*?)( \((?P<unit>[^)]*)\))?")
LINE = re.compile(rb"H ([^:\n]+):([^\r\n]*)\r?\n")
NUMBERED = re.compile(r"(?P<log>.+)\.(?P<number>\d+)")
LOGS = (".bbl", ".bfl", ".txt", ".cfl")
GYROS = ("gyroADC", "gyroUnfilt")
FIRMWARES = ("Cleanflight", "Betaflight", "INAV", "EmuFlight")
"""Whose gyro_scale is in °/s; that of Baseflight is not, and of others it is not known."""
HIGH_RESOLUTION = 10.0
"""With blackbox_high_resolution the firmware writes rates times this (its blackbox.c), which blackbox_decode
leaves as they are, also where it names a unit."""
MICROSECONDS = {"us": 1.0, "ms": 1e3, "s": 1e6}
RATES = {"deg/s": math.radians(1.0), "rad/s": 1.0}
FORCES = {"g": STANDARD_GRAVITY, "m/s/s": 1.0, "m/s2": 1.0}
HINT = (
    "leave the log beside the table (LOG.bbl beside LOG.01.csv, as blackbox_decode does), put its lines that"
    " begin with H at the head of the table, or give --map MAP.yaml with the units"
)


def is_one(_: Path, head: bytes) -> bool:
    """Return whether a file is such a table, or a log that is to be decoded first."""
    return head.startswith(BEGIN) or TABLE.match(head) is not None


def read(path: Path, sensor: str | None = None) -> Log:
    """Return the gyro of a table, gyroADC unless gyroUnfilt is asked for, and accSmooth.

    Raises BAD_DATA when it cannot be read; BAD_CONFIG when it was not decoded, when nothing says the scale of
    its gyro, or it has no such gyro.
    """
    lines, titles, skip = _head(path)
    columns = _columns(titles)
    if "time" not in columns:
        raise ImumonError(Reason.BAD_DATA, f"{path}: has no time in {', '.join(MICROSECONDS)}")
    name, others = pick(path, [one for one in GYROS if f"{one}[0]" in columns], sensor)
    scaling = _Scaling.of(path, lines)
    table, damage = _read_table(path, titles, [one.title for one in columns.values()], skip)
    rate, remark = scaling.rate(path, columns[f"{name}[0]"].unit)
    values = {column.name: table[column.title].to_numpy() for column in columns.values()}
    gyro = named(values, _parts(name), triple("gyro"), rate)
    if "accSmooth[0]" in columns:
        force, of_force = scaling.force(columns["accSmooth[0]"].unit)
        remark += f", accelerometer {of_force}"
        if force is not None:
            gyro |= named(values, _parts("accSmooth"), triple("accel"), force)
    time = nanoseconds(np.nan_to_num(values["time"] * MICROSECONDS[columns["time"].unit], nan=-1.0))
    return Log(name, others, Series(time, gyro), [], "FLU", f"gyro {remark}, by {scaling.source}", damage)


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of the table: its title, and name and unit in it; "raw" where it names none."""

    title: str
    name: str
    unit: str


@dataclass(frozen=True, slots=True)
class _Scaling:
    """What the log says of its scales, and where that stands."""

    lines: Mapping[str, str]
    source: str

    @classmethod
    def of(cls, path: Path, lines: Mapping[str, str]) -> _Scaling:
        """Return that of the head of the table, else of the log beside it."""
        if lines:
            return cls(lines, f"the head of {path.name}")
        log, number = _log_beside(path)
        if log is not None and (found := _logs_in(log)) and number <= len(found):
            return cls(found[number - 1], f"log {number} of {log.name}")
        seen = f"{path}: nothing says the scale of its gyro, nor whether the log has blackbox_high_resolution"
        raise ImumonError(Reason.BAD_CONFIG, seen, HINT)

    def rate(self, path: Path, unit: str) -> tuple[float, str]:
        """Return rad/s for a unit of the column, and what that is in words."""
        firmware = self.lines.get("Firmware type", "none")
        if firmware not in FIRMWARES:
            seen = f"{path}: the firmware is {firmware!r}, of which the unit of gyro_scale is not known"
            raise ImumonError(Reason.BAD_CONFIG, seen, f"known are: {', '.join(FIRMWARES)}; else give --map")
        finer = HIGH_RESOLUTION if self.lines.get("blackbox_high_resolution", "0") != "0" else 1.0
        tenth = "/10, as blackbox_high_resolution is on" if finer > 1.0 else ""
        if unit != "raw":
            return RATES[unit] / finer, f"in {unit}{tenth}"
        text = self.lines.get("gyro_scale", self.lines.get("gyro.scale", ""))
        try:
            (scale,) = struct.unpack(">f", bytes.fromhex(text.removeprefix("0x").zfill(8)))
        except (ValueError, struct.error):
            scale = math.nan
        if not 0.0 < scale < math.inf:
            raise ImumonError(Reason.BAD_CONFIG, f"{path}: its gyro_scale is {text!r}, no number", HINT)
        return math.radians(scale) / finer, f"raw x {scale:.6g} °/s{tenth}"

    def force(self, unit: str) -> tuple[float | None, str]:
        """Return m/s² for a unit of the column, and what that is in words; None where it is not known."""
        if unit != "raw":
            return FORCES[unit], f"in {unit}"
        text = self.lines.get("acc_1G", "")
        if not (text.isascii() and text.isdigit() and int(text)):
            return None, "left out, as the log has no acc_1G"
        return STANDARD_GRAVITY / int(text), f"raw / {text} g"


def _head(path: Path) -> tuple[dict[str, str], list[str], int]:
    """Return the H lines at the head of a table, the titles of its columns, and how many lines these are."""
    lines = []
    with readable(path), path.open("rb") as file:
        while (line := file.readline(1 << 16)).startswith(b"H "):
            lines.append(line)
    if TABLE.match(line) is None:
        raise ImumonError(
            Reason.BAD_CONFIG, f"{path}: is a blackbox log as it was recorded", f"blackbox_decode {path}"
        )
    titles = [title.strip() for title in line.decode(errors="replace").split(",")]
    return _fields(b"".join(lines)), titles, len(lines) + 1


def _read_table(path: Path, titles: list[str], wanted: list[str], skip: int) -> tuple[pa.Table, Damage]:
    """Return columns as float64, and the rows that are cut."""
    cut: list[int] = []

    def leave_out(row: csv.InvalidRow) -> str:
        cut.append(len(row.text.encode()))
        return "skip"

    try:
        table = csv.read_csv(
            path,
            csv.ReadOptions(skip_rows=skip, column_names=titles),
            csv.ParseOptions(invalid_row_handler=leave_out),
            csv.ConvertOptions(include_columns=wanted, column_types=dict.fromkeys(wanted, pa.float64())),
        )
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise ImumonError(Reason.BAD_DATA, f"{path}: cannot be read as a table: {error}") from error
    return table, Damage(len(cut), sum(cut))


def _columns(titles: list[str]) -> dict[str, _Column]:
    """Return the columns that may be taken, by name: all of a vector are there, in units that are known."""
    found = dict[str, _Column]()
    for title in titles:
        parts = COLUMN.fullmatch(title)
        assert parts is not None
        found[parts["name"]] = _Column(title, parts["name"], parts["unit"] or "raw")
    known: dict[str, Mapping[str, float]] = {"time": MICROSECONDS, "accSmooth": {"raw": 1.0, **FORCES}}
    known |= {name: {"raw": 1.0, **RATES} for name in GYROS}
    taken = dict[str, _Column]()
    for name, units in known.items():
        parts_of = [name] if name == "time" else _parts(name)
        if all(part in found and found[part].unit in units for part in parts_of):
            taken |= {part: found[part] for part in parts_of}
    return taken


def _parts(name: str) -> list[str]:
    return [f"{name}[{k}]" for k in range(len(AXES))]


def _log_beside(path: Path) -> tuple[Path | None, int]:
    """Return the log that a table was made of, and which of the logs in it."""
    numbered = NUMBERED.fullmatch(path.stem)
    name, number = (numbered["log"], int(numbered["number"])) if numbered else (path.stem, 1)
    beside = sorted(path.parent.glob("*")) if path.parent.is_dir() else []
    found = [one for one in beside if one.stem == name and one.suffix.lower() in LOGS and number > 0]
    return (found[0] if found else None), number


def _logs_in(path: Path) -> list[dict[str, str]]:
    """Return the H lines of every log in a file."""
    try:
        data = path.read_bytes()
    except OSError:
        return []
    starts = [found.start() for found in re.finditer(re.escape(BEGIN), data)]
    return [_fields(data[start:end]) for start, end in zip(starts, [*starts[1:], len(data)], strict=True)]


def _fields(data: bytes) -> dict[str, str]:
    """Return the H lines at the beginning of some bytes."""
    found, at = dict[str, str](), 0
    while (line := LINE.match(data, at)) is not None:
        name, value = (part.decode("ascii", "replace").strip() for part in line.groups())
        found[name] = value
        at = line.end()
    return found
