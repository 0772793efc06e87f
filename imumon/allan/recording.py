"""The channels of a recording for the Allan deviation, and what the user should know of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.allan.series import BRIDGED, EvenSeries, even_channels
from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.errors import ImumonError, Reason
from imumon.estimation.rest.stage import RestDetector
from imumon.pipeline import Pipeline
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import SUFFIXES, iterate_table, read_columns

GROUPS = ("gyro", "accel")
CHANNELS = tuple(f"{group}_{axis}" for group in GROUPS for axis in "xyz")
UNITS = {"gyro": "rad/s", "accel": "m/s^2"}
TEMPERATURES = ("temperature", "temperature_x", "temperature_y", "temperature_z")
WANTED = ("device_time_ns", "segment", "at_rest", *CHANNELS, *TEMPERATURES)
FEWEST_SAMPLES = 64
LEAST_USED = 0.5
"""A recording of which less can be used has no even rate."""
WARMING_DEGC = 0.5
MOVING_SHARE = 0.01
"""Less is put down to the detector."""
LEAST_FOR_MOTION_S = 10.0
"""The rest detector cannot tell before."""
FASTEST_HZ = 5e4
"""No IMU sends faster; a column device_time_ns in another unit would."""
FASTEST_RAD_S = 100.0
"""No gyro measures more (5700 deg/s)."""
NORMAL_G = (9.3, 10.3)
"""Norm of the specific force at rest, m/s^2, with a few percent for an uncalibrated unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """The channels that are there, on an even grid, and what to say of them."""

    series: dict[str, EvenSeries]
    warnings: tuple[str, ...]


def open_recording(path: Path) -> Recording:
    """Read the gyro and accelerometer channels of a session, or of a table of samples.

    Raises
    ------
    ImumonError
        BAD_DATA when there is nothing to read, no such channel, too few samples or no even rate.
    """
    blocks, said = _blocks(path)
    if not blocks:
        raise ImumonError(Reason.BAD_DATA, f"{path}: has no samples")
    samples = join(blocks)
    if "device_time_ns" not in samples:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: has no column device_time_ns",
            "a table from elsewhere becomes a session first: imumon import",
        )
    if "segment" not in samples:
        samples = samples.with_columns({"segment": np.zeros(len(samples), np.int64)})
    there = [name for name in CHANNELS if name in samples]
    names = [name for name in there if np.isfinite(samples[name]).any()]
    if there and not names:
        raise ImumonError(Reason.BAD_DATA, f"{path}: {', '.join(there)} hold no number in any row")
    if not names:
        raise ImumonError(Reason.BAD_DATA, f"{path}: has none of the columns {', '.join(CHANNELS)}")
    time_ns, segment = samples["device_time_ns"], samples["segment"]
    series = even_channels(time_ns, segment, {name: samples[name] for name in names})
    _refuse(path, len(samples), names, series)
    empty = [name for name in there if name not in names]
    warnings = [
        *said,
        *([f"{', '.join(empty)}: no number in any row; left out"] if empty else []),
        *_of_units(series),
        *_of_the_grid(series),
        *_of_motion(samples),
        *_of_temperature(samples),
    ]
    return Recording(series, tuple(warnings))


def _blocks(path: Path) -> tuple[list[SampleBlock], list[str]]:
    """Return the wanted columns of all samples, and what the source says of itself."""
    if path.is_file() and path.suffix in SUFFIXES:
        _check_units(path)
        return _wanted(iterate_table(path)), []
    if path.is_file():
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path} is neither a session nor a table ({', '.join(SUFFIXES)})",
            "a raw capture becomes a table first: imumon decode FILE --device NAME --out TABLE.parquet",
        )
    if not path.exists():
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: there is no such file or folder",
            "give a session, or a table of samples",
        )
    source = open_source(path)
    return _wanted(run_over(source.items, Pipeline(source.device))), source.warnings()


def _check_units(path: Path) -> None:
    """Refuse a table that says itself that it is in other units."""
    columns = read_columns(path)
    for name in CHANNELS:
        unit = columns[name].unit if name in columns else ""
        if unit and unit != UNITS[group_of(name)]:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{path}: {name} is in {unit}, not in {UNITS[group_of(name)]}",
                "a table from elsewhere becomes a session first: imumon import",
            )


def _wanted(blocks: Iterable[SampleBlock]) -> list[SampleBlock]:
    """Keep of each block what is needed, as a copy, so that the rest can go."""
    kept = []
    for block in blocks:
        columns: dict[str, ColumnArray] = {name: block[name].copy() for name in WANTED if name in block}
        if len(block):
            kept.append(SampleBlock(columns))
    return kept


def _refuse(path: Path, rows: int, names: list[str], series: dict[str, EvenSeries]) -> None:
    """Raise where a deviation would mean nothing."""
    if rows < FEWEST_SAMPLES:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: has {rows} samples; an Allan deviation needs {FEWEST_SAMPLES} at the least",
            "record for ten times as long as the longest averaging time of interest",
        )
    for name in names:
        found = series.get(name)
        used = 0.0 if found is None else found.used / found.samples
        if used < LEAST_USED:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{path}: {name}: only {used:.0%} of the samples come at an even rate",
                "nothing is resampled: that would change the noise that is to be measured.  "
                "Use the device's own time or counter; imumon import takes rate_hz for rows that are even",
            )
        if found is not None and rate_hz(found) > FASTEST_HZ:
            raise ImumonError(
                Reason.BAD_DATA,
                f"{path}: by device_time_ns the rate is {rate_hz(found):.3g} Hz",
                "the column must hold nanoseconds; imumon import takes times in other units",
            )


def _of_units(series: dict[str, EvenSeries]) -> list[str]:
    """Tell what looks like readings in other units."""
    said = []
    fast = [
        name
        for name in series
        if group_of(name) == "gyro" and np.median(np.abs(series[name].values)) > FASTEST_RAD_S
    ]
    if fast:
        said.append(f"{', '.join(fast)}: turns faster than any gyro measures: it is not in rad/s")
    accel = [series[name] for name in series if group_of(name) == "accel"]
    norm = float(np.linalg.norm([channel.values.mean() for channel in accel]))
    if len(accel) == len("xyz") and not NORMAL_G[0] < norm < NORMAL_G[1]:
        said.append(
            f"the mean specific force is {norm:.4g} m/s^2, not gravity: it is not in m/s^2, or not whole"
        )
    return said


def _of_the_grid(series: dict[str, EvenSeries]) -> list[str]:
    said: dict[str, list[str]] = {}
    for name, channel in series.items():
        rate = 1.0 / channel.interval_s
        lost, islands = int(channel.gap_lengths.sum()), len(channel.islands) - 1
        texts = []
        if lost:
            texts.append(
                f"{len(channel.gap_lengths):,} gaps, {lost:,} of {len(channel.values):,} samples missing: "
                f"bridged for averaging times {BRIDGED} times as long, crossed by no shorter one"
            )
        if islands > 1:
            texts.append(
                f"{islands} pieces that nothing crosses (restarts, long or uneven gaps): "
                "the longest limits the averaging time"
            )
        if channel.used < channel.samples:
            texts.append(
                f"{channel.samples - channel.used:,} of {channel.samples:,} samples do not come at the even "
                f"rate of {rate:.6g} Hz and are left out"
            )
        if channel.jitter > 0.05:
            texts.append(f"time from sample to sample varies by {channel.jitter:.0%} rms; taken as even")
        for text in texts:
            said.setdefault(text, []).append(name)
    return [f"{_among(names, series)}{text}" for text, names in said.items()]


def _among(names: list[str], series: dict[str, EvenSeries]) -> str:
    return "" if len(names) == len(series) else f"{', '.join(names)}: "


def _of_motion(samples: SampleBlock) -> list[str]:
    """Tell the share of motion: by the column ``at_rest``, else by the rest detector."""
    at_rest = samples.columns.get("at_rest")
    how = "column at_rest"
    if at_rest is None:
        at_rest, how = RestDetector().process(samples)["at_rest"], "by the rest detector"
        if samples["device_time_ns"][-1] - samples["device_time_ns"][0] < LEAST_FOR_MOTION_S * 1e9:
            return []
    known = at_rest[np.argmax(at_rest == 1) :]  # until the first rest nothing is known
    share = float(np.mean(known != 1))
    if share <= MOVING_SHARE:
        return []
    return [
        f"the unit moved during {share:.1%} of the recording ({how}): "
        "an Allan deviation of a unit that moves is that of the motion; record it at rest"
    ]


def _of_temperature(samples: SampleBlock) -> list[str]:
    for name in TEMPERATURES:
        if name in samples and np.isfinite(samples[name]).any():
            readings = samples[name][np.isfinite(samples[name])]
            low, high = (float(value) for value in np.percentile(readings, [0.5, 99.5]))
            if high - low > WARMING_DEGC:
                return [
                    f"the temperature moved between {low:.1f} and {high:.1f} °C: bias instability, "
                    "random walk and ramp hold thermal drift"
                ]
            return []
    return ["there is no temperature: thermal drift cannot be told from bias instability and random walk"]


def rate_hz(series: EvenSeries) -> float:
    """Return the sample rate."""
    return 1.0 / series.interval_s


def group_of(channel: str) -> str:
    """Return the sensor of a channel: "gyro" or "accel"."""
    return channel.rsplit("_", 1)[0]
