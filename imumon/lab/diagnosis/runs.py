"""Recordings as runs from power-on, in means of slots: what is read, what is training, and what is test."""

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.clock.channel import CLOCK, UNIT, rate_ppm, with_delay
from imumon.columns import KNOWN, TEMPERATURES
from imumon.effects.vibration import SECOND_NS, VIBRATION
from imumon.errors import bad_data
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.filters.rounding import digits, grid_step
from imumon.recordings.reduced import ACCEL, GYRO, KeptSlots, Reduced, reduce
from imumon.recordings.source import Count, no_count, open_recording

Names = Sequence[str]
Columns = dict[str, FloatArray]  # by name
CHANNELS = (*GYRO, *ACCEL)
# What is diagnosed by default; the clock of the device only where all recordings have it.
SENSORS = ("gyro", "accel", CLOCK)
# Known columns that may drive a bias besides temperature and specific force.
DRIVERS = ("pressure", *(f"mag_{axis}" for axis in "xyz"))
READ = (*CHANNELS, *TEMPERATURES, *DRIVERS)
LONGEST_GAP_S = 6 * 3600  # a longer gap begins another run: the unit's state is unknown after it.  Assumed.
SHORTEST_RUN_S = 300.0  # at rest, or the run is not used: it would have fewer than ten means of 30 s
MOSTLY = 0.5  # share of its time from which on a run counts as one of a unit at rest (assumed)
MOST_SLOTS = 7200  # of a run in memory: two hours of seconds; a column takes 16 bytes of each
KEPT = 100_000  # samples of a channel that are kept, evenly spaced over the recording, to bound the memory


class Samples(NamedTuple):
    """Statistics of the samples of a channel in a recording."""

    step: float  # of the grid on which the values lie; 0 without one
    scatter: float  # standard deviation of a sample about its neighbour
    ratio: float = np.inf  # noise before rounding, in steps; infinite where these are far finer
    atom: float = np.nan  # value that is far more frequent than its neighbours; NaN without one
    atom_share: float = 0.0  # of the samples


@dataclass(frozen=True)
class Origin:
    """Where a run comes from; two are the same that have the same bytes, whatever their names."""

    session: str = field(compare=False)  # or table
    index: int  # number of the run in it
    sha256: str
    device: str | None = field(default=None, compare=False)
    serial: str | None = field(default=None, compare=False)


@dataclass
class Run:
    """One run from power-on in means over n slots; a slot without samples is NaN."""

    name: str
    time_s: FloatArray  # middle of each slot since the first sample, (n,)
    count: Columns  # samples of each column, (n,)
    mean: Columns  # of these, SI units or °C, (n,)
    variance: Columns  # of these; NaN with fewer than two, (n,)
    rest: FloatArray  # share of the samples at rest, (n,)
    origin: Origin | None = None  # None of what is not from a file
    start_ns: int | None = None  # device time of the first sample; None when it is not known
    begun_in: str = ""  # name of the run that began at this power-on, if another: jumps in that persist
    woven: bool = False  # whether it alternates with training, so that any smooth course interpolates it
    warnings: tuple[str, ...] = ()  # why its numbers may be unfit, as where the device corrects its rates
    slot_s: float = 1.0  # whole seconds: more than one where a log is slower than a sample a second
    samples: Mapping[str, Samples] = field(default_factory=dict)  # of channels, in the whole recording

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return len(self.time_s) * self.slot_s

    @property
    def at_rest(self) -> BoolArray:
        """Slots in which the unit was at rest all the time, (n,)."""
        return np.asarray(self.rest == 1.0)

    @property
    def there(self) -> BoolArray:
        """Slots with samples, (n,)."""
        return np.asarray(np.any([*self.count.values()], axis=0))

    @property
    def rest_share(self) -> float:
        """Share of the slots with samples in which the unit was at rest."""
        return float(self.at_rest[self.there].mean()) if self.there.any() else 0.0


Runs = Sequence[Run]


def read_runs(
    path: Path,
    map_path: Path | None = None,
    at_rest: bool = False,
    sensors: Names = SENSORS,
    count: Count = no_count,
) -> list[Run]:
    """Read a session, or a table with its map (one that imumon wrote needs none), as runs from power-on.

    `sensors` are to be diagnosed, see `channels_of`; `at_rest` declares the unit at rest all the time.

    Raises BAD_DATA when there is nothing to read, no run of five minutes, or a table that needs a map.
    """
    recording = open_recording(path, lambda _: [RestDetector()], map_path, count)
    blocks, first = recording.blocks(), list[SampleBlock]()
    # The first thousand rows show the rate of a log.
    while sum(map(len, first)) < 1000 and (more := next(blocks, None)) is not None:
        first.append(more)
    wanted = channels_of(sensors, first[0].columns) if first else []
    further = [*wanted]
    # The detector names what it made of a session, a map what was measured.  Of a table that imumon wrote
    # nothing shows which of its further columns are made of the gyros themselves: they are not read.
    if first and (recording.source.session or map_path):
        further += further_columns(first[0], {column.name for column in RestDetector().columns})
    watcher = Watcher(wanted)
    samples: Iterable[SampleBlock] = watcher.through(chain(first, blocks))
    if CLOCK in sensors and CLOCK not in wanted:
        samples, further = with_delay(samples), [*further, CLOCK]
    # This reads the file; statistics, warnings and fingerprint are complete only behind it.
    every_run = collect(samples, recording.name, further, _slot_s(first, wanted))
    runs = [run for run in every_run if run.duration_s >= SHORTEST_RUN_S]
    if not runs:
        longest = max((run.duration_s for run in every_run), default=0.0)
        raise bad_data(
            f"{path}: too short: its longest run is {longest:.0f} s; {SHORTEST_RUN_S:.0f} s are needed",
            "record the unit at rest for an hour or more while its temperature changes",
        )
    warnings = tuple(f"{path}: {text}" for text in recording.warnings())
    sha256, statistics = recording.sha256(), watcher.samples()
    return [
        replace(
            run,
            rest=np.ones_like(run.rest) if at_rest else run.rest,
            origin=Origin(recording.name, number, sha256, recording.device, recording.serial),
            warnings=warnings,
            samples=statistics,
        )
        for number, run in enumerate(runs)
    ]


def further_columns(block: SampleBlock, made: Container[str]) -> list[str]:
    """Return the measured columns beyond the known ones: no counters, and none that stages made."""
    measured = [name for name, values in block.columns.items() if values.dtype == np.float64]
    return [name for name in measured if name not in KNOWN and name not in made]


def _slot_s(blocks: Sequence[SampleBlock], channels: Names) -> float:
    """Return the length of a slot in which a log has a sample: a second, or more for a slower one."""
    times = [np.empty(0, np.int64)]
    for block in blocks:
        known = [np.isfinite(block[name]) for name in channels if name in block]
        times += [block["device_time_ns"][np.any(known, axis=0)]] if known else []
    steps = np.diff(np.concatenate(times))
    steps = steps[steps > 0]
    # A period of a second by a clock that is off by a percent is a second: few slots are empty then.
    return float(max(1, np.ceil(np.median(steps) / SECOND_NS / 1.01))) if len(steps) else 1.0


def collect(blocks: Iterable[SampleBlock], name: str, further: Names = (), slot_s: float = 1.0) -> list[Run]:
    """Return the runs in a stream of samples with times; without ``at_rest`` it is taken as at rest.

    `further` are columns beside the known ones.  A log slower than a sample a second is too slow for a rest
    detector: a slot is then at rest when it is like its neighbours.
    """
    means = reduce(blocks, tuple(dict.fromkeys((*READ, *further))), slot_s)
    gap = np.diff(means.number, prepend=0) > LONGEST_GAP_S / slot_s
    another = np.diff(means.run, prepend=-1) != 0  # true of the first, which [1:] leaves out
    groups = np.split(np.arange(len(means)), np.flatnonzero(another | gap)[1:])
    names = [name] if len(groups) == 1 else [f"{name}, run {index + 1}" for index in range(len(groups))]
    rest = means.quiet().astype(np.float64) if slot_s > 1.0 else np.nan_to_num(means.rest_share, nan=1.0)
    return [_run(means, rest, rows, text) for rows, text in zip(groups, names, strict=True) if len(rows)]


def _run(means: Reduced, rest: FloatArray, rows: IntArray, name: str) -> Run:
    """Return these slots on a grid of all slots from the first of them."""
    slot = means.number[rows] - means.number[rows[0]]
    n = int(slot[-1]) + 1

    def on_grid(values: FloatArray | IntArray, missing: float = np.nan) -> FloatArray:
        grid = np.full(n, missing)
        grid[slot] = values[rows]
        return grid

    indices = {name: at for at, name in enumerate(means.names) if means.count[rows, at].any()}
    mean = {name: on_grid(means.mean[:, at]) for name, at in indices.items()}
    variance = {name: on_grid(means.variance[:, at]) for name, at in indices.items()}
    if CLOCK in indices:
        mean[CLOCK] = rate_ppm(on_grid(means.smallest[:, indices[CLOCK]]), means.slot_s)
        variance[CLOCK] = np.full(n, np.nan)  # the samples of a slot are delays, no rates
    if variance.keys() >= set(ACCEL):
        scatter = np.sum([variance[axis] for axis in ACCEL], axis=0)
        if np.isfinite(scatter).mean() > 0.5:  # in most seconds (assumed)
            mean[VIBRATION] = scatter  # (m/s²)²
    return Run(
        name=name,
        time_s=(np.arange(n, dtype=np.float64) + 0.5) * means.slot_s,
        count={name: on_grid(means.count[:, at], 0.0) for name, at in indices.items()},
        mean=mean,
        variance=variance,
        rest=on_grid(rest, 0.0),
        start_ns=int(means.start_ns[rows[0]]),
        slot_s=means.slot_s,
    )


def channels_of(sensors: Iterable[str], columns: Container[str]) -> list[str]:
    """Return which of some columns are of sensors: of gyro gyro_x, gyro_y and gyro_z, of pressure itself."""
    possible = [name for sensor in sensors for name in (sensor, *(f"{sensor}_{axis}" for axis in "xyz"))]
    return [name for name in dict.fromkeys(possible) if name in columns]


def unit_of(channel: str) -> str:
    """Return the unit of a channel; empty for a column of the log's own."""
    if channel == CLOCK:
        return UNIT
    return KNOWN[channel].unit if channel in KNOWN else ""


class Watcher:
    """Collects statistics of the samples of some channels while blocks pass."""

    def __init__(self, channels: Names) -> None:
        # Samples, and the step to each from the one before, (n, 2).
        self._kept = {name: [np.empty((0, 2))] for name in channels}
        self._stride, self._rows = 1, 0

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks unchanged."""
        for block in blocks:
            # From the first of these rows whose number in the recording is a multiple of the stride.
            chosen = slice(-self._rows % self._stride, None, self._stride)
            self._rows += len(block)
            for name in self._kept.keys() & block.columns.keys():
                values = block[name]
                steps = np.diff(values, prepend=np.nan)
                self._kept[name].append(np.column_stack([values, steps])[chosen].astype(np.float64))
            while self._rows > KEPT * self._stride:
                for name, kept in self._kept.items():
                    self._kept[name] = [np.concatenate(kept)[::2]]
                self._stride *= 2
            yield block

    def samples(self) -> dict[str, Samples]:
        """Return the statistics of each channel that has values."""
        joined = {name: np.concatenate(kept) for name, kept in self._kept.items()}
        known = {name: rows[np.isfinite(rows[:, 0])].T for name, rows in joined.items()}
        return {
            name: _samples(values, steps)
            for name, (values, steps) in known.items()
            if len(values) > 2 and np.isfinite(steps).any()
        }


def _samples(values: FloatArray, steps: FloatArray) -> Samples:
    """Return the statistics; what a stuck sensor repeats counts once, so that no value of it is frequent."""
    fresh, known = steps != 0.0, np.isfinite(steps)
    scatter = np.sqrt(np.mean(steps[known] ** 2) / 2.0)
    moved = steps[known & fresh]
    moved_scatter = np.sqrt(np.mean(moved**2) / 2.0) if len(moved) else np.nan  # without what is stuck
    distinct, where = np.unique(values, return_inverse=True)
    count = np.bincount(where, weights=fresh)
    step = grid_step(distinct, len(values))
    rounded = digits(values) if step > 0.0 else None
    without_atom = Samples(step, scatter, rounded.ratio if rounded else np.inf)
    most = np.argmax(count)
    padded = np.pad(count, 1)
    beside = max(padded[most], padded[most + 2], 1.0)
    share = count[most] / max(count.sum(), 1.0)
    coarse = step > 0.0 and not step < moved_scatter  # true of NaN, too
    # A percent of all samples, and ten times more than its neighbours have, are not by chance (assumed).
    if coarse or len(distinct) < 3 or share < 0.01 or count[most] < 10.0 * beside:
        return without_atom
    return without_atom._replace(atom=distinct[most], atom_share=share)


class BoundedRun:
    """Sums over slots of 1, 2, 4, ... s: where they would be too many, neighbours are added in pairs.

    Of gyros only the seconds at rest are added, so that a slot keeps these where the unit moved in others.
    """

    def __init__(self, names: Names) -> None:
        self._names = [*names, VIBRATION]
        self._gyros = [at for at, name in enumerate(names) if name in GYRO]
        self._accel = [at for at, name in enumerate(names) if name in ACCEL]
        # [:, 0] number of samples, [:, 1] their sum; of vibration, a value a second, those of the seconds.
        self._sums = np.zeros((MOST_SLOTS, 2, len(self._names)))
        self._width, self._last, self._begun_ns = 1, -1, 0

    def take(self, seconds: KeptSlots) -> float:
        """Add seconds, and return the time from the first sample to the end of the last of them, s; the last
        column of them is the share at rest, which is not one of the run's."""
        if self._last < 0:
            self._begun_ns = int(seconds.start_ns[0])
        second = (seconds.start_ns - self._begun_ns) // SECOND_NS
        self._last = int(second[-1])
        while self._last // self._width >= MOST_SLOTS:
            self._sums[: MOST_SLOTS // 2] = self._sums[::2] + self._sums[1::2]
            self._sums[MOST_SLOTS // 2 :] = 0.0
            self._width *= 2
        count = seconds.count[:, :-1].astype(np.float64)
        # `KeptSlots` has variances about the mean over n, a run those over n - 1.
        unbiased = seconds.variance[:, self._accel] / (1.0 - 1.0 / np.maximum(count[:, self._accel], 2.0))
        has_vibration = (count[:, self._accel] > 1.0).all(axis=1) & (len(self._accel) == len(ACCEL))
        count[:, self._gyros] *= (seconds.mean[:, -1] == 1.0)[:, None]
        count = np.column_stack([count, has_vibration])
        mean = np.where(count > 0, np.column_stack([seconds.mean[:, :-1], unbiased.sum(axis=1)]), 0.0)
        np.add.at(self._sums, second // self._width, np.stack([count, mean * count], axis=1))
        return float(seconds.end_ns[-1] - self._begun_ns) / SECOND_NS

    def run(self) -> Run:
        """Return the run so far, in slots that have ended; at rest where a gyro was."""
        n = max(1, (self._last + 1) // self._width)
        count, total = self._sums[:n].swapaxes(0, 1).copy()
        mean = np.where(count > 0, total / np.maximum(count, 1.0), np.nan)
        there = {name: at for at, name in enumerate(self._names) if at in self._gyros or count[:, at].any()}
        return Run(
            name="this session",
            time_s=np.asarray((np.arange(n) + 0.5) * self._width),
            count={name: count[:, at] for name, at in there.items()},
            mean={name: mean[:, at] for name, at in there.items()},
            variance={},
            rest=(count[:, self._gyros] > 0).all(axis=1).astype(np.float64),
            slot_s=float(self._width),
        )
