"""A run over what was recorded: the same pipeline as live, as fast as wanted."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from pathlib import Path

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.pipeline import UNDATED, Pipeline
from imumon.protocols.device import DeviceFile, parse_device
from imumon.recordings.folder import Session
from imumon.run.narration import Narrator
from imumon.transport.reader import Bytes, Event, EventKind, Item

READ_SIZE = 1 << 16
BATCH_BYTES = 1 << 16
"""Without a view, samples are handed on about as often as so many bytes were fed."""
BATCH_NS = 50_000_000
TICK_NS = 500_000_000
LONGEST_WAIT_S = 1e9
"""More is no time to wait for but a damaged stamp, and the system refuses it."""


def session_device(session: Session) -> DeviceFile:
    """Return the device of a session as it was when the session was recorded.

    Raises
    ------
    ImumonError
        BAD_DATA when the session keeps no device file.
    """
    if session.metadata.device_yaml is None:
        raise ImumonError(Reason.BAD_DATA, f"{session.path}: session.yaml has no device_yaml")
    return parse_device(session.metadata.device_yaml, f"{session.path / 'session.yaml'} (device_yaml)")


def capture_items(path: Path) -> Iterator[Item]:
    """Yield the bytes of a raw capture, whose arrival times nobody knows.

    Raises
    ------
    ImumonError
        BAD_DATA when the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            while data := file.read(READ_SIZE):
                yield Bytes(data, UNDATED)
    except OSError as error:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: cannot be read: {error.strerror}",
            "give a raw capture, or a session folder (which has a session.yaml)",
        ) from error


def run_over(
    items: Iterable[Item | SampleBlock],
    pipeline: Pipeline,
    narrator: Narrator | None = None,
    speed: float | None = None,
) -> Iterator[SampleBlock]:
    """Run what was recorded through a pipeline; yield the samples in order, to the last byte.

    Parameters
    ----------
    items : iterable of Bytes and Event, or of SampleBlock
        From `WireReader`, `capture_items` or `iterate_samples`.
    pipeline : Pipeline
        A new one.
    narrator : Narrator or None
        Shows the run as it would be shown live; needs items with times.
    speed : float or None
        1 is as fast as it was recorded, 2 twice as fast; None is as fast as it goes.
    """
    pace = _Pace(speed)
    next_batch_ns = next_tick_ns = now_ns = fed = 0
    for item in items:
        now_ns = _time_ns(item, now_ns)
        pace.wait(now_ns)
        fed += _feed(item, pipeline, narrator)
        if fed >= BATCH_BYTES or (narrator is not None and now_ns >= next_batch_ns):
            next_batch_ns, fed = now_ns + BATCH_NS, 0
            yield _take(pipeline, narrator)
        if narrator is not None and now_ns >= next_tick_ns:
            next_tick_ns = now_ns + TICK_NS
            narrator.tick(now_ns)
    pipeline.finish()
    yield _take(pipeline, narrator)
    if narrator is not None:
        narrator.tick(now_ns)


def _time_ns(item: Item | SampleBlock, before_ns: int) -> int:
    if isinstance(item, Bytes):
        return item.arrival_ns
    if isinstance(item, SampleBlock):
        return int(item["device_time_ns"][-1]) if len(item) else before_ns
    return item.time_ns


def _feed(item: Item | SampleBlock, pipeline: Pipeline, narrator: Narrator | None) -> int:
    if isinstance(item, SampleBlock):
        pipeline.push(item)
        return sum(values.nbytes for values in item.columns.values())
    if isinstance(item, Bytes):
        pipeline.feed(item.data, item.arrival_ns)
        if narrator is not None:
            narrator.received(len(item.data), item.arrival_ns)
        return len(item.data)
    tell_event(item, pipeline)
    if narrator is not None:
        narrator.event(item)
    return 0


def tell_event(event: Event, pipeline: Pipeline) -> None:
    """Tell the pipeline what an event of the port means for it: live and in a replay the same."""
    if event.kind is EventKind.OPENED:
        pipeline.port_opened()
    elif event.kind in (EventKind.SILENT, EventKind.LOST):
        pipeline.pause()


def _take(pipeline: Pipeline, narrator: Narrator | None) -> SampleBlock:
    block = pipeline.take()
    if narrator is not None:
        narrator.samples(block, pipeline.side)
    return block


class _Pace:
    """Waits until it is time for data of a certain age."""

    def __init__(self, speed: float | None) -> None:
        self._speed = speed
        self._began: tuple[int, float] | None = None

    def wait(self, now_ns: int) -> None:
        if self._speed is None:
            return
        if self._began is None:
            self._began = now_ns, time.monotonic()
        data_ns, wall = self._began
        ahead = (now_ns - data_ns) * 1e-9 / self._speed - (time.monotonic() - wall)
        if ahead > 0:
            time.sleep(min(ahead, LONGEST_WAIT_S))
