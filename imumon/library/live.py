"""Samples of a port as they come, recorded or not."""

import asyncio
import logging
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Self

from pydantic import Field, InstanceOf, SkipValidation

from imumon.blocks import SampleBlock, join, with_nan
from imumon.pipeline import Estimator
from imumon.protocols.device import DeviceFile, device_text, parse_device
from imumon.run.live import BATCH_S, DecodedPort, LiveRun, nothing_decoded, warm_up
from imumon.run.setup import Setup
from imumon.run.stages import pipeline_of
from imumon.transport.ports import lost_error, silent_error, wrong_baud_error
from imumon.transport.settings import PortSettings

from . import checked

_log = logging.getLogger("imumon")
NEWEST_NS = round(BATCH_S * 1e9)
"""With `latest`, a block has what arrived within so much time."""


class Live:
    """Samples of a port with the estimates, as they come: iterate over it in a ``with`` statement.

    Iterating (``for`` or ``async for``) ends when `close` is called, from this thread or another; a lost port
    is reopened meanwhile.  What came while the loop was busy is one block.
    """

    def __init__(
        self,
        device: DeviceFile,
        settings: PortSettings,
        run: DecodedPort,
        timeout: float | None,
        latest: bool,
    ) -> None:
        self.pipeline = run.pipeline
        self.side: Mapping[str, SampleBlock] = {}
        """The rows of the side streams that belong to the latest block."""
        self.skipped = 0
        """Rows that came and were left out, with `latest`."""
        self._device, self._settings, self._run = device, settings, run
        self._timeout, self._latest = timeout, latest
        self._ended = self._stopped = False
        self._last_ns: int | None = None  # arrival of the last row that was handed out
        self._ready: SimpleQueue[tuple[SampleBlock, Mapping[str, SampleBlock]]] = SimpleQueue()
        self.counters = run.progress.counters
        """What became of every byte and packet so far."""
        run.takers.append(self._take)
        run.open()
        run.begin([])
        self._next_batch = self._valid_at = time.monotonic()
        self._before = self.counters  # counters when the last valid row came

    def __repr__(self) -> str:
        samples = f"{self.counters.samples:,} samples"
        return f"<imumon.Live: {self._device.name} on {self._settings}, {self.state}, {samples}>"

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column that may come."""
        return self.pipeline.units

    @property
    def state(self) -> str:
        """What the port does: open, silent, lost, closed, or does not frame (wrong device or baud rate)."""
        return self._run.narrator.state

    @property
    def lag_s(self) -> float:
        """How far the loop is behind: from the last row handed out to the newest bytes, seconds."""
        return 0.0 if self._last_ns is None else max(self._run.reader.newest_ns - self._last_ns, 0) * 1e-9

    @property
    def session(self) -> Path | None:
        """Where the recording is; None without."""
        return self._run.session.path if isinstance(self._run, LiveRun) else None

    def close(self) -> None:
        """Close port and recording; what has come can still be iterated over."""
        if not self._stopped:
            self._stopped = True
            self._run.stop()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> SampleBlock:
        """Return the next samples, a block about every 0.08 s while some come.

        Raises LOST, SILENT or WRONG_BAUD when no row came for `timeout`.
        """
        while not self._ended:
            time.sleep(max(self._next_batch - time.monotonic(), 0.0))  # none after a loop that was busy
            if (block := self._block()) is not None:
                return block
        raise StopIteration

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> SampleBlock:
        """Return the next samples, as `__next__`; nothing is lost when it is cancelled."""
        while not self._ended:
            await asyncio.sleep(max(self._next_batch - time.monotonic(), 0.0))
            if (block := self._block()) is not None:
                return block
        raise StopAsyncIteration

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, block: SampleBlock, side: Mapping[str, SampleBlock]) -> None:
        """Queue a batch with its counters, in the thread that decodes: no other may count meanwhile."""
        self.counters = self.pipeline.counters
        self._ready.put((block, side))

    def _block(self) -> SampleBlock | None:
        """Return what came, as users get it; None when no row did."""
        self._next_batch = time.monotonic() + BATCH_S
        processing = self._run.processing  # looked at first: what it hands on until its end is taken now
        taken = [self._ready.get() for _ in range(self._ready.qsize())]
        if not taken and not processing:
            self._ended = True
            if self._run.failure is not None:
                raise self._run.failure
        block = join([rows for rows, _ in taken])
        streams = dict.fromkeys(stream for _, side in taken for stream in side)
        side = {name: join([side[name] for _, side in taken if name in side]) for name in streams}
        if not len(block) and not side:
            self._raise_overdue()
            return None
        self._valid_at, self._before = time.monotonic(), self.counters
        if len(block):
            self._last_ns = int(block["arrival_time_ns"][-1])
        if self._latest:
            rows = len(block)
            block, side = _newest(block), {stream: _newest(rows) for stream, rows in side.items()}
            self.skipped += rows - len(block)
        self.side = {stream: with_nan(rows) for stream, rows in side.items()}
        return with_nan(block)

    def _raise_overdue(self) -> None:
        """Raise the reason why no row came for too long, once in each such time."""
        waited_s = time.monotonic() - self._valid_at
        if self._timeout is None or waited_s < self._timeout or self._ended:
            return
        now, before = self.counters, self._before
        self._valid_at, self._before = time.monotonic(), now
        if self.state == "lost":
            raise lost_error(self._settings, f"no row for {waited_s:.1f} s")
        received = now.bytes_received - before.bytes_received
        if received <= now.bytes_pending:  # at most the beginning of a packet came
            silent_s = (time.time_ns() - self._run.reader.newest_ns) * 1e-9 if received else waited_s
            raise silent_error(self._settings, silent_s)
        framed = (now.bytes_in_packets - before.bytes_in_packets) / received
        never = nothing_decoded(self._settings, self._device, now)
        raise never or wrong_baud_error(self._settings, received / waited_s, framed)


@checked
def open(
    port: str,
    device: str | Path,
    *,
    baudrate: Annotated[int, Field(gt=0)] | None = None,
    record: str | Path | None = None,
    setup: InstanceOf[Setup] | None = None,
    stages: Sequence[SkipValidation[Estimator]] = (),
    timeout: Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None = None,
    latest: bool = False,
) -> Live:
    """Open a port and return its samples with the estimates, as they come.

    Raises BAD_CONFIG for a wrong argument or device file; NOT_FOUND, PERMISSION, BUSY or LOST when the port
    cannot be opened; EXISTS when the folder holds a session.

    Parameters
    ----------
    port : str
        A device, or ``socket://host:port``.
    device : str or path
        Name of a known device, or path of a device file.
    baudrate : int, optional
        The first of the device file when not given.
    record : path, optional
        Session folder to make; nothing is recorded without.
    setup : Setup, optional
        Place, model and parameters of the estimators.
    stages : sequence of Estimator, optional
        Stages of one's own, behind the others, in their order.
    timeout : float, optional
        Iterating raises LOST, SILENT or WRONG_BAUD when no row came for so many seconds; it waits for ever
        when not given.
    latest : bool
        Whether a loop that was busy gets only the newest rows, those of the last 0.08 s; the estimators see
        all rows.
    """
    text, source = device_text(str(device))
    known, setup = parse_device(text, source), setup or Setup()
    settings = known.port_settings(port, baudrate)
    warm_up(known, setup)

    def report(level: str, line: str) -> None:
        _log.log(logging.getLevelNamesMapping().get(level, logging.INFO), line)

    run: DecodedPort
    if record is None:
        run = DecodedPort(known, settings, pipeline_of(known, setup, stages), report)
    else:
        run = LiveRun(known, text, settings, setup, Path(record), report, stages)
    return Live(known, settings, run, timeout, latest)


def _newest(block: SampleBlock) -> SampleBlock:
    if not len(block):
        return block
    arrival_ns = block["arrival_time_ns"]
    return block.rows(int((arrival_ns <= arrival_ns[-1] - NEWEST_NS).sum()), len(block))
