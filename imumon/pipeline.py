"""The one path from bytes to samples with times and estimates, for live, replay and decode alike.

The results depend on the bytes, their arrival times and the events between them, never on how the stream was
cut into pieces: a replay of a recording gives the same numbers, bit for bit.
"""

import hashlib
import pickle
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import dropwhile

import numpy as np

from .blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join, missing
from .charts import Chart
from .clock import DeviceClock, HostClock
from .clock.checks import Intervals, NominalRate, Repeats
from .clock.side import HeldReadings, SharedCounter, SideClock
from .columns import KNOWN, TIME_COLUMNS, Column, mistyped
from .errors import bad_config
from .intake import Intake
from .lane import LaneState
from .protocols.base import COMMON, MAIN, ByteArray, Timing
from .protocols.decoder import Decoder
from .protocols.device import DeviceFile
from .protocols.epochs import EpochAssembler
from .protocols.ranges import Ranges
from .stage import Estimator as Estimator
from .stage import GuardedStage, is_own, name_of
from .transport.statistics import Counters, StreamCounters

BY_RATE = ("rows", "counter")
"""What dates rows with the nominal rate."""
UNDATED = NO_INT
"""Arrival time of bytes whose arrival was not recorded, as in a raw capture."""


@dataclass(frozen=True)
class PipelineCounters(Counters):
    """What became of every byte and packet, and of values (`left_out`); the keys of ``--json``."""

    packets_counted: bool = False
    counter_gaps: int = 0
    packets_missing: int = 0
    clock_restarts: int = 0
    samples: int = 0
    left_out: int = 0
    streams: dict[str, StreamCounters] = field(default_factory=dict)

    @property
    def lost(self) -> int:
        """Packets that are missing or damaged."""
        return self.packets_missing + self.checksum_errors + self.length_errors

    def as_dict(self) -> dict[str, object]:
        """Return the counters as they are printed and stored."""
        return {**asdict(self), "bytes_pending": self.bytes_pending}


class Pipeline:
    """Decoder, clock and estimators in order.

    Parameters
    ----------
    device : DeviceFile or None
        What sends the bytes; None when samples come from a table, through `push`.
    estimators : sequence of Estimator
        Stages behind the clock, each of which receives the columns of those before it.
    ranges : Ranges, optional
        Of gyros and accelerometers, where they are other than the device file states.
    remarks : sequence of str
        On the parameters, for `warnings`.

    Raises BAD_CONFIG when the device has a column with the name of one that a stage of imumon adds.
    """

    def __init__(
        self,
        device: DeviceFile | None,
        estimators: Sequence[Estimator] = (),
        ranges: Ranges | None = None,
        remarks: Sequence[str] = (),
    ) -> None:
        self._of_table = device is None
        self._decoder = Decoder((), Timing(), None) if device is None else device.decoder()
        timing = self._decoder.timing._replace(rate_hz=None if device is None else device.rate_hz)
        groups = self._decoder.groups
        self._device_clock = DeviceClock(timing)
        self.host_clock = HostClock(self._device_clock.drift_limit_ppm)
        self._stages = tuple(GuardedStage(stage) for stage in estimators)
        sent = {column.name for column in self._decoder.possible_columns}
        for stage in filter(is_own, estimators):
            if device is not None and (both := [c.name for c in stage.columns if c.name in sent]):
                raise bad_config(
                    f"device {device.name} has column {both[0]}, which {name_of(stage)} adds",
                    "give it another name in the device file; of a recording that is in session.yaml",
                )
        self.sink: Callable[[SampleBlock], object] | None = None
        """Takes what stages may see of each block, which is not empty, with the columns that they add."""
        self._intake = Intake((ranges or Ranges()).over(device.range if device is not None else Ranges()))
        self._nominal = NominalRate(timing.rate_hz, device is not None and device.rate_given)
        self._repeats = Repeats()
        self._ended = False
        named = sorted(sent) if device is not None and device.protocol.startswith(("fixed", "text")) else []
        self._remarks, self._reported = [*remarks, *mistyped(named)], set[str]()
        self._samples = 0
        self._ready: list[SampleBlock] = []
        self._epochs = EpochAssembler(groups) if groups is not None else None
        self._side_clock, self._shared_counter = SideClock(timing), SharedCounter(timing.counter_bits)
        self._held = HeldReadings()
        self._side_ready: dict[str, list[SampleBlock]] = {}
        self.side: Mapping[str, SampleBlock] = {}
        """The rows of the side streams that belong to what `take` returned last, by stream."""
        self._intervals: dict[str, Intervals] = {}

    def go_live(self) -> None:
        """From now on switch off a stage of imumon that fails, as one of another package always is; until
        then its error is raised."""
        for stage in self._stages:
            stage.live = True

    @property
    def estimators(self) -> tuple[Estimator, ...]:
        """The stages, in their order."""
        return tuple(guarded.stage for guarded in self._stages)

    @property
    def irreproducible(self) -> frozenset[str]:
        """Columns of the stages from the first on that was switched off: chunking decides at which sample."""
        failed = dropwhile(lambda stage: not stage.switched_off, self._stages)
        return frozenset(column.name for stage in failed for column in stage.columns)

    @property
    def columns(self) -> list[Column]:
        """Columns of the decoded blocks so far, in the order in which tables have them."""
        return [*self.stream_columns(MAIN), *(c for stage in self._stages for c in stage.columns)]

    def stream_columns(self, stream: str) -> list[Column]:
        """Return the columns of a stream's blocks so far, without those of the estimators."""
        decoded = {column.name: column for column in self._decoder.columns}
        there = frozenset(decoded) if self._epochs is None else self._epochs.columns(stream)
        if stream == MAIN:
            there |= self._held.names
        times = [KNOWN[name] for name in TIME_COLUMNS if name != "packet_counter" or name in there]
        rest = [c for c in decoded.values() if c.name in there and c.name not in (*TIME_COLUMNS, *COMMON)]
        return [*times, *rest]

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column that may ever come."""
        added = [column for stage in self._stages for column in stage.columns]
        return {column.name: column.unit for column in (*self._decoder.possible_columns, *added)}

    @property
    def counters(self) -> PipelineCounters:
        """What became of every byte and packet so far."""
        assembled = self._epochs.counters if self._epochs is not None else {}
        streams = {}
        for stream, intervals in self._intervals.items():
            (packets, incomplete), is_main = assembled.get(stream, (0, 0)), stream == MAIN
            streams[stream] = StreamCounters(
                packets=packets or intervals.rows,
                rows=intervals.rows,
                rate_hz=intervals.rate_hz,
                gaps=intervals.gaps,
                incomplete=incomplete,
                restarts=self._device_clock.resets if is_main else intervals.backwards,
                dated_by=self._device_clock.dated_by if is_main else "",
            )
        return PipelineCounters(
            **asdict(self._decoder.counters()),
            packets_counted=self._device_clock.packets_counted,
            counter_gaps=self._device_clock.counter_gaps,
            packets_missing=self._device_clock.packets_missing,
            clock_restarts=self._device_clock.resets,
            samples=self._samples,
            left_out=self._intake.left_out,
            streams=streams,
        )

    def snapshot(self) -> bytes:
        """Return decoder, clocks and stages as bytes for `restore` of this version of imumon, bit for bit."""
        return pickle.dumps(self)

    @staticmethod
    def restore(snapshot: bytes) -> "Pipeline":
        """Return a pipeline that goes on where `snapshot` was taken.

        Only for bytes of one's own: like everything that pickle reads, they can run code.

        Raises ValueError when they are damaged, no snapshot of a pipeline, or of another version of imumon.
        """
        try:
            pipeline = pickle.loads(snapshot)
        except Exception as error:  # damaged bytes make pickle raise whatever there is
            raise ValueError(f"no snapshot of a pipeline of this version of imumon: {error}") from error
        if not isinstance(pipeline, Pipeline):
            raise ValueError(f"a {type(pipeline).__name__} is no snapshot of a pipeline")
        return pipeline

    def feed(self, data: bytes, arrival_ns: int = UNDATED) -> None:
        """Decode bytes that arrived at `arrival_ns` (Unix time, ns)."""
        self.feed_reads(np.frombuffer(data, np.uint8), np.array([len(data)]), np.array([arrival_ns]))

    def feed_reads(self, data: ByteArray, ends: IntArray, arrivals_ns: IntArray) -> None:
        """Decode the bytes of several reads: of each where it ends in the data, and when it arrived."""
        if self._of_table:
            raise ValueError("a pipeline without a device takes samples, not bytes")
        self._decoder.feed_reads(data, ends, arrivals_ns)

    def push(self, block: SampleBlock) -> None:
        """Take samples that have their times already, from a table."""
        self._ready.append(self._estimate(block))
        self._count(MAIN, block)

    def finish(self) -> None:
        """End the stream: no more bytes come; samples held back behind a damaged header come out."""
        self._decoder.finish()
        self.pause()
        self._ended = True

    def pause(self) -> None:
        """Let a row that waits for more of its fields come out, as the port fell silent or closed."""
        self._ready.append(self._decoded(end=True))

    def port_opened(self) -> None:
        """Begin a new connection, as the port was opened anew: the device may have restarted meanwhile."""
        self.pause()
        self._device_clock.new_connection()

    def take(self) -> SampleBlock:
        """Return the samples completed since the last call."""
        ready, self._ready = self._ready, []
        block = join([*ready, self._decoded()])
        self._samples += len(block)
        side, self._side_ready = self._side_ready, {}
        self.side = {stream: join(blocks) for stream, blocks in side.items()}
        return block

    def notices(self) -> list[str]:
        """Return, once each, what the device sent that is not data."""
        return self._decoder.notices()

    def warnings(self) -> list[str]:
        """Return, once each, the remarks of decoder and estimators on the data or on their parameters."""
        dated_by = self._device_clock.dated_by
        texts = [
            *self._remarks,
            *self._decoder.warnings(),
            *(self._nominal.notices(self._ended) if dated_by in BY_RATE else ()),
            *self._repeats.notices(dated_by),
            *self._intake.notices(self._ended),
            *(text for stage in self._stages for text in stage.notices()),
        ]
        new = [text for text in dict.fromkeys(texts) if text not in self._reported]
        self._reported.update(new)
        return new

    def charts(self) -> list[Chart]:
        """Return the charts of the estimators as they are now."""
        return [chart for stage in self._stages for chart in stage.charts()]

    def lanes(self) -> dict[str, LaneState]:
        """Return the states that the estimators report, by lane."""
        return {lane: state for stage in self._stages for lane, state in stage.lanes().items()}

    def _decoded(self, end: bool = False) -> SampleBlock:
        """Put together and date what the decoder has completed, and estimate."""
        if self._of_table:
            return SampleBlock({})
        packets = self._decoder.take_packets()
        if self._epochs is None:
            return self._dated(packets.block, np.zeros(len(packets.block), np.int64), [])
        streams = self._epochs.process(packets, end)
        main = streams.pop(MAIN)
        block = self._dated(self._held.process(main.block, streams), main.more, self._epochs.counted_aside)
        for stream, epochs in streams.items():
            times = self._side_clock.times(epochs)
            rest = {name: values for name, values in epochs.block.columns.items() if name != "device_ticks"}
            side = SampleBlock(times | rest | times)  # these go first
            self._side_ready.setdefault(stream, []).append(side)
            self._count(stream, side)
        return block

    def _dated(self, raw: SampleBlock, more: IntArray, side: list[tuple[int, int]]) -> SampleBlock:
        n = len(raw)
        columns = dict(raw.columns)
        counter, ticks = columns.get("packet_counter"), columns.pop("device_ticks", None)
        arrival = columns.get("arrival_time_ns", missing(n, np.int64))
        self._repeats.add(counter, ticks, n)
        counted = None if counter is None else self._shared_counter.process(counter, more, side)
        device_ns, segment = self._device_clock.process(counted, ticks, arrival, n)
        if self._device_clock.dated_by in BY_RATE:
            self._nominal.add(device_ns, segment, arrival)
        times: dict[str, ColumnArray] = {
            "device_time_ns": device_ns,
            "arrival_time_ns": arrival,
            "host_time_ns": self.host_clock.process(device_ns, segment, arrival),
            "segment": segment,
        }
        if counter is not None:
            times["packet_counter"] = counter
        dated = SampleBlock(times | columns | times)  # these go first
        self._side_clock.follow(dated, ticks)
        self._count(MAIN, dated)
        return self._estimate(dated)

    def _count(self, stream: str, block: SampleBlock) -> None:
        if len(block) and "device_time_ns" in block:
            segment = block.columns.get("segment", np.zeros(len(block), np.int64))
            self._intervals.setdefault(stream, Intervals()).add(block["device_time_ns"], segment)

    def _estimate(self, block: SampleBlock) -> SampleBlock:
        """Run the stages over what no sensor fault spoils; the columns that were sent stay as they are."""
        if not self._stages and self.sink is None:
            return block
        taken = self._intake.process(block)
        current, added = taken.block, dict[str, ColumnArray]()
        for stage in self._stages:
            new = stage.process(current)
            current = current.with_columns(new)
            added |= {name: taken.spread(values) for name, values in new.items()}
        if self.sink is not None and len(current):
            self.sink(current)
        return block.with_columns(added)


class Digest:
    """Fingerprint of all samples, independent of the division into blocks.

    Two runs with the same digest gave the same columns with the same bits, but for one accident in 2^32: the
    CRC-32 of each column, five times as fast as a hash that withstands a forger.  NaNs count as one value.
    """

    KIND = "crc32:"
    """A digest begins with how it was made: others cannot be compared with it."""

    def __init__(self) -> None:
        self._sums: dict[str, int] = {}
        self._rows = 0
        self._side: dict[str, Digest] = {}

    def update(self, block: SampleBlock, side: Mapping[str, SampleBlock] = {}) -> None:
        """Add samples, and those of side streams."""
        for stream, rows in side.items():
            self._side.setdefault(stream, Digest()).update(rows)
        for name, values in block.columns.items():
            if name not in self._sums:
                # A column that begins late is the same as one that was missing so far.
                self._sums[name] = zlib.crc32(_canonical(missing(self._rows, values.dtype)))
            self._sums[name] = zlib.crc32(_canonical(values), self._sums[name])
        absent = self._sums.keys() - block.columns.keys()
        if len(block) and absent:
            raise ValueError(f"columns {sorted(absent)} vanished between blocks")
        self._rows += len(block)

    def columns(self, without: Collection[str] = ()) -> dict[str, int]:
        """Return the CRC-32 of each column so far, of side streams as ``STREAM/COLUMN``."""
        own = {name: value for name, value in self._sums.items() if name not in without}
        for stream, digest in self._side.items():
            own |= {f"{stream}/{name}": value for name, value in digest.columns().items()}
        return own

    def hexdigest(self) -> str:
        """Return the fingerprint of the samples so far."""
        whole = hashlib.sha256(str(self._rows).encode())
        for name in sorted(self._sums):
            whole.update(f" {name} {self._sums[name]:08x}".encode())
        for stream in sorted(self._side):
            whole.update(f" {stream} {self._side[stream].hexdigest()}".encode())
        return self.KIND + whole.hexdigest()


def _canonical(values: ColumnArray) -> memoryview:
    """Return values one after the other in memory, all NaNs with the same bits."""
    if values.dtype == np.float64 and (absent := np.isnan(values)).any():
        return np.where(absent, np.nan, values).data
    return np.ascontiguousarray(values).data
