"""A live run: port to recorder and pipeline, pipeline to view; each in a thread that waits for no other.

The reader thread reads, stamps and hands on.  The recorder gets every byte to disk.  The pipeline thread
decodes and estimates.  The view is fed through bounded queues and may hang or die.
"""

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from queue import SimpleQueue
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import KNOWN
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.model import BiasModel
from imumon.pipeline import Digest, Estimator, Pipeline, PipelineCounters
from imumon.protocols.device import DeviceFile
from imumon.recordings.folder import PortUsed, SessionMetadata, create_session, remove_empty
from imumon.recordings.lines import LOG_NAME, SessionLog
from imumon.recordings.recorder import Recorder
from imumon.recordings.source import feed
from imumon.recordings.wire import WireCounters, WireWriter
from imumon.transport.detect import WRONG_CHECKSUM, is_wrong_checksum
from imumon.transport.reader import SILENT_AFTER_S, Bytes, Clock, Event, EventKind, Item, Reader, Reads, Sink
from imumon.transport.settings import PortSettings

from .account import Outages
from .marks import Marks, append_request
from .narration import Narrator, Publish, Report
from .setup import Setup
from .stages import estimators, pipeline_of

BATCH_S = 0.08
"""Samples go to the estimators and to the view in batches of this length: 50 to 100 ms look fluent, and most
of what a batch costs does not depend on its length."""
TICK_S = 0.5
"""How often rates, lanes and the status card are renewed."""
SILENT_AFTER_PACKETS = 3
"""A device that sends less often than once a second is silent after the time of so many packets."""


def warm_up(device: DeviceFile, setup: Setup) -> None:
    """Compile what packets, rest and motion need, so that no packet waits for it.

    The compiled code is kept on disk: the first start after an installation takes ten seconds or so, later
    ones some tenths of a second.
    """
    pipeline = pipeline_of(device, setup)
    zeros = SampleBlock({column.name: np.zeros(3, column.dtype) for column in KNOWN.values()})
    for number, packet in enumerate(device.encoder().encode(zeros)):
        pipeline.feed(packet, number)
    pipeline.finish()
    pipeline.take()
    at_rest = Pipeline(None, estimators(device, setup))
    at_rest.push(rest_and_turn())
    at_rest.finish()
    at_rest.take()


def rest_and_turn() -> SampleBlock:
    """Return two minutes at rest, at 20 Hz, and a turn of some seconds: every stage then does all it does."""
    n, moving = 2600, 100
    rng = np.random.default_rng(0)
    noise = {
        f"{sensor}_{axis}": 1e-3 * rng.standard_normal(n) for sensor in ("gyro", "accel") for axis in "xyz"
    }
    noise["accel_z"] += STANDARD_GRAVITY
    noise["gyro_x"][-moving:] += 1.0
    return SampleBlock(
        {
            "device_time_ns": np.arange(n) * 50_000_000,
            "segment": np.zeros(n, np.int64),
            **noise,
            "temperature": np.linspace(25.0, 26.0, n).round(1),
        }
    )


class LiveSummary(NamedTuple):
    """What a live run did."""

    session: Path
    began_ns: int
    ended_ns: int
    outages: Outages
    counters: PipelineCounters
    wire: WireCounters
    recording_problem: str | None
    # None when not everything was decoded live, so that there is nothing to compare a replay with.
    results_digest: str | None

    def as_dict(self) -> dict[str, object]:
        """Return the summary as ``monitor --json`` prints it."""
        return {
            "session": str(self.session),
            "elapsed_s": round((self.ended_ns - self.began_ns) * 1e-9, 3),
            "outages": self.outages.as_data(),
            **self.counters.as_dict(),
            "bytes_recorded": self.wire.bytes_on_disk,
            "bytes_unrecorded": self.wire.bytes_unrecorded,
            "recording_problem": self.recording_problem,
            "results_digest": self.results_digest,
        }


class DecodedPort:
    """A port that is read and decoded in threads of its own until it is stopped; nothing is recorded.

    `report` takes log lines, from several threads; `record` all that comes, in the thread that reads.  The
    status card begins with `card`.
    """

    def __init__(
        self,
        device: DeviceFile,
        settings: PortSettings,
        pipeline: Pipeline,
        report: Report,
        record: Sink = lambda _: None,
        card: Mapping[str, str] = {},
    ) -> None:
        self.pipeline = pipeline
        pipeline.go_live()
        self._items: SimpleQueue[Item] = SimpleQueue()
        self._outages, self._clock = Outages(), Clock()
        self._began_ns = self._clock.now_ns()
        silent_after_s = max(SILENT_AFTER_S, SILENT_AFTER_PACKETS / (device.rate_hz or np.inf))
        self.reader = Reader(settings, record, self._items.put, silent_after_s=silent_after_s)
        self.narrator = Narrator(pipeline, settings, (), report, card)
        # Take, in the pipeline's thread, the samples and those of the side streams as they come.
        self.takers: list[Callable[[SampleBlock, Mapping[str, SampleBlock]], object]] = [
            self.narrator.samples
        ]
        self._thread = threading.Thread(target=self._run, name="pipeline", daemon=True)
        # The numbers of the moment, renewed twice a second; in the end with the rates of the whole run.
        self.progress = self.narrator.progress(self._began_ns)
        self._finished = False
        self.failure: ImumonError | None = None

    @property
    def processing(self) -> bool:
        """Whether the pipeline thread works; without it reading and recording go on."""
        return self._thread.is_alive()

    def open(self) -> None:
        """Open the port, and read from now on; raises ImumonError the reasons of `Reader.start`."""
        self.reader.start()

    def begin(self, publish: Sequence[Publish]) -> None:
        """Decode what has come and what comes, and show it to `publish` as view items."""
        self.narrator.publish = publish
        self._thread.start()

    def stop(self) -> LiveSummary | None:
        """Close the port, and decode all that came."""
        self.reader.stop()
        if self._thread.ident is not None:
            self._thread.join()
        return None

    def _run(self) -> None:
        """The pipeline thread: ends with the CLOSED event of the reader."""
        try:
            closed = False
            next_tick = time.monotonic()
            while not closed:
                for item in arrived(self._items):
                    feed(item, self.pipeline)
                    self.narrator.item(item)
                    self._outages.item(item)
                    closed = isinstance(item, Event) and item.kind is EventKind.CLOSED
                if closed:
                    self.pipeline.finish()
                else:
                    self._take_marks()
                block = self.pipeline.take()
                for take in self.takers:
                    take(block, self.pipeline.side)
                if time.monotonic() >= next_tick or closed:
                    next_tick = time.monotonic() + TICK_S
                    self.progress = self.narrator.tick(self._clock.now_ns())
            self.progress = self.narrator.ended(self.progress)
            self._finished = True
        except ImumonError as error:
            # Reading and recording go on; what could not be decoded can be decoded from the recording.
            self.failure = error

    def _take_marks(self) -> None:
        """Put marks that were requested into what comes; only a recording has some."""


class LiveRun(DecodedPort):
    """Records and decodes a port until it is stopped.

    Raises EXISTS when the folder holds a session; BAD_CONFIG when it cannot be written.

    The session in `folder` keeps the device file, the setup and the serial number of the unit.  `stages`
    stand behind the others.
    """

    def __init__(
        self,
        device: DeviceFile,
        device_yaml: str,
        settings: PortSettings,
        setup: Setup,
        folder: Path,
        report: Report,
        stages: Sequence[Estimator] = (),
        serial: str | None = None,
    ) -> None:
        pipeline = pipeline_of(device, setup, stages)
        self._marks, self._marking = Marks(folder), threading.Lock()
        self._digest = Digest()
        line = asdict(settings)
        metadata = SessionMetadata.begun(
            "live",
            time.time_ns(),
            device=device.name,
            serial=serial,
            axes=device.axes,
            device_yaml=device_yaml,
            pipeline_yaml=setup.text(),
            port=PortUsed(url=line.pop("url"), settings=line),
        )
        self.session = create_session(folder, metadata)
        self._log = SessionLog(self.session.path / LOG_NAME, report)
        self._report = self._log.put
        try:
            self._writer = WireWriter(self.session.wire_path, metadata.for_wire() | {"port": str(settings)})
        except OSError as error:
            remove_empty(self.session)
            raise bad_config(
                f"the recording {self.session.wire_path} cannot be made: {error.strerror}",
                "give another folder",
            ) from error
        if isinstance(setup.model, BiasModel) and (text := setup.model.of_another(serial, device.axes)):
            self._report("WARN", text)
        self._recorder = Recorder(self._writer, self._report_problem, self._save)
        card = {"device": device.title, "port": str(settings), "recording": str(self.session.path)}
        super().__init__(device, settings, pipeline, self._report, self._recorder.put, card)
        self.takers.append(self._digest.update)

    def open(self) -> None:
        """Open the port, and read and record from now on.

        Raises ImumonError the reasons of `Reader.start` when the port cannot be opened; then no session is
        left behind.
        """
        try:
            super().open()
        except ImumonError:
            with suppress(OSError):
                self._writer.close()
            remove_empty(self.session)
            raise
        self._recorder.start()

    def stop(self, views: Sequence[str] = ()) -> LiveSummary:
        """Close the port, process and record what came, and close the session.

        `views` are the files of the view's recording, for the session's metadata.
        """
        self._take_marks()
        super().stop()
        self._marks.close()
        wire = self._recorder.stop()
        ended_ns = self._clock.now_ns()
        counters = self.pipeline.counters
        digest = self._digest.hexdigest() if self._finished else None
        if not self._finished and self._thread.ident is not None and self.failure is None:
            self.failure = bad_data(
                f"decoding ended after {counters.packets:,} packets by a defect of imumon",
                f"the recording is whole; please report the defect with it: {self.session.path}",
            )
        closed = self.session.metadata.closed(
            ended_ns,
            **summary_of(counters, wire.bytes_unrecorded),
            events=wire.events,
            results_digest=digest,
            column_crc32=self._digest.columns(self.pipeline.irreproducible) if self._finished else {},
            views=list(views),
        )
        try:
            self.session.save(closed)
            self._log.write()
        except OSError as error:
            self._report("ERROR", f"the session cannot be closed: {error.strerror}")
        return LiveSummary(
            self.session.path, self._began_ns, ended_ns, self._outages, counters, wire,
            self._recorder.problem, digest,
        )  # fmt: skip

    def mark(self, kind: EventKind, text: str) -> None:
        """Put a remark of the user on this moment into the recording; may be called from any thread."""
        try:
            append_request(self.session.path, kind, text)
        except OSError as error:
            self._report("ERROR", f"no mark can be made: {error.strerror}")

    def report_view_error(self, why: str) -> None:
        """Log that the recording of the view has stopped; may be called from any thread."""
        wire = self._recorder.problem or "wire.mcap has all so far"
        shown = f"imumon replay {self.session.path} --view native shows the whole run"
        self._report("ERROR", f"the view is not recorded any more: {why}; {wire}; {shown}")

    def _take_marks(self) -> None:
        with self._marking:
            for mark in self._marks.take(self._clock.now_ns()):
                self.reader.report(mark.kind, mark.detail, mark.time_ns)

    def _run(self) -> None:
        try:
            super()._run()
        finally:
            if not self._finished:
                self._report(
                    "ERROR", "decoding stopped; reading and recording go on, decode the session afterwards"
                )

    def _save(self) -> None:
        """Renew session.yaml and the log, so that a killed session holds how far it came."""
        self.session.save(self.session.metadata.model_copy(update=summary_of(self.progress.counters)))
        self._log.write()

    def _report_problem(self, problem: str | None) -> None:
        self._report("INFO" if problem is None else "ERROR", problem or "recording goes on")


def arrived(items: SimpleQueue[Item]) -> Iterator[Reads | Event]:
    """Yield what comes within the time of a batch, reads in a row at once; nothing follows the event CLOSED.

    The time is slept through: to be woken by each read costs more than to decode it.
    """
    time.sleep(BATCH_S)
    came = [items.get_nowait() for _ in range(items.qsize())]
    for event, group in groupby(came, lambda item: isinstance(item, Event)):
        run = list(group)
        if not event:
            yield Reads.of([item for item in run if isinstance(item, Bytes)])
        for item in run:
            if isinstance(item, Event):
                yield item
                if item.kind is EventKind.CLOSED:
                    return


def summary_of(counters: PipelineCounters, unrecorded: int | None = None) -> dict[str, Any]:
    """Return what session.yaml has of counters and streams; `unrecorded` bytes once it is known how many."""
    flat = {name: value for name, value in counters.as_dict().items() if type(value) is int}
    flat |= {f"packets_by_type.{name}": count for name, count in counters.packets_by_type.items()}
    if unrecorded is not None:
        flat["bytes_unrecorded"] = unrecorded
    return {"counters": flat, "streams": counters.streams}


def nothing_decoded(
    settings: PortSettings, device: DeviceFile, counters: PipelineCounters
) -> ImumonError | None:
    """Return why a run has no rows, or None when it has some."""
    if counters.samples or any(stream.rows for stream in counters.streams.values()):
        return None
    reason = Reason.WRONG_BAUD
    if counters.packets:
        kinds = ", ".join(f"{count:,} {name}" for name, count in counters.packets_by_type.items())
        what = (
            f"{counters.packets:,} packets came ({kinds}), and no row of {device.name} could be made of them"
        )
        hint = "is it another device, or does it send none of its sensors?  Try: imumon configure --help"
    elif counters.bytes_received == 0:
        reason, what = Reason.SILENT, f"{settings.url} is open, but no byte came"
        hint = "is the device powered, TX wired to RX, and does it send by itself?"
    else:
        what = (
            f"{counters.bytes_received:,} bytes came at {settings.baudrate} baud, none of them a packet of "
            f"{device.name} ({counters.checksum_errors} with the right header but a wrong checksum)"
        )
        hint = f"wrong baud rate or device?  Try: imumon detect {settings.url}"
        if is_wrong_checksum(device.protocol, counters.checksum_errors, counters.bytes_received):
            hint = f"{WRONG_CHECKSUM}  Else the baud rate is wrong.  What fits: imumon detect {settings.url}"
    return ImumonError(reason, what, hint)
