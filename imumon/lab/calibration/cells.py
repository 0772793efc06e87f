"""From recordings to means at rest, cells, runs and levels: what curves are fitted to and left out by."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES, BodyAxes
from imumon.errors import bad_data
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import earth_rate_along, north_in_body
from imumon.models.curves.points import Points
from imumon.recordings.reduced import ACCEL, AXES, GYRO, Reduced, reduce
from imumon.recordings.source import Count, no_count, open_recording
from imumon.run.setup import Setup, unused_keys

COLUMNS = (*GYRO, *ACCEL, *TEMPERATURES, "temperature_estimate", *(f"temperature_estimate_{a}" for a in AXES))
BLOCK_S = 10.0
"""Length of a block: long against the sample noise, short against a chamber's ramps."""
LEAST_COVERED = 0.5
"""A block whose samples span less than this share of it is passed over."""
CELL_S = 300.0
"""Longest cell."""
BANDS = 12
"""Levels of data in which the temperature dwells nowhere: bands of equal width."""
TURNED = np.cos(np.deg2rad(5.0))
"""A unit whose specific force turned by more is in another pose, and that begins a new run."""
SHORTEST_RUN_S = 60.0
ONE_WAY = "no session both warms and cools: what lag, hysteresis or warm-up do is then part of the curve"


class Record(NamedTuple):
    """The block means over `COLUMNS` of one recording, and which blocks are at `rest` and complete, (n,).

    `name` and `sha256`: where it comes from, and the fingerprint of its bytes.
    """

    name: str
    sha256: str
    device: str | None
    axes: BodyAxes | None
    means: Reduced
    rest: BoolArray
    serial: str | None = None

    def temperature_column(self, channel: str) -> str | None:
        """Return the column with the temperature of a channel: its own sensor's, estimated, if there is."""
        axis = channel[-2:]
        own = ("temperature_estimate" + axis, "temperature_estimate", "temperature" + axis, "temperature")
        return next((name for name in own if self.means.has(name)), None)


Records = Sequence[Record]


def record_of(
    blocks: Iterable[SampleBlock],
    name: str,
    sha256: str,
    device: str | None = None,
    axes: BodyAxes | None = None,
    serial: str | None = None,
) -> Record:
    """Reduce samples that went through the pipeline."""
    means = reduce(blocks, COLUMNS, BLOCK_S)
    rest = means.at_rest() & (means.span_s >= LEAST_COVERED * BLOCK_S)
    return Record(name, sha256, device, axes, means, rest, serial)


def read_session(path: Path, count: Count = no_count) -> tuple[Record, list[str]]:
    """Read a session, recorded or imported; return its record, and what the user should know of it.

    Raises BAD_DATA when there is no session, or it cannot be read.
    """
    recording = open_recording(
        path,
        lambda device: [TemperatureRate(parameters=device.temperature if device else None), RestDetector()],
        count=count,
    )
    known = recording.name, recording.sha256(), recording.device, recording.source.axes, recording.serial
    record = record_of(recording.blocks(), *known)
    if not len(record.means):
        raise bad_data(f"{path}: there is no sample in this session")
    texts = [*recording.warnings(), *unused_keys(Setup(), recording.source.device)]
    return record, [f"{path}: {text}" for text in texts]


@dataclass(frozen=True, eq=False)
class Channel(Points):
    """A channel's means over cells, from all records.

    `white` is the variance that the samples' own noise leaves in each mean, if it is white, `seconds` the
    time at rest in its cell, and `run` goes from power-on to the next, or to another pose, (n,) each.
    """

    white: FloatArray
    seconds: FloatArray
    run: IntArray

    def weighted(self, slow: float = 0.0) -> Self:
        """Return them with weights; `slow` is the variance of what varies slowly, which no cell averages."""
        variance = self.white + slow
        least = variance[variance > 0].min(initial=np.inf)
        weight = 1.0 / np.maximum(variance, least if np.isfinite(least) else 1.0)
        return replace(self, weight=weight / weight.mean())


class Run(NamedTuple):
    """A stretch in one pose without a restart, long enough: that of this number in a record of that number.

    `rows` are its blocks at rest in the record, with the cell, the time s, temperature °C and rate °C/s of
    each, (n,).  `up` is the direction of the specific force in body axes, (3,), NaN without accelerometers;
    `earth_rate` is in body axes, rad/s, (3,), None without place, heading or accelerometers.
    """

    record: int
    number: int
    rows: IntArray
    cell: IntArray
    seconds: FloatArray
    temperature: FloatArray
    rate: FloatArray
    up: FloatArray
    earth_rate: FloatArray | None


class Cells(NamedTuple):
    """Blocks at rest of all records, grouped into runs and cells: of each, over all runs, the time that it
    stands for, s, and temperature and rate, °C and °C/s, (n,)."""

    runs: list[Run]
    seconds: FloatArray
    temperature: FloatArray
    rate: FloatArray

    @property
    def rate_rms(self) -> float:
        """Of the temperature, °C/s."""
        return float(np.sqrt(np.average(self.rate**2, weights=self.seconds)))

    @property
    def turned(self) -> bool:
        """Whether not all runs are in one pose."""
        return any(run.up @ self.runs[0].up < TURNED for run in self.runs)


def one_way(temperatures: Sequence[FloatArray]) -> bool:
    """Return whether no run, of these temperatures in °C, both rises and falls by a fifth of the span."""
    enough = 0.2 * np.ptp(np.concatenate(temperatures))
    rise = [np.max(t - np.minimum.accumulate(t)) for t in temperatures]
    fall = [np.max(np.maximum.accumulate(t) - t) for t in temperatures]
    return bool(np.minimum(rise, fall).max() <= enough)


def _main_temperature(record: Record) -> FloatArray:
    """Return the mean of the temperatures that the channels use, °C, (n,); NaN where no gyro is at rest."""
    columns = {name for channel in GYRO if (name := record.temperature_column(channel))}
    mean = np.mean([record.means.of(name) for name in sorted(columns)], axis=0) if columns else np.nan
    return np.where(record.rest & np.isfinite(sum(map(record.means.of, GYRO))), mean, np.nan)


def group(records: Records, latitude_deg: float | None, heading_deg: float | None) -> Cells:
    """Group the blocks at rest; runs shorter than `SHORTEST_RUN_S` are left out.

    Within a cell the temperature stays within a hundredth of the span.
    """
    temperatures = [_main_temperature(record) for record in records]
    known = np.concatenate([t[np.isfinite(t)] for t in temperatures])
    width = np.ptp(known) / 100 if len(known) else 0.0
    runs: list[Run] = []
    cells = 0
    for number, (record, temperature) in enumerate(zip(records, temperatures, strict=True)):
        for index, rows in enumerate(_runs(record, np.flatnonzero(np.isfinite(temperature)))):
            samples = np.maximum(record.means.count[rows].max(axis=1), 2)
            # A block stands for more than it spans: n samples span n - 1 periods.
            seconds, t = record.means.span_s[rows] * samples / (samples - 1), temperature[rows]
            if seconds.sum() < SHORTEST_RUN_S:
                continue
            start_s = np.asarray(record.means.start_ns[rows] * 1e-9, np.float64)
            cell = _cells(start_s, seconds, t, width) + cells
            cells = int(cell[-1]) + 1
            rate = np.gradient(t, start_s) if len(rows) > 1 else np.zeros(1)
            parts = [part[np.isfinite(part)] for part in (record.means.of(name)[rows] for name in ACCEL)]
            accel = np.array([part.mean() if len(part) else np.nan for part in parts])
            up, earth = accel / np.linalg.norm(accel), None
            if latitude_deg is not None and heading_deg is not None and np.isfinite(up).all():
                north = north_in_body(up, np.deg2rad(heading_deg))
                earth = earth_rate_along(up, north, np.deg2rad(latitude_deg))
            runs.append(Run(number, index, rows, cell, seconds, t, rate, up, earth))
    every = (
        np.concatenate([np.empty(0), *(getattr(run, name) for run in runs)])
        for name in ("seconds", "temperature", "rate")
    )
    return Cells(runs, *every)


def channel_of(records: Records, cells: Cells, name: str, level_centers: FloatArray) -> Channel | None:
    """Return a channel's means over the cells, each of the nearest level, or None when it has no values, or
    none that vary."""
    column = records[0].temperature_column(name)
    if column is None or not all(record.means.has(name) for record in records):
        return None
    parts = []
    for number, run in enumerate(cells.runs):
        means, rows = records[run.record].means, run.rows
        value = means.of(name)[rows]
        if run.earth_rate is not None and name in GYRO:
            value = value - run.earth_rate["xyz".index(name[-1])]
        sent = value, means.mean_variance(name)[rows], means.of(column)[rows]
        parts.append(np.column_stack([*sent, run.seconds, run.cell, np.full(len(rows), number)]))
    blocks = np.concatenate(parts)
    value, white, temperature, seconds, cells_of, run_of = blocks[np.isfinite(blocks).all(axis=1)].T
    if not len(value) or np.ptp(value) == 0.0:
        return None
    _, first, cell = np.unique(cells_of, return_index=True, return_inverse=True)
    whole = _sum(cell, seconds)
    share = seconds / whole[cell]
    mean_temperature = _sum(cell, share * temperature)
    return Channel(
        temperature=mean_temperature,
        value=_sum(cell, share * value),
        weight=whole,
        level=np.searchsorted(0.5 * (level_centers[1:] + level_centers[:-1]), mean_temperature),
        white=_sum(cell, share**2 * white),
        seconds=whole,
        run=run_of[first].astype(np.int64),
    ).weighted()


def levels(cells: Cells) -> FloatArray:
    """Return the temperature levels, °C upwards: where the temperature dwelt, else the middles of bands."""
    cell = np.concatenate([run.cell for run in cells.runs])
    seconds = _sum(cell, cells.seconds)
    temperature = _sum(cell, cells.seconds * cells.temperature) / seconds
    low, width = temperature.min(), np.ptp(temperature) / BANDS
    order = np.argsort(temperature)
    dwelt = order[seconds[order] > 0.7 * CELL_S]
    t, s = temperature[dwelt], seconds[dwelt]
    if len(t):
        cluster = np.cumsum(np.diff(t, prepend=t[0]) > 0.25 * width, dtype=np.int64)
        center = _sum(cluster, s * t) / _sum(cluster, s)
        tight = max(np.ptp(t[cluster == c]) for c in range(len(center))) < width
        if len(center) >= 4 and tight and s.sum() > 0.6 * seconds.sum():
            return center
    band = np.minimum(((temperature - low) / (width or 1.0)).astype(np.int64), BANDS - 1)
    return np.array([np.average(temperature[band == b], weights=seconds[band == b]) for b in np.unique(band)])


def _sum(cell: IntArray, parts: FloatArray) -> FloatArray:
    return np.bincount(cell, parts).astype(np.float64)


def _runs(record: Record, rows: IntArray) -> list[IntArray]:
    """Divide blocks where the device restarted or was turned."""
    if not len(rows):
        return []
    restarted = np.diff(record.means.segment[rows], prepend=record.means.segment[rows[0]]) != 0
    accel = np.column_stack([record.means.of(name)[rows] for name in ACCEL])
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = accel / np.linalg.norm(accel, axis=1, keepdims=True)
    begins, origin = [0], direction[0]
    for i in range(1, len(rows)):
        # Without accelerometers the cosine is NaN, which is not less.
        if restarted[i] or direction[i] @ origin < TURNED:
            begins.append(i)
        if begins[-1] == i or np.isnan(origin).any():
            origin = direction[i]
    return np.split(rows, begins[1:])


def _cells(time_s: FloatArray, seconds: FloatArray, temperature: FloatArray, width: float) -> IntArray:
    """Number cells of blocks in order: not longer than `CELL_S`, not wider than `width` °C."""
    number, first = np.zeros(len(time_s), np.int64), 0
    for i in range(1, len(time_s)):
        over = time_s[i] + seconds[i] - time_s[first] > CELL_S + 1e-6
        if over or abs(temperature[i] - temperature[first]) > width:
            first = i
        number[i] = number[i - 1] + (first == i)
    return number
