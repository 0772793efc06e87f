"""Recordings read for the diagnosis: means of one second, in bounded memory, one run from each power-on."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.columns import KNOWN
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Estimator, Pipeline
from imumon.recordings.folder import is_session, open_session
from imumon.recordings.importing import import_table
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import SUFFIXES, iterate_table

CHANNELS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
TEMPERATURES = ("temperature", *(f"temperature_{axis}" for axis in "xyz"))
SECOND_NS = 1_000_000_000
LONGEST_GAP_S = 6 * 3600
"""A longer gap begins another run: nothing is known of what was between."""
SHORTEST_RUN_S = 300.0
"""What a restart leaves behind that is shorter is passed over."""
COLDEST_DEGC, HOTTEST_DEGC = -100.0, 250.0

Progress = Callable[[int], None]


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a run comes from: session or table, number of the run in it, and the fingerprint of its bytes."""

    session: str
    index: int
    sha256: str


@dataclass(slots=True)
class Run:
    """One run from power-on in means of one second; a second without samples is NaN.

    Parameters
    ----------
    name : str
        Where it comes from.
    time_s : array of shape (n,)
        Middle of each second since the first sample.
    count : mapping of str to array of shape (n,)
        Samples in each second.
    mean : mapping of str to array of shape (n,)
        Mean of channels in SI units and of temperatures in °C.
    variance : mapping of str to array of shape (n,)
        Variance of the samples within each second; NaN with fewer than two.
    rest : array of shape (n,)
        Share of the samples at which the unit was at rest.
    origin : Origin or None
        None when it is not from a file.
    start_ns : int or None
        Device time of the first sample; None when it is not known.
    earlier : int
        Seconds at the beginning that are of another run, which this one goes on from.
    """

    name: str
    time_s: FloatArray
    count: dict[str, FloatArray]
    mean: dict[str, FloatArray]
    variance: dict[str, FloatArray]
    rest: FloatArray
    origin: Origin | None = None
    start_ns: int | None = None
    earlier: int = 0

    @property
    def duration_s(self) -> float:
        """Length in seconds."""
        return float(len(self.time_s))

    def samples_per_second(self, channel: str) -> float:
        """Return the mean number of samples in the seconds that have any."""
        count = self.count[channel]
        return float(count[count > 0].mean()) if (count > 0).any() else 0.0


def read_runs(
    path: Path,
    map_path: Path | None,
    stages: Callable[[], list[Estimator]] = list,
    progress: Progress | None = None,
) -> list[Run]:
    """Read a session, or a table with its map (one that imumon wrote needs none), as runs from power-on.

    Raises
    ------
    ImumonError
        BAD_DATA when there is nothing to read or no run of five minutes; BAD_CONFIG when a table needs a map.
    """
    with _blocks(path, map_path, stages) as blocks:
        everything = collect(blocks, path.name or str(path), progress)
    runs = [run for run in everything if run.duration_s >= SHORTEST_RUN_S]
    if not runs:
        longest = max((run.duration_s for run in everything), default=0.0)
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: too short: its longest run is {longest:.0f} s; {SHORTEST_RUN_S:.0f} s are needed",
            "record the unit at rest for an hour or more while its temperature changes",
        )
    sha256 = _fingerprint(path)
    return [replace(run, origin=Origin(path.name or str(path), at, sha256)) for at, run in enumerate(runs)]


def collect(blocks: Iterable[SampleBlock], name: str, progress: Progress | None = None) -> list[Run]:
    """Return the runs in a stream of samples with times; without ``at_rest`` it is taken as at rest."""
    collector = _Collector(name)
    for block in blocks:
        collector.add(block)
        if progress is not None:
            progress(len(block))
    return collector.runs()


def _fingerprint(path: Path) -> str:
    """Return the fingerprint of what was recorded, or of a table."""
    file = path
    if is_session(path) or path.is_dir():
        session = open_session(path)
        file = session.samples_path if session.metadata.source == "import" else session.wire_path
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@contextmanager
def _blocks(
    path: Path, map_path: Path | None, stages: Callable[[], list[Estimator]]
) -> Iterator[Iterable[SampleBlock]]:
    if is_session(path) or path.is_dir():
        source = open_source(path)
        yield run_over(source.items, Pipeline(source.device, stages()))
        return
    if not path.is_file():
        raise ImumonError(Reason.BAD_DATA, f"{path}: there is no such file", "give a session or a table")
    if map_path is not None:
        with tempfile.TemporaryDirectory(prefix="imumon-diagnose-") as folder:
            session = Path(folder) / "session"
            import_table(path, map_path, session)
            source = open_source(session)
            yield run_over(source.items, Pipeline(None, stages()))
        return
    if path.suffix not in SUFFIXES:
        raise ImumonError(
            Reason.BAD_CONFIG, f"{path} is no session, and a table needs a map", "add --map MAP.yaml"
        )
    yield run_over(_canonical(path), Pipeline(None, stages()))


def _canonical(path: Path) -> Iterator[SampleBlock]:
    """Yield the samples of a table that has the names of imumon."""
    for block in iterate_table(path):
        if "device_time_ns" not in block:
            raise ImumonError(
                Reason.BAD_CONFIG,
                f"{path}: has no column device_time_ns, so it is no table of imumon",
                "say with --map MAP.yaml what is in which column",
            )
        extra = {} if "segment" in block else {"segment": np.zeros(len(block), np.int64)}
        yield block.with_columns(extra)


@dataclass(slots=True)
class _Sums:
    """Growing sums of one column, one element per second."""

    reference: float = np.nan
    count: FloatArray = field(default_factory=lambda: np.zeros(0))
    total: FloatArray = field(default_factory=lambda: np.zeros(0))
    square: FloatArray = field(default_factory=lambda: np.zeros(0))

    def add(self, second: IntArray, values: FloatArray) -> None:
        valid = np.isfinite(values)
        if not valid.any():
            return
        second, values = second[valid], values[valid]
        if np.isnan(self.reference):
            self.reference = float(values[0])
        first, size = int(second[0]), int(second[-1]) + 1
        if size > len(self.count):
            grown = max(size, 2 * len(self.count), 4096)
            for name in ("count", "total", "square"):
                old = getattr(self, name)
                setattr(self, name, np.concatenate([old, np.zeros(grown - len(old))]))
        offset = values - self.reference
        at = second - first
        self.count[first:size] += np.bincount(at)
        self.total[first:size] += np.bincount(at, offset)
        self.square[first:size] += np.bincount(at, offset * offset)

    def finished(self, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return count, mean and variance within each of n seconds."""
        count, total, square = (_padded(part, n) for part in (self.count, self.total, self.square))
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = total / count
            variance = np.where(count > 1, (square - count * mean**2) / (count - 1), np.nan)
        return count, mean + self.reference, np.maximum(variance, 0.0)


def _padded(values: FloatArray, n: int) -> FloatArray:
    return np.concatenate([values[:n], np.zeros(max(0, n - len(values)))])


class _Collector:
    """Gathers blocks into runs; a new segment, a clock that goes back or a very long gap begins another."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._runs: list[tuple[dict[str, _Sums], int]] = []
        self._starts: list[int] = []
        self._segment = -1
        self._start_ns = self._last_ns = 0

    def add(self, block: SampleBlock) -> None:
        if not len(block):
            return
        time_ns, segment = block["device_time_ns"], block["segment"]
        before = np.concatenate([[self._last_ns], time_ns[:-1]])
        other = np.concatenate([[self._segment], segment[:-1]]) != segment
        cut = other | (time_ns < before) | (time_ns - before > LONGEST_GAP_S * SECOND_NS)
        if not self._runs:
            cut[0] = True
        bounds = [0, *[int(at) for at in np.flatnonzero(cut) if at > 0], len(block)]
        for a, b in pairwise(bounds):
            if cut[a]:
                self._runs.append(({}, 0))
                self._start_ns = int(time_ns[a])
                self._starts.append(self._start_ns)
            self._add_rows(block.rows(a, b))
        self._segment, self._last_ns = int(segment[-1]), int(time_ns[-1])

    def _add_rows(self, block: SampleBlock) -> None:
        sums, longest = self._runs[-1]
        second = (block["device_time_ns"] - self._start_ns) // SECOND_NS
        for name in (*CHANNELS, *TEMPERATURES):
            if name in block:
                values = np.asarray(block[name], np.float64)
                if name in TEMPERATURES:
                    inside = (values > COLDEST_DEGC) & (values < HOTTEST_DEGC)
                    values = np.where(inside, values, np.nan)
                sums.setdefault(name, _Sums()).add(second, values)
        rest = np.asarray(block["at_rest"], np.float64) if "at_rest" in block else np.ones(len(block))
        sums.setdefault("at_rest", _Sums()).add(second, rest)
        self._runs[-1] = sums, max(longest, int(second[-1]) + 1)

    def runs(self) -> list[Run]:
        """Return the runs so far."""
        return [
            self._run(
                sums, n, f"{self._name}, run {index + 1}" if len(self._runs) > 1 else self._name, start_ns
            )
            for index, ((sums, n), start_ns) in enumerate(zip(self._runs, self._starts, strict=True))
        ]

    def _run(self, sums: dict[str, _Sums], n: int, name: str, start_ns: int) -> Run:
        parts = {key: value.finished(n) for key, value in sums.items() if value.count.any()}
        rest = parts.pop("at_rest")[1]
        return Run(
            name=name,
            time_s=np.arange(n, dtype=np.float64) + 0.5,
            count={key: part[0] for key, part in parts.items()},
            mean={key: part[1] for key, part in parts.items()},
            variance={key: part[2] for key, part in parts.items()},
            rest=np.nan_to_num(rest),
            start_ns=start_ns,
        )


def unit_of(channel: str) -> str:
    """Return the unit of a channel."""
    return KNOWN[channel].unit
