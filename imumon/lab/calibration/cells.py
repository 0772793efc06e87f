"""From recordings to means at rest.

record  one recording, as means over blocks
block   10 s of samples of one record
run     the blocks at rest of one record, in one pose and without a restart between them
cell    successive blocks of one run, of nearly one temperature: what curves are fitted to
level   a temperature at which the unit dwelt, or a band of temperatures: each cell belongs to one
fold    levels that are left out of a fit together (`selection`)
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
BLOCK_S = 10.0  # length of a block: long against the sample noise, short against a chamber's ramps
LEAST_COVERED = 0.5  # a block whose samples span less than this share of it is left out
CELL_S = 300.0  # longest cell: short against a level of half an hour.  Assumed.
COS_TURNED = np.cos(np.deg2rad(5.0))  # specific force that turned further: another pose.  Assumed.
SHORTEST_RUN_S = 60.0  # assumed
# Levels; all assumed.
BANDS = 12  # of equal width, in data in which the temperature dwells nowhere
DWELT_S = 0.7 * CELL_S  # a cell that lasted longer did not end by its width: the temperature dwelt
SAME_LEVEL = 0.25  # of the width of a band: neighbours that are closer are of one level
LEAST_LEVELS_DWELT = 4  # with fewer, bands are better
LEAST_SHARE_DWELT = 0.6  # of the time: with less, much data is between the levels, and bands are better
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
        suffix = channel[-2:]  # of its axis: "_x"
        own = ("temperature_estimate" + suffix, "temperature_estimate", "temperature" + suffix, "temperature")
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
    """Reduce samples to a record; with temperature estimates and rest where stages have added them."""
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
    origin = recording.name, recording.sha256(), recording.device, recording.source.axes, recording.serial
    record = record_of(recording.blocks(), *origin)
    if not len(record.means):
        raise bad_data(f"{path}: there is no sample in this session")
    texts = *recording.warnings(), *unused_keys(Setup(), recording.source.device)
    return record, [f"{path}: {text}" for text in texts]


@dataclass(frozen=True, eq=False)
class CellMeans(Points):
    """A channel's means over cells, from all records.

    `white` is the variance that the samples' own noise leaves in each mean, if it is white, and `run` the
    number of its run among all, (n,) each.
    """

    white: FloatArray
    run: IntArray

    def weighted(self, slow: float = 0.0) -> Self:
        """Return them with weights of mean 1; `slow` is the variance of what no longer cell would average."""
        variance = self.white + slow
        positive = variance[variance > 0.0]  # a cell without noise weighs as the best of these
        weight = 1.0 / np.maximum(variance, min(positive, default=1.0))
        return replace(self, weight=weight / weight.mean())


class RestRun(NamedTuple):
    """A run that is long enough; `number` counts the runs of its record.

    `rows` are its blocks in the record; of each the time that it stands for, s, and temperature, °C, (n,).
    In body axes, (3,): `up` is the direction of the specific force, NaN without accelerometers; `earth_rate`,
    rad/s, is None without place, heading or accelerometers.
    """

    record: Record
    number: int
    rows: IntArray
    seconds: FloatArray
    temperature: FloatArray
    up: FloatArray
    earth_rate: FloatArray | None


@dataclass(frozen=True, eq=False)
class RestBlocks:
    """The blocks of all runs, run after run: of each, (n,), the index of its run, the number of its cell over
    all runs, the time that it stands for, s, and temperature and its rate, °C and °C/s."""

    runs: list[RestRun]
    run_of_block: IntArray
    cell_of_block: IntArray
    seconds: FloatArray
    temperature: FloatArray
    rate: FloatArray

    def rms(self, values: FloatArray) -> float:
        """Return the root mean square of a value of each block, (n,), over the time."""
        return float(np.sqrt(np.average(values**2, weights=self.seconds)))

    @property
    def turned(self) -> bool:
        """Whether not all runs are in one pose."""
        return any(run.up @ self.runs[0].up < COS_TURNED for run in self.runs)

    @cached_property
    def levels(self) -> FloatArray:
        """Levels of temperature, °C upwards."""
        seconds = _sum(self.cell_of_block, self.seconds)
        return find_levels(seconds, _sum(self.cell_of_block, self.seconds * self.temperature) / seconds)


def find_levels(seconds: FloatArray, temperature: FloatArray) -> FloatArray:
    """Return the levels of cells, °C upwards: where the temperature dwelt, else the middles of bands.

    `seconds`, `temperature` (n,): length and mean temperature, °C, of each cell.
    """
    band_width = np.ptp(temperature) / BANDS
    upwards = np.argsort(temperature)
    dwelt = upwards[seconds[upwards] > DWELT_S]
    dwelt_s, degc = seconds[dwelt], temperature[dwelt]
    if dwelt_s.sum() > LEAST_SHARE_DWELT * seconds.sum():
        level = np.cumsum(np.diff(degc, prepend=degc[0]) > SAME_LEVEL * band_width, dtype=np.int64)
        centers = _sum(level, dwelt_s * degc) / _sum(level, dwelt_s)
        widest = max(np.ptp(degc[level == k]) for k in range(len(centers)))
        if len(centers) >= LEAST_LEVELS_DWELT and widest < band_width:
            return centers
    band = np.minimum(((temperature - temperature.min()) / (band_width or 1.0)).astype(np.int64), BANDS - 1)
    return np.array([np.average(temperature[band == k], weights=seconds[band == k]) for k in np.unique(band)])


def one_way(temperatures: Sequence[FloatArray]) -> bool:
    """Return whether no run, of these temperatures in °C, both rises and falls by a fifth of the span."""
    rise = [np.max(t - np.minimum.accumulate(t)) for t in temperatures]
    fall = [np.max(np.maximum.accumulate(t) - t) for t in temperatures]
    return bool(np.minimum(rise, fall).max() <= 0.2 * np.ptp(np.concatenate(temperatures)))  # assumed


def _main_temperature(record: Record) -> FloatArray:
    """Return the mean of the temperatures that the channels use, °C, (n,); NaN where no gyro is at rest."""
    columns = sorted({str(record.temperature_column(channel)) for channel in GYRO})
    mean = np.mean([record.means.of(name) for name in columns], axis=0)
    has_rates = np.isfinite([record.means.of(name) for name in GYRO]).all(axis=0)
    return np.where(record.rest & has_rates, mean, np.nan)


def group(records: Records, latitude_deg: float | None, heading_deg: float | None) -> RestBlocks:
    """Group the blocks at rest; runs shorter than `SHORTEST_RUN_S` are left out.

    Within a cell the temperature stays within a hundredth of the span.
    """
    temperatures = [_main_temperature(record) for record in records]
    known = np.concatenate([t[np.isfinite(t)] for t in temperatures])
    width = np.ptp(known) / 100 if len(known) else 0.0
    runs: list[RestRun] = []
    cells, rates = list[int](), list[float]()
    for record, temperature in zip(records, temperatures, strict=True):
        for number, rows in enumerate(_runs(record, np.flatnonzero(np.isfinite(temperature)))):
            samples = np.maximum(record.means.count[rows].max(axis=1), 2)
            # A block stands for more than it spans: n samples span n - 1 periods.
            seconds = record.means.span_s[rows] * samples / (samples - 1)
            if seconds.sum() < SHORTEST_RUN_S:
                continue
            t = temperature[rows]
            start_s = np.asarray(record.means.start_ns[rows] * 1e-9, np.float64)
            cells.extend(_cells(start_s, seconds, t, width) + (cells[-1] + 1 if cells else 0))
            rates.extend(np.gradient(t, start_s) if len(rows) > 1 else [0.0])
            parts = [part[np.isfinite(part)] for part in (record.means.of(name)[rows] for name in ACCEL)]
            force = np.array([part.mean() if len(part) else np.nan for part in parts])
            up = force / np.linalg.norm(force)
            earth_rate = None
            if latitude_deg is not None and heading_deg is not None and np.isfinite(up).all():
                north = north_in_body(up, np.deg2rad(heading_deg))
                earth_rate = earth_rate_along(up, north, np.deg2rad(latitude_deg))
            runs.append(RestRun(record, number, rows, seconds, t, up, earth_rate))
    return RestBlocks(
        runs,
        run_of_block=np.array([k for k, run in enumerate(runs) for _ in run.rows]),
        cell_of_block=np.array(cells),
        seconds=np.array([seconds for run in runs for seconds in run.seconds]),
        temperature=np.array([temperature for run in runs for temperature in run.temperature]),
        rate=np.array(rates),
    )


def channel_of(records: Records, at_rest: RestBlocks, name: str) -> CellMeans | None:
    """Return a channel's means over the cells, each of the nearest level, or None when it has no values, or
    none that vary."""
    column = records[0].temperature_column(name)
    if column is None or not all(record.means.has(name) for record in records):
        return None
    parts = []
    for run in at_rest.runs:
        means = run.record.means
        value = means.of(name)
        if run.earth_rate is not None and name in GYRO:
            value = value - run.earth_rate[GYRO.index(name)]
        parts.append(np.column_stack([value, means.mean_variance(name), means.of(column)])[run.rows])
    blocks = np.concatenate(parts)
    known = np.isfinite(blocks).all(axis=1)
    value, white, temperature = blocks[known].T
    if not len(value) or np.ptp(value) == 0.0:
        return None
    # Cells without a value of this channel have no mean: those that have one are numbered anew.
    _, first, cell = np.unique(at_rest.cell_of_block[known], return_index=True, return_inverse=True)
    seconds = at_rest.seconds[known]
    cell_seconds = _sum(cell, seconds)
    share = seconds / cell_seconds[cell]
    mean_temperature = _sum(cell, share * temperature)
    centers = at_rest.levels  # by the mean over the thermometers; the channel's own may differ from it
    return CellMeans(
        temperature=mean_temperature,
        value=_sum(cell, share * value),
        weight=cell_seconds,  # replaced by `weighted`
        level=np.searchsorted(0.5 * (centers[1:] + centers[:-1]), mean_temperature),
        white=_sum(cell, share**2 * white),
        run=at_rest.run_of_block[known][first],
    ).weighted()


def _sum(group: IntArray, values: FloatArray) -> FloatArray:
    return np.bincount(group, values).astype(np.float64)


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


def _cells(start_s: FloatArray, seconds: FloatArray, temperature: FloatArray, width: float) -> IntArray:
    """Number the cells of blocks: not longer than `CELL_S`, within `width` °C of the cell's first block."""
    number = np.zeros(len(start_s), np.int64)
    first = 0  # block of the cell
    for i in range(1, len(start_s)):
        too_long = start_s[i] + seconds[i] - start_s[first] > CELL_S + 1e-6  # rounding is no excess
        if too_long or abs(temperature[i] - temperature[first]) > width:
            first = i
        number[i] = number[i - 1] + (first == i)
    return number
