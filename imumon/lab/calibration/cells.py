"""Means of recordings at rest, over cells of nearly one temperature.

record  one recording, as means over blocks
block   10 s of samples of one record
run     the blocks at rest of one record, in one pose and without a restart between them
cell    successive blocks of one run, of nearly one temperature: curves are fitted to its means
level   a temperature at which the unit dwelt, or a band of temperatures: each cell belongs to one
fold    levels that are left out of a fit together (`selection`)
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

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
BLOCK_S = 10.0  # length of a block: long enough to average the noise, short against a chamber's ramps
COVERED_S = 0.5 * BLOCK_S  # a block whose samples span less is left out.  Assumed.
COS_TURNED = np.cos(np.deg2rad(5.0))  # specific force that turned further: another pose.  Assumed.
SHORTEST_RUN_S = 60.0  # assumed
# Cells; both assumed.
CELL_S = 300.0  # longest: short against a level of half an hour
CELLS_IN_SPAN = 100  # the span is so many times as wide as a cell may depart from its first block
# Levels; all assumed.
BANDS = 12  # of equal width, in data in which the temperature dwells nowhere
DWELT_S = 0.7 * CELL_S  # where a cell lasted longer the temperature counts as dwelling
SAME_LEVEL = 0.25  # of the width of a band: neighbours that are closer are of one level
LEAST_LEVELS_DWELT = 4  # with fewer, bands are better
LEAST_SHARE_DWELT = 0.6  # of the time: with less, much data is between the levels, and bands are better

# A warning, where `one_way`.
ONE_WAY = "no session both warms and cools: what lag, hysteresis or warm-up do is then part of the curve"


class Record(NamedTuple):
    """The n blocks of one recording."""

    name: str
    sha256: str  # fingerprint of its bytes
    means: Reduced  # over the blocks, of `COLUMNS`
    rest: BoolArray  # which blocks are at rest, and covered by samples, (n,)
    device: str | None = None
    axes: BodyAxes | None = None
    serial: str | None = None

    def temperature_column(self, channel: str) -> str:
        """Return the column with a channel's temperature: the first of these that there is; empty if none."""
        suffix = channel[-2:]  # of its axis: "_x"
        own = ("temperature_estimate" + suffix, "temperature_estimate", "temperature" + suffix, "temperature")
        return next((name for name in own if self.means.has(name)), "")


def record_of(blocks: Iterable[SampleBlock], name: str, sha256: str) -> Record:
    """Reduce samples to a record; with temperature estimates and rest where stages have added them."""
    means = reduce(blocks, COLUMNS, BLOCK_S)
    return Record(name, sha256, means, rest=means.at_rest() & (means.span_s >= COVERED_S))


def read_session(path: Path, count: Count = no_count) -> tuple[Record, list[str]]:
    """Read a session, recorded or imported; return its record, and what the user should know of it.

    Raises BAD_DATA when there is no session, or it cannot be read.
    """
    recording = open_recording(
        path,
        lambda device: [TemperatureRate(parameters=device.temperature if device else None), RestDetector()],
        count=count,
    )
    record = record_of(recording.blocks(), recording.name, recording.sha256())._replace(
        device=recording.device, axes=recording.source.axes, serial=recording.serial
    )
    if not len(record.means):
        raise bad_data(f"{path}: there is no sample in this session")
    # The recording's warnings are complete now that all blocks were read.
    texts = *recording.warnings(), *unused_keys(Setup(), recording.source.device)
    return record, [f"{path}: {text}" for text in texts]


@dataclass(frozen=True, eq=False)
class CellMeans(Points):
    """A channel's means over cells, from all records."""

    white: FloatArray  # variance that the samples' own noise leaves in each mean, if it is white, (n,)
    run: IntArray  # index in `RestBlocks.runs`, (n,)


def weight_of(variance: FloatArray) -> FloatArray:
    """Return the weights, with mean 1, of means of these variances, (n,)."""
    least = min(variance[variance > 0.0], default=1.0)  # without noise: as the best of those with noise
    weight = 1.0 / np.maximum(variance, least)
    return np.asarray(weight / weight.mean())


class RestRun(NamedTuple):
    """A run that is long enough, of n blocks."""

    record: Record
    number: int  # among all runs of its record, from 0
    rows: IntArray  # its blocks in the record, (n,)
    start_s: FloatArray  # device time at which each begins, s, (n,)
    seconds: FloatArray  # time that each stands for, s, (n,)
    temperature: FloatArray  # °C, (n,)
    rate: FloatArray  # of the temperature, °C/s, (n,)
    up: FloatArray  # direction of the specific force, body axes, (3,); NaN without accelerometers


@dataclass(frozen=True, eq=False)
class RestBlocks:
    """The n blocks of all runs, run after run."""

    records: Sequence[Record]  # also those without a run
    runs: list[RestRun]
    run_of_block: IntArray  # index in `runs`, (n,)
    cell_of_block: IntArray  # number of the cell among those of all runs, (n,)
    seconds: FloatArray  # time that each stands for, s, (n,)
    temperature: FloatArray  # mean over the gyros' thermometers, °C, (n,)
    rate: FloatArray  # of the temperature, °C/s, (n,)
    # To be taken off each run, rad/s, body axes, (runs, 3): 0 without a place, NaN without accelerometers.
    earth_rate: FloatArray

    def rms(self, values: FloatArray) -> float:
        """Return the root mean square of a value of each block, (n,), over the time."""
        return float(np.sqrt(np.average(values**2, weights=self.seconds)))

    def of(self, column: str) -> FloatArray:
        """Return the means of a column, (n,)."""
        return np.concatenate([run.record.means.of(column)[run.rows] for run in self.runs])

    def temperature_of(self, channel: str) -> FloatArray:
        """Return the temperature of a channel's own thermometer, °C, (n,)."""
        return self.of(self.records[0].temperature_column(channel))

    @property
    def turned(self) -> bool:
        """Whether a run is in another pose than the first."""
        return any(run.up @ self.runs[0].up < COS_TURNED for run in self.runs)

    @cached_property
    def levels(self) -> FloatArray:
        """Levels, °C upwards: where the temperature dwelt, else the mean of each band that has data."""
        seconds = _sum(self.cell_of_block, self.seconds)
        temperature = _sum(self.cell_of_block, self.seconds * self.temperature) / seconds
        band_width = np.ptp(temperature) / BANDS
        upwards = np.argsort(temperature)
        dwelt = upwards[seconds[upwards] > DWELT_S]
        dwelt_s, degc = seconds[dwelt], temperature[dwelt]
        if dwelt_s.sum() > LEAST_SHARE_DWELT * seconds.sum():
            level = np.cumsum(np.diff(degc, prepend=degc[0]) > SAME_LEVEL * band_width, dtype=np.int64)
            levels = _sum(level, dwelt_s * degc) / _sum(level, dwelt_s)
            # A chain of close neighbours, as on a slow ramp, may be as wide as a band: that is no level.
            widest = max(np.ptp(degc[level == k]) for k in range(len(levels)))
            if len(levels) >= LEAST_LEVELS_DWELT and widest < band_width:
                return levels
        band = np.minimum(((temperature - temperature.min()) / band_width).astype(np.int64), BANDS - 1)
        return np.array(
            [np.average(temperature[band == k], weights=seconds[band == k]) for k in np.unique(band)]
        )


def one_way(temperatures: Sequence[FloatArray]) -> bool:
    """Return whether no run, of these temperatures in °C, both rises and falls by a fifth of the span."""
    # The most that each is above its lowest value so far, and below its highest.
    rise = [np.max(t - np.minimum.accumulate(t)) for t in temperatures]
    fall = [np.max(np.maximum.accumulate(t) - t) for t in temperatures]
    return bool(np.minimum(rise, fall).max() <= 0.2 * np.ptp(np.concatenate(temperatures)))  # assumed


def find_rest(records: Sequence[Record], latitude_deg: float | None, heading_deg: float | None) -> RestBlocks:
    """Divide the blocks at rest into runs and cells; runs shorter than `SHORTEST_RUN_S` are left out."""
    runs = [run for record in records for run in _rest_runs(record)]
    run_of_block = np.array([k for k, run in enumerate(runs) for _ in run.rows])
    blocks = [np.column_stack([run.start_s, run.seconds, run.temperature, run.rate]) for run in runs]
    start_s, seconds, temperature, rate = np.concatenate([np.empty((0, 4)), *blocks]).T  # also of no run
    rest_degc = [degc for record in records for degc in _main_temperature(record) if np.isfinite(degc)]
    width = np.ptp(rest_degc) / CELLS_IN_SPAN if rest_degc else 0.0
    cell_of_block = _cells(run_of_block, start_s, seconds, temperature, width)
    earth_rate = np.zeros((len(runs), 3))
    if latitude_deg is not None and heading_deg is not None:
        for k, run in enumerate(runs):
            north = north_in_body(run.up, np.deg2rad(heading_deg))
            earth_rate[k] = earth_rate_along(run.up, north, np.deg2rad(latitude_deg))
    return RestBlocks(records, runs, run_of_block, cell_of_block, seconds, temperature, rate, earth_rate)


def _main_temperature(record: Record) -> FloatArray:
    """Return the mean over the gyros' thermometers, °C, (n,); NaN unless at rest with all gyros."""
    columns = sorted({record.temperature_column(channel) for channel in GYRO})
    is_used = record.rest & np.isfinite([record.means.of(name) for name in GYRO]).all(axis=0)
    return np.where(is_used, np.mean([record.means.of(name) for name in columns], axis=0), np.nan)


def _rest_runs(record: Record) -> Iterator[RestRun]:
    """Yield the runs of a record that are long enough."""
    means = record.means
    temperature = _main_temperature(record)
    for number, rows in enumerate(_runs(record, np.flatnonzero(np.isfinite(temperature)))):
        # A block stands for more than it spans: n samples, of its fastest column, span n - 1 periods.
        samples = np.maximum(means.count[rows].max(axis=1), 2)
        seconds = means.span_s[rows] * samples / (samples - 1)
        if seconds.sum() < SHORTEST_RUN_S:
            continue
        parts = [part[np.isfinite(part)] for part in (means.of(name)[rows] for name in ACCEL)]
        force = np.array([part.mean() if len(part) else np.nan for part in parts])
        up = force / np.linalg.norm(force)
        start_s = np.asarray(means.start_ns[rows] * 1e-9)
        rate = np.gradient(temperature[rows], start_s) if len(rows) > 1 else np.zeros(1)
        yield RestRun(record, number, rows, start_s, seconds, temperature[rows], rate, up)


def _runs(record: Record, rows: IntArray) -> list[IntArray]:
    """Divide blocks where the device restarted or was turned."""
    if not len(rows):
        return []
    # A clock that goes back is a restart: decoding and import begin a segment there, or refuse it.
    restarted = np.diff(record.means.segment[rows], prepend=record.means.segment[rows[0]]) != 0
    accel = np.column_stack([record.means.of(name)[rows] for name in ACCEL])
    with np.errstate(invalid="ignore", divide="ignore"):
        direction = accel / np.linalg.norm(accel, axis=1, keepdims=True)
    begins, origin = list[int](), direction[0]
    for i in range(1, len(rows)):
        # Without accelerometers the cosine is NaN, which is not less.
        is_first = restarted[i] or direction[i] @ origin < COS_TURNED
        if is_first:
            begins.append(i)
        if is_first or np.isnan(origin).any():  # the pose of a run is that of the first block that has one
            origin = direction[i]
    return np.split(rows, begins)


def _cells(
    run: IntArray, start_s: FloatArray, seconds: FloatArray, temperature: FloatArray, width: float
) -> IntArray:
    """Number the cells of blocks: of one run, at most `CELL_S` long, within `width` °C of the first block."""
    begins = np.zeros(len(run), np.int64)
    first = 0  # block of the cell
    for i in range(1, len(run)):
        too_long = start_s[i] + seconds[i] - start_s[first] > CELL_S + 1e-6  # rounding is no excess
        too_far = abs(temperature[i] - temperature[first]) > width
        if run[i] != run[first] or too_long or too_far:
            first = i
            begins[i] = 1
    return np.cumsum(begins)


def channel_of(at_rest: RestBlocks, name: str) -> CellMeans | None:
    """Return a channel's means over the cells; None where it has no values, or none that vary."""
    if not all(record.means.has(name) for record in at_rest.records):
        return None
    value = at_rest.of(name)
    white = np.concatenate([run.record.means.mean_variance(name)[run.rows] for run in at_rest.runs])
    known = np.isfinite(value + white)
    if len(np.unique(value[known])) < 2:
        return None
    if name in GYRO:
        value = value - at_rest.earth_rate[at_rest.run_of_block, GYRO.index(name)]
    # Cells without a value of this channel have no mean: those that have one are numbered anew.
    _, first, cell = np.unique(at_rest.cell_of_block[known], return_index=True, return_inverse=True)
    seconds = at_rest.seconds[known]
    share = seconds / _sum(cell, seconds)[cell]
    between_levels = 0.5 * (at_rest.levels[1:] + at_rest.levels[:-1])
    white_of_cell = _sum(cell, share**2 * white[known])
    return CellMeans(
        temperature=_sum(cell, share * at_rest.temperature_of(name)[known]),
        value=_sum(cell, share * value[known]),
        weight=weight_of(white_of_cell),
        # By the thermometers that the levels are of: the channel's own may differ from them.
        level=np.searchsorted(between_levels, _sum(cell, share * at_rest.temperature[known])),
        white=white_of_cell,
        run=at_rest.run_of_block[known][first],
    )


def _sum(group: IntArray, values: FloatArray) -> FloatArray:
    return np.bincount(group, values).astype(np.float64)
