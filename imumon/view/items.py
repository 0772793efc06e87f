"""What the view shows (samples, numbers, states, log lines, charts, the status card), and how it waits.

A producer of items never waits: when a queue is full the oldest item goes, and is counted.
"""

import threading
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, BoolArray, IntArray, SampleBlock, join
from imumon.charts import Chart
from imumon.lane import Level

ITEM_BYTES = 512
"""What an item costs in memory beside its arrays, roughly."""


class Instant(NamedTuple):
    """A moment on the three timelines; None where a timeline does not know it."""

    sample: int | None  # running index of the latest sample
    device_ns: int | None  # device time, ns, continued across segments (see `Timebase`)
    host_ns: int | None  # Unix time, ns


class Times(NamedTuple):
    """The times of rows on the three timelines, (n,) each; None where the rows have none.

    Device time goes on across segments (see `Timebase`).
    """

    sample: IntArray | None
    device_ns: IntArray | None
    host_ns: IntArray | None

    def kept(self, keep: BoolArray | IntArray) -> "Times":
        """Return the times of the rows to keep."""
        return Times(*(None if values is None else values[keep] for values in self))

    def at(self, row: int) -> Instant:
        """Return the moment of a row."""
        return Instant(*(None if values is None else int(values[row]) for values in self))


class ViewItem:
    """What the view shows; where it waits in a queue, these are its costs."""

    @property
    def nbytes(self) -> int:
        """Bytes that the item holds, roughly."""
        return ITEM_BYTES

    @property
    def rows(self) -> int:
        """How many samples or events are lost with it."""
        return 1

    @property
    def lasting(self) -> str | None:
        """What a later item with the same text replaces; None for what does not last."""
        return None


@dataclass(frozen=True, eq=False)
class Samples(ViewItem):
    """Consecutive samples on the three timelines."""

    times: Times  # the index is None in a side stream
    block: SampleBlock  # the samples as decoded, and what the estimators added
    stream: str = ""  # name of the side stream; empty for the main one

    @property
    def nbytes(self) -> int:
        """Bytes that the item holds; every column has 8 a row."""
        return ITEM_BYTES + 8 * self.rows * len(self.block.columns)

    @property
    def rows(self) -> int:
        """Samples in the item."""
        return len(self.block)


@dataclass(frozen=True)
class Event(ViewItem):
    """What happens at a moment."""

    at: Instant


@dataclass(frozen=True)
class Numbers(Event):
    """Numbers that are not one per sample: packet rate, link load, losses."""

    values: Mapping[str, float]


@dataclass(frozen=True)
class State(Event):
    """A lane (port, clock, device, ...) is in this state from now on."""

    lane: str
    state: str
    level: Level = Level.PLAIN

    @property
    def lasting(self) -> str:
        """The lane."""
        return f"state {self.lane}"


@dataclass(frozen=True)
class Log(Event):
    """A line for the log; the level is one of INFO, WARN, ERROR."""

    text: str
    level: str = "INFO"


@dataclass(frozen=True)
class Status(Event):
    """The status card: what to show, as it is to be read, in order."""

    fields: Mapping[str, str]

    lasting = "status"  # there is one card


@dataclass(frozen=True)
class Drawing(Event):
    """A chart, as it is from now on."""

    chart: Chart

    @property
    def nbytes(self) -> int:
        """Bytes of its curves."""
        return ITEM_BYTES + sum(curve.x.nbytes + curve.y.nbytes for curve in self.chart.curves)

    @property
    def lasting(self) -> str:
        """The chart's key."""
        return f"chart {self.chart.key}"


class ViewSetup(NamedTuple):
    """What the view must know before the first sample."""

    title: str  # name of the recording as the viewer shows it
    recording_id: str  # the same for live view and recording
    # Units that differ from `imumon.columns.KNOWN`, by column (magnetic field in arbitrary units, ...).
    units: Mapping[str, str] = {}
    z_down: bool = False  # True for a device with FRD axes, whose reference frame has z down
    window_s: float = 30.0  # seconds that the live strips show
    first_tab: str = "Live"  # what the first tab is called while the data comes
    step_ns: int = 0  # live, of so much time only the extremes are shown; 0: all samples


class Timebase:
    """Puts samples and events on the three timelines of the view.

    Device time starts anew in each segment; here it goes on: a new segment begins as much later than the last
    sample as the host clock states, or at its time when there is no host time.  The device's
    own time stays in the block.  `samples` is called from one thread; `at` may be called from any.
    """

    def __init__(self) -> None:
        self._count = 0
        self._shift_ns: dict[int, int] = {}
        self._last = Instant(None, None, None)
        self._begun_ns = 0  # device time of the first sample
        self._received = True

    def samples(self, block: SampleBlock) -> Samples:
        """Return the block with its times; blocks must come in order."""
        sample = np.arange(self._count, self._count + len(block), dtype=np.int64)
        self._count += len(block)
        host = _complete(block, "host_time_ns")
        device = _complete(block, "device_time_ns")
        if len(block):
            self._received = "host_time_ns" in block
            device_ns, host_ns = self._last.device_ns, self._last.host_ns
            if device is not None:
                device = self._continued(device, host, block)
                if device_ns is None:
                    self._begun_ns = int(device[0])
                device_ns = int(device[-1])
            self._last = Instant(self._count - 1, device_ns, host_ns if host is None else int(host[-1]))
        return Samples(Times(sample, device, host), block)

    def side(self, stream: str, block: SampleBlock) -> Samples:
        """Return a block of a side stream with its times, which are those of the main stream's segments."""
        device, host = _complete(block, "device_time_ns"), _complete(block, "host_time_ns")
        if device is not None and len(block):
            shifts = [self._shift_ns.get(label, 0) for label in block["segment"].tolist()]
            device = device + np.array(shifts, np.int64)
        return Samples(Times(None, device, host), block, stream)

    def at(self, time_ns: int | None = None) -> Instant:
        """Return the moment `time_ns` (Unix time of this computer), or that of the latest sample.

        A table, which was not received, has the latter only.
        """
        last = self._last
        if time_ns is None or not self._received:
            return last
        device = last.device_ns
        if device is not None and last.host_ns is not None:
            device = max(self._begun_ns, device + time_ns - last.host_ns)
        return Instant(last.sample, device, time_ns)

    def _continued(self, device: IntArray, host: IntArray | None, block: SampleBlock) -> IntArray:
        n, shifted, last = len(block), np.empty_like(device), self._last
        segment = block.columns.get("segment", np.zeros(n, np.int64))
        for start, stop in pairwise([0, *(np.flatnonzero(np.diff(segment)) + 1).tolist(), n]):
            label, gap = int(segment[start]), 0
            if host is not None and last.host_ns is not None:
                gap = max(0, int(host[start]) - last.host_ns)
            begin = int(device[start]) if last.device_ns is None else last.device_ns + gap
            shift = self._shift_ns.setdefault(label, begin - int(device[start]))
            shifted[start:stop] = device[start:stop] + shift
            host_ns = last.host_ns if host is None else int(host[stop - 1])
            last = Instant(None, int(shifted[stop - 1]), host_ns)
        return shifted


def _complete(block: SampleBlock, name: str) -> IntArray | None:
    """Return an integer column that every row has, or None."""
    values = block.columns.get(name)
    return None if values is None or (values == NO_INT).any() else np.asarray(values, np.int64)


def first_of_steps(times_ns: IntArray, step_ns: int, before_ns: int | None = None) -> BoolArray:
    """Return which times are the first in a step of time, (n,); `before_ns` is the last that came before."""
    step = times_ns // step_ns
    before = step[:1] - 1 if before_ns is None else before_ns // step_ns
    return np.asarray(np.diff(step, prepend=before) != 0)


def merge(items: Iterable[ViewItem]) -> list[ViewItem]:
    """Join samples of the same stream, timelines and columns; events follow them in their order."""
    kinds: dict[tuple[object, ...], list[Samples]] = {}
    events: list[ViewItem] = []
    for item in items:
        if not isinstance(item, Samples):
            events.append(item)
        elif item.rows:
            kind = item.stream, *(values is None for values in item.times), *item.block.columns
            kinds.setdefault(kind, []).append(item)
    return [*map(_joined, kinds.values()), *events]


def _joined(items: Sequence[Samples]) -> Samples:
    parts = zip(*(item.times for item in items), strict=True)
    times = Times(*(None if part[0] is None else np.concatenate(part) for part in parts))
    return Samples(times, join([item.block for item in items]), items[0].stream)


class DropOldestQueue:
    """View items in order, at the most `max_bytes` of them.

    What lasts (states, the status card, charts) outlives its place in the queue: where any of it had to be
    dropped, the latest of all is handed out before the next batch, so that a lane never stays wrong.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._items: deque[ViewItem] = deque()
        self._lasting: dict[str, ViewItem] = {}
        self._is_incomplete = False
        self._bytes = 0
        self.closed = threading.Event()  # set once `close` was called
        self._taken_s = time.monotonic()
        self._filled = threading.Condition()
        self.dropped = 0  # samples and events dropped so far

    def put(self, item: ViewItem) -> None:
        """Append an item; drop the oldest ones when that is too much."""
        with self._filled:
            self._items.append(item)
            self._bytes += item.nbytes
            if item.lasting is not None:
                self._lasting[item.lasting] = item
            while self._bytes > self._max_bytes:
                oldest = self._items.popleft()
                self._bytes -= oldest.nbytes
                if oldest.lasting is not None:
                    self._is_incomplete = True
                else:
                    self.dropped += oldest.rows
            self._filled.notify()

    def take(self, apart_s: float, wait_s: float) -> list[ViewItem]:
        """Return all items, `apart_s` after the last ones or later; an empty list after `wait_s` without any.

        When the queue is closed, what is left is returned at once.
        """
        with self._filled:
            self._filled.wait_for(lambda: self._items or self.closed.is_set(), wait_s)
            if not self._items:
                return []
        self.closed.wait(self._taken_s + apart_s - time.monotonic())
        with self._filled:
            self._taken_s = time.monotonic()
            items = [*(self._lasting.values() if self._is_incomplete else ()), *self._items]
            self._items.clear()
            self._bytes, self._is_incomplete = 0, False
            return items

    @property
    def lasting(self) -> list[ViewItem]:
        """The latest of each that lasts, of all that was ever put in."""
        with self._filled:
            return list(self._lasting.values())

    def close(self) -> None:
        """End all waiting."""
        self.closed.set()
        with self._filled:
            self._filled.notify_all()
