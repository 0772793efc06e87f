"""Sensors and clocks that fail for a while: what stays dead after they are good again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.pipeline import Pipeline
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from tests.faults.rows import Row

Columns = dict[str, ColumnArray]
LATITUDE_DEG = 48.0
FAULT_S = (60.0, 70.0)
LENGTH_S = 900.0
RATE_HZ = 50.0
BLOCK = 1000
"""Samples that are pushed at once."""


def healthy(rate_hz: float = RATE_HZ, length_s: float = LENGTH_S, seed: int = 0) -> Columns:
    """Return a unit at rest, level, that warms up by some degrees; late it is turned twice."""
    rng = np.random.default_rng(seed)
    n = round(length_s * rate_hz)
    time_s = np.arange(n) / rate_hz
    noise_sd = 1e-4 * np.sqrt(rate_hz)
    latitude = np.radians(LATITUDE_DEG)
    rate = EARTH_RATE * np.array([np.cos(latitude), 0.0, np.sin(latitude)])  # x north
    columns: Columns = {
        "device_time_ns": np.rint(time_s * 1e9).astype(np.int64),
        "segment": np.zeros(n, np.int64),
    }
    for axis, earth in zip("xyz", rate, strict=True):
        columns[f"gyro_{axis}"] = earth + 1e-3 + noise_sd * rng.standard_normal(n)
    for axis, gravity in zip("xyz", (0.0, 0.0, STANDARD_GRAVITY), strict=True):
        columns[f"accel_{axis}"] = gravity + 10 * noise_sd * rng.standard_normal(n)
    turning = (np.abs(time_s / length_s - 0.7) < 0.003) | (np.abs(time_s / length_s - 0.8) < 0.003)
    columns["gyro_z"] = columns["gyro_z"] + np.where(turning, 0.5, 0.0)
    warm = 25.0 + 5.0 * (1.0 - np.exp(-time_s / 400.0))
    columns["temperature"] = np.round((warm + 0.02 * rng.standard_normal(n)) / 0.01) * 0.01
    columns["mag_x"] = 20.0 + 0.1 * rng.standard_normal(n)
    columns["mag_y"] = 0.1 * rng.standard_normal(n)
    columns["mag_z"] = -40.0 + 0.1 * rng.standard_normal(n)
    return columns


SIGMAS = {f"gyro_bias_{axis}": f"gyro_bias_sd_{axis}" for axis in "xyz"} | {
    "temperature_estimate": "temperature_estimate_sd",
    "temperature_rate": "temperature_rate_sd",
    "heading": "heading_sd",
}
SOON_S = 120.0
"""Promised: so long after the data is good again every column that it can have is there."""
FAR = 5.0
"""Sigmas: six estimates of thirty faults are 5e-6 likely to be so far off once by chance."""

Fault = Callable[[Columns, slice], None]


def _set(names: str, value: float) -> Fault:
    def strike(columns: Columns, at: slice) -> None:
        for name in columns:
            if name.startswith(tuple(names.split())):
                columns[name][at] = value

    return strike


def _one(value: float) -> Fault:
    def strike(columns: Columns, at: slice) -> None:
        for name in columns:
            if name.startswith(("gyro", "accel", "temperature", "mag")):
                columns[name][at.start] = value

    return strike


def _stuck(names: str) -> Fault:
    def strike(columns: Columns, at: slice) -> None:
        for name in columns:
            if name.startswith(tuple(names.split())):
                columns[name][at] = columns[name][at.start]

    return strike


def _from_start(fault: Fault, seconds: float) -> Fault:
    return lambda columns, _: fault(columns, slice(0, round(seconds * RATE_HZ)))


def _turning(columns: Columns, _: slice) -> None:
    n = round(60 * RATE_HZ)
    columns["gyro_z"][:n] += 0.7
    columns["gyro_x"][:n] += 0.3 * np.sin(np.arange(n) / 20)
    columns["accel_x"][:n] += np.sin(np.arange(n) / 15)


def _time_stands(columns: Columns, at: slice) -> None:
    columns["device_time_ns"][at] = columns["device_time_ns"][at.start]


def _time_leaps(columns: Columns, at: slice) -> None:
    columns["device_time_ns"][at.start : at.start + 5] = 1 << 62


def _time_leaps_for_good(columns: Columns, at: slice) -> None:
    columns["device_time_ns"][at.start :] += 1 << 62
    columns["segment"][at.start :] += 1


def _segments(columns: Columns, at: slice) -> None:
    n = len(columns["segment"])
    each = np.arange(n) // round(0.5 * RATE_HZ)
    within = np.clip(each - each[at.start], 0, each[at.stop] - each[at.start])
    columns["segment"][:] = within


FAULTS: dict[str, Fault] = {
    "nothing": lambda *_: None,
    "one sample of 1e30": _one(1e30),
    "one sample of -1e300": _one(-1e300),
    "one sample of infinity": _one(np.inf),
    "10 s of NaN, all": _set("gyro accel temperature mag", np.nan),
    "10 s of NaN, gyro": _set("gyro", np.nan),
    "10 s of NaN, accelerometer": _set("accel", np.nan),
    "10 s of NaN, temperature": _set("temperature", np.nan),
    "10 s of infinity": _set("gyro accel temperature mag", np.inf),
    "10 s of 1e30, gyro": _set("gyro", 1e30),
    "10 s of 1e30, accelerometer": _set("accel", 1e30),
    "10 s of 1e30, temperature": _set("temperature", 1e30),
    "10 s stuck gyro": _stuck("gyro"),
    "10 s stuck accelerometer": _stuck("accel"),
    "10 s stuck temperature": _stuck("temperature"),
    "10 s of zeros": _set("gyro accel temperature mag", 0.0),
    "10 s saturated gyro": _set("gyro", 35.0),
    "10 s saturated accelerometer": _set("accel", 160.0),
    "first 60 s stuck gyro": _from_start(_stuck("gyro"), 60),
    "first 60 s stuck accelerometer": _from_start(_stuck("accel"), 60),
    "first 60 s of NaN": _from_start(_set("gyro accel temperature mag", np.nan), 60),
    "first 60 s of 1e30": _from_start(_set("gyro accel temperature mag", 1e30), 60),
    "first 60 s of zeros": _from_start(_set("gyro accel temperature mag", 0.0), 60),
    "first 60 s saturated gyro": _from_start(_set("gyro", 35.0), 60),
    "first 60 s of turning": _turning,
    "time stands still for 10 s": _time_stands,
    "time leaps to 2^62 for 5 samples": _time_leaps,
    "time leaps by 2^62 for good": _time_leaps_for_good,
    "a new segment every 0.5 s for 10 s": _segments,
}


@dataclass(frozen=True, slots=True)
class Variant:
    """A device that is out of the ordinary all the time."""

    rate_hz: float = RATE_HZ
    length_s: float = 200.0
    absent: str = ""
    zero: str = ""

    def columns(self) -> Columns:
        """Return what it sends."""
        columns = healthy(self.rate_hz, self.length_s)
        for name in [name for name in columns if self.absent and name.startswith(tuple(self.absent.split()))]:
            del columns[name]
        for name in columns:
            if self.zero and name.startswith(tuple(self.zero.split())):
                columns[name][:] = 0.0
        return columns


VARIANTS: dict[str, Variant] = {
    "0.001 Hz": Variant(0.001, 5e5),
    "0.01 Hz": Variant(0.01, 5e4),
    "0.1 Hz": Variant(0.1, 5e3),
    "4 kHz": Variant(4000.0, 60.0),
    "one sample": Variant(1.0, 1.0),
    "no gyro": Variant(absent="gyro"),
    "no accelerometer": Variant(absent="accel"),
    "no temperature": Variant(absent="temperature"),
    "no magnetometer": Variant(absent="mag"),
    "times only": Variant(absent="gyro accel temperature mag"),
    "a gyro axis absent": Variant(absent="gyro_y"),
    "gyro constant zero": Variant(zero="gyro"),
    "accelerometer constant zero": Variant(zero="accel"),
    "temperature constant zero": Variant(zero="temperature"),
    "all constant zero": Variant(zero="gyro accel temperature mag"),
}


def run(columns: Columns, latitude_deg: float | None) -> tuple[SampleBlock, Pipeline]:
    """Run samples through all stages; return all columns."""
    pipeline = Pipeline(None, estimators(None, Setup(latitude_deg=latitude_deg)))
    block, out = SampleBlock(columns), []
    for start in range(0, len(block), BLOCK):
        part = {name: values[start : start + BLOCK] for name, values in block.columns.items()}
        pipeline.push(SampleBlock(part))
        out.append(pipeline.take())
    pipeline.finish()
    out.append(pipeline.take())
    return join(out), pipeline


@dataclass(frozen=True, slots=True)
class Outcome:
    """What of the columns is dead, wild or late."""

    dead: list[str]
    """Columns that the healthy record ends with, and this one does not."""
    wild: list[str]
    """Columns with an infinity, or beyond 1e6, anywhere."""
    alive_after_s: float
    """When the last of the columns came back, counted from the end of the fault."""
    off: list[str]
    """Estimates that end further from those of the healthy record than their sigmas allow."""


def compare(clean: SampleBlock, struck: SampleBlock, fault_end_s: float, rate_hz: float) -> Outcome:
    """Compare the columns that are estimated with those of a healthy record."""
    dead, wild, latest = [], [], 0.0
    for name, values in clean.columns.items():
        if values.dtype != np.float64 or (name.startswith(("gyro_x", "gyro_y", "gyro_z")) and len(name) == 6):
            continue
        if name in ("accel_x", "accel_y", "accel_z", "mag_x", "mag_y", "mag_z", "temperature"):
            continue
        other = struck.columns.get(name)
        tail = slice(-round(30 * rate_hz), None)
        if not np.isfinite(values[tail]).any():
            continue
        if other is None or not np.isfinite(other[tail]).any():
            dead.append(name)
            continue
        if np.isinf(other).any() or (
            np.nanmax(np.abs(other), initial=0.0) > 1e6 and not name.endswith("_ns")
        ):
            wild.append(name)
        behind = np.flatnonzero(np.isfinite(other[round(fault_end_s * rate_hz) :]))
        first_clean = np.flatnonzero(np.isfinite(values))
        late = behind[0] / rate_hz - max(0.0, first_clean[0] / rate_hz - fault_end_s)
        latest = max(latest, float(late))
    return Outcome(dead, wild, latest, _off(clean, struck))


def _off(clean: SampleBlock, struck: SampleBlock) -> list[str]:
    """Compare the last estimates that have a sigma."""
    off = []
    for name, sd_name in SIGMAS.items():
        if name not in clean or name not in struck:
            continue
        pairs = [(block[name], block[sd_name]) for block in (clean, struck)]
        ends = [(v[s][-1], sd[s][-1]) for v, sd in pairs if (s := np.isfinite(v) & np.isfinite(sd)).any()]
        if len(ends) == 2 and abs(ends[0][0] - ends[1][0]) > FAR * np.hypot(ends[0][1], ends[1][1]):
            off.append(f"{name} by {abs(ends[0][0] - ends[1][0]) / np.hypot(ends[0][1], ends[1][1]):.1f} sd")
    return off


def attack_all(
    latitude_deg: float | None, names: list[str] | None = None, length_s: float = LENGTH_S
) -> Iterator[tuple[str, Outcome]]:
    """Run each fault, and compare."""
    clean, _ = run(healthy(length_s=length_s), latitude_deg)
    for name in names or FAULTS:
        columns = healthy(length_s=length_s)
        FAULTS[name](columns, slice(round(FAULT_S[0] * RATE_HZ), round(FAULT_S[1] * RATE_HZ)))
        struck, _ = run(columns, latitude_deg)
        yield name, compare(clean, struck, FAULT_S[1], RATE_HZ)


def attack_rows(names: list[str] | None = None) -> Iterator[Row]:
    """Run each fault without and with a latitude, as rows of a table."""
    for latitude_deg in (None, LATITUDE_DEG):
        place = "no latitude" if latitude_deg is None else f"latitude {latitude_deg:g}°"
        for name, outcome in attack_all(latitude_deg, names):
            said = f"all columns back {max(outcome.alive_after_s, 0.0):.1f} s after its end at the latest"
            if outcome.dead:
                said = f"dead: {', '.join(outcome.dead)}"
            if outcome.wild:
                said += f"; wild: {', '.join(outcome.wild)}"
            if outcome.off:
                said += f"; off at the end: {', '.join(outcome.off)}"
            held = not (outcome.dead or outcome.wild or outcome.off) and outcome.alive_after_s <= SOON_S
            yield Row(f"{name}, {place}", 1, said, held)


def variant_rows(names: Sequence[str] | None = None) -> Iterator[Row]:
    """Run each device that is out of the ordinary, without and with a latitude."""
    for name in names or VARIANTS:
        variant = VARIANTS[name]
        for latitude_deg in (None, LATITUDE_DEG):
            sent = variant.columns()
            block, pipeline = run(sent, latitude_deg)
            made = {k: v for k, v in block.columns.items() if k not in sent and v.dtype == np.float64}
            there = sum(bool(np.isfinite(values).any()) for values in made.values())
            wild = [k for k, values in made.items() if np.isinf(values).any()]
            left_out = [text for text in pipeline.warnings() if text.startswith("left out")]
            place = "no latitude" if latitude_deg is None else f"latitude {latitude_deg:g}°"
            said = "; ".join([f"{there} of {len(made)} columns have values", *left_out, *wild])
            yield Row(f"{name}, {place}", 1, said, held=not wild)
