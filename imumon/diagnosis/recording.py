"""Recordings read for the diagnosis: means of a second, or of a sample, one run from each power-on."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.clock.channel import CLOCK, UNIT, rate_ppm, with_delay
from imumon.columns import KNOWN
from imumon.diagnosis.values import Look, Watcher
from imumon.effects.vibration import VIBRATION
from imumon.errors import ImumonError, Reason
from imumon.recordings.reader import Stages, no_stages, open_recording
from imumon.recordings.reduced import ACCEL, GYRO, TEMPERATURES, Reduced, reduce

CHANNELS = (*GYRO, *ACCEL)
SENSORS = ("gyro", "accel", CLOCK)
"""What is diagnosed where nothing is said; the clock of the device only where all recordings have it."""
DRIVERS = ("pressure", *(f"mag_{axis}" for axis in "xyz"))
"""Of the columns that are known, what may drive a bias besides temperature and specific force."""
READ = (*CHANNELS, *TEMPERATURES, *DRIVERS)
SECOND_NS = 1_000_000_000
LOOKED_AT = 1000
"""Rows from which the rate of a log is told."""
LONGEST_GAP_S = 6 * 3600
"""A longer gap begins another run: nothing is known of what was between."""
SHORTEST_RUN_S = 300.0
"""What a restart leaves behind that is shorter is passed over."""


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a run comes from: session or table, its number in it, fingerprint of its bytes, and unit."""

    session: str
    index: int
    sha256: str
    device: str | None = None
    serial: str | None = None


@dataclass(slots=True)
class Run:
    """One run from power-on in means of a slot, a second in most; a slot without samples is NaN."""

    name: str
    """Where it comes from."""
    time_s: FloatArray
    """Middle of each slot since the first sample, (n,)."""
    count: dict[str, FloatArray]
    """Samples in each slot, (n,) each."""
    mean: dict[str, FloatArray]
    """Mean of channels in SI units and of temperatures in °C, (n,) each."""
    variance: dict[str, FloatArray]
    """Variance of the samples within each slot, (n,) each; NaN with fewer than two."""
    rest: FloatArray
    """Share of the samples at which the unit was at rest, (n,)."""
    origin: Origin | None = None
    """None when it is not from a file."""
    start_ns: int | None = None
    """Device time of the first sample; None when it is not known."""
    earlier: int = 0
    """Slots at the beginning that are of another run, which this one goes on from."""
    begun_in: str = ""
    """The run that began at this power-on, where that is another: what jumped in it stays where it is."""
    warnings: tuple[str, ...] = ()
    """Why its numbers may not be fit for an estimate: the device has corrected its rates itself, say."""
    slot_s: float = 1.0
    """Whole seconds; more than one where a log is slower than a sample a second."""
    share: float = 1.0
    """Of it that is used; the rest of it is held out for a test, or was."""
    looks: Mapping[str, Look] = field(default_factory=dict)
    """What was seen of the single samples of channels, in the whole recording."""

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return len(self.time_s) * self.slot_s

    def samples_per_slot(self, channel: str) -> float:
        """Return the mean number of samples in a slot that no gap cuts: its neighbours have samples, too."""
        some = self.count[channel] > 0
        whole = some & np.append(some[1:], False) & np.append(False, some[:-1])
        chosen = whole if whole.any() else some
        return float(self.count[channel][chosen].mean()) if chosen.any() else 0.0


def read_runs(
    path: Path,
    map_path: Path | None,
    stages: Stages = no_stages,
    at_rest: bool = False,
    sensors: Sequence[str] = SENSORS,
) -> list[Run]:
    """Read a session, or a table with its map (one that imumon wrote needs none), as runs from power-on.

    `sensors` are those that are to be diagnosed, see `channels_of`; `at_rest` says that the unit was
    at rest all the time, whatever the samples look like.

    Raises BAD_DATA when there is nothing to read, no run of five minutes, or a table that needs a map.
    """
    recording = open_recording(path, stages, map_path)
    blocks = recording.blocks()
    first: list[SampleBlock] = []
    while sum(map(len, first)) < LOOKED_AT and (more := next(blocks, None)) is not None:
        first.append(more)
    # What is in a table of imumon's own beside the known columns may be made of the gyros themselves.
    own = recording.source.session is None and map_path is None
    made = {column.name for stage in stages(None) for column in stage.columns}
    further = [] if own or not first else further_columns(first[0], made)
    wanted = channels_of(sensors, first[0].columns) if first else []
    slot_s = _slot_s(first, wanted)
    watcher = Watcher(wanted)
    further += [name for name in wanted if name not in (*READ, *further)]
    samples: Iterable[SampleBlock] = watcher.through(chain(first, blocks))
    if CLOCK in sensors and CLOCK not in wanted:
        samples, further = with_delay(samples), [*further, CLOCK]
    everything = collect(samples, recording.name, further, slot_s)
    looks = watcher.looks()
    if at_rest:
        for run in everything:
            run.rest[:] = 1.0
    runs = [run for run in everything if run.duration_s >= SHORTEST_RUN_S]
    if not runs:
        longest = max((run.duration_s for run in everything), default=0.0)
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: too short: its longest run is {longest:.0f} s; {SHORTEST_RUN_S:.0f} s are needed",
            "record the unit at rest for an hour or more while its temperature changes",
        )
    said = tuple(f"{path}: {text}" for text in recording.warnings())
    origin = Origin(recording.name, 0, recording.sha256(), recording.device, recording.serial)
    return [
        replace(run, origin=replace(origin, index=at), warnings=said, looks=looks)
        for at, run in enumerate(runs)
    ]


def further_columns(block: SampleBlock, made: Container[str]) -> list[str]:
    """Return the columns beyond the known ones that were measured: no counters, and none that stages made."""
    return [
        name
        for name, values in block.columns.items()
        if name not in KNOWN and name not in made and values.dtype == np.float64
    ]


def _slot_s(blocks: Sequence[SampleBlock], channels: Sequence[str]) -> float:
    """Return how long a slot is in which a log has a sample: a second, or more for a slower one."""
    steps = [np.diff(block["device_time_ns"][_measured(block, channels)]) for block in blocks]
    forward = np.concatenate([step[step > 0] for step in steps]) if steps else np.empty(0)
    period_s = float(np.median(forward)) / SECOND_NS if len(forward) else 0.0
    # A clock that is off by a percent still puts a sample into each slot.
    return float(max(1, np.ceil(period_s / 1.01)))


def _measured(block: SampleBlock, channels: Sequence[str]) -> BoolArray:
    """Tell which rows have any of the channels."""
    found = np.zeros(len(block), np.bool_)
    for name in channels:
        if name in block:
            found |= np.isfinite(block[name])
    return found


def collect(
    blocks: Iterable[SampleBlock],
    name: str,
    further: Sequence[str] = (),
    slot_s: float = 1.0,
) -> list[Run]:
    """Return the runs in a stream of samples with times; without ``at_rest`` it is taken as at rest.

    `further` are columns that may drive a bias beside the known ones.  A log slower than a sample a second is
    too slow for a rest detector: a slot is then at rest when it is like its neighbours.
    """
    means = reduce(blocks, (*READ, *further), slot_s)
    gap = np.diff(means.number, prepend=0) > LONGEST_GAP_S / slot_s
    another = np.diff(means.run, prepend=-1) != 0
    parts = np.split(np.arange(len(means)), np.flatnonzero(another | gap)[1:])
    names = [name] if len(parts) == 1 else [f"{name}, run {index + 1}" for index in range(len(parts))]
    slow = means.quiet().astype(np.float64)
    rest = slow if slot_s > 1.0 else np.nan_to_num(means.share_in_hindsight(), nan=1.0)
    return [_run(means, rest, rows, text) for rows, text in zip(parts, names, strict=True) if len(rows)]


def _run(means: Reduced, rest: FloatArray, rows: IntArray, name: str) -> Run:
    """Lay these slots out on a grid of all slots from the first of them."""
    second = means.number[rows] - means.number[rows[0]]
    n = int(second[-1]) + 1

    def laid(values: FloatArray | IntArray, missing: float) -> FloatArray:
        grid = np.full(n, missing)
        grid[second] = values[rows]
        return grid

    columns = {key: at for at, key in enumerate(means.names) if means.count[rows, at].any()}
    mean = {key: laid(means.mean[:, at], np.nan) for key, at in columns.items()}
    variance = {key: laid(means.variance[:, at], np.nan) for key, at in columns.items()}
    if CLOCK in columns:
        mean[CLOCK] = rate_ppm(laid(means.smallest[:, columns[CLOCK]], np.nan), means.slot_s)
        variance[CLOCK] = np.full(n, np.nan)  # the samples of a slot are delays, no rates
    if columns.keys() >= set(ACCEL):
        with_vibration(mean, variance)
    return Run(
        name=name,
        time_s=(np.arange(n, dtype=np.float64) + 0.5) * means.slot_s,
        count={key: laid(means.count[:, at], 0.0) for key, at in columns.items()},
        mean=mean,
        variance=variance,
        rest=laid(rest, 0.0),
        start_ns=int(means.start_ns[rows[0]]),
        slot_s=means.slot_s,
    )


def with_vibration(mean: dict[str, FloatArray], variance: Mapping[str, FloatArray]) -> None:
    """Add the vibration to the means of a run, where its slots show it: by the scatter of its samples."""
    scatter = np.sum([variance[key] for key in ACCEL], axis=0)
    if np.isfinite(scatter).mean() > 0.5:
        mean[VIBRATION] = scatter


def channels_of(sensors: Iterable[str], there: Container[str]) -> list[str]:
    """Return the columns of sensors, of those that there are: of gyro gyro_x, gyro_y and gyro_z, of pressure
    itself."""
    every = [name for sensor in sensors for name in (sensor, *(f"{sensor}_{axis}" for axis in "xyz"))]
    return [name for name in dict.fromkeys(every) if name in there]


def common_temperature(wanted: str, runs: Sequence[Run], lacking: str, but: str = "") -> str:
    """Return the temperature wanted, or another (not `but`) that every run has; raises BAD_DATA without
    one."""
    for name in (wanted, *TEMPERATURES):
        if name != but and all(name in run.mean and np.isfinite(run.mean[name]).sum() > 1 for run in runs):
            return name
    hint = "record with the temperature switched on, or name its column in the map"
    raise ImumonError(Reason.BAD_DATA, lacking, hint)


def unit_of(channel: str) -> str:
    """Return the unit of a channel; empty for a column of the log's own."""
    if channel == CLOCK:
        return UNIT
    return KNOWN[channel].unit if channel in KNOWN else ""
