"""The one path from bytes to samples with times and estimates, for live, replay and decode alike.

The results depend on the bytes, their arrival times and the events between them, never on how the stream was
cut into pieces: a replay of a recording gives the same numbers, bit for bit.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, SampleBlock, join, missing
from imumon.charts import Chart
from imumon.clock import DeviceClock, HostClock
from imumon.columns import KNOWN, TIME_COLUMNS, Column
from imumon.protocols.base import Counters, Timing
from imumon.protocols.device import DeviceFile

UNDATED = NO_INT
"""Arrival time of bytes whose arrival nobody noted, as in a raw capture."""


class Estimator(Protocol):
    """A stage behind the clock: columns in, more columns out, sample by sample."""

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; the result must not depend on the division into blocks."""

    def notices(self) -> list[str]:
        """Return, once each, what the user should know of the data or of the parameters."""


@runtime_checkable
class Charting(Protocol):
    """A stage that has more to show than its columns."""

    def charts(self) -> Sequence[Chart]:
        """Return its charts as they are now; empty while there is nothing to show."""


@runtime_checkable
class Judging(Protocol):
    """A stage that judges: each judgement is a lane of states in the view."""

    def lanes(self) -> Mapping[str, str]:
        """Return the state of each of its lanes as it is now."""


@dataclass(frozen=True, slots=True)
class PipelineCounters:
    """What became of every byte and packet; the keys of ``--json`` and of session.yaml."""

    packets: int
    packets_by_type: dict[str, int]
    bytes_received: int
    bytes_in_packets: int
    bytes_skipped: int
    bytes_pending: int
    checksum_errors: int
    length_errors: int
    counter_gaps: int
    packets_missing: int
    clock_restarts: int
    samples: int

    def as_dict(self) -> dict[str, object]:
        """Return the counters as they are printed and stored."""
        return asdict(self)


class Pipeline:
    """Decoder, clock and estimators in order.

    Parameters
    ----------
    device : DeviceFile or None
        What sends the bytes; None when samples come from a table, through `push`.
    estimators : sequence of Estimator
        Stages behind the clock, each of which sees the columns of those before it.
    """

    def __init__(self, device: DeviceFile | None, estimators: Sequence[Estimator] = ()) -> None:
        self._decoder = device.decoder() if device is not None else None
        self._device_clock = DeviceClock(self._decoder.timing if self._decoder is not None else Timing())
        self.host_clock = HostClock(self._device_clock.drift_limit_ppm)
        self._estimators = tuple(estimators)
        self._samples = 0
        self._ready: list[SampleBlock] = []

    @property
    def estimators(self) -> tuple[Estimator, ...]:
        """The stages, in their order."""
        return self._estimators

    @property
    def columns(self) -> list[Column]:
        """Columns of the decoded blocks so far, in the order in which tables have them."""
        decoded = {column.name: column for column in self._decoder.columns} if self._decoder else {}
        times = [KNOWN[name] for name in TIME_COLUMNS if name != "packet_counter" or name in decoded]
        rest = [c for c in decoded.values() if c.name not in TIME_COLUMNS and c.name != "device_ticks"]
        return [*times, *rest, *(column for stage in self._estimators for column in stage.columns)]

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column that may ever come."""
        decoded = self._decoder.possible_columns if self._decoder is not None else ()
        added = [column for stage in self._estimators for column in stage.columns]
        return {column.name: column.unit for column in (*decoded, *added)}

    @property
    def counters(self) -> PipelineCounters:
        """What became of every byte and packet so far."""
        raw = self._decoder.counters() if self._decoder is not None else Counters()
        return PipelineCounters(
            packets=raw.packets,
            packets_by_type=dict(raw.packets_by_type),
            bytes_received=raw.bytes_received,
            bytes_in_packets=raw.bytes_in_packets,
            bytes_skipped=raw.bytes_skipped,
            bytes_pending=raw.bytes_pending,
            checksum_errors=raw.checksum_errors,
            length_errors=raw.length_errors,
            counter_gaps=self._device_clock.counter_gaps,
            packets_missing=self._device_clock.packets_missing,
            clock_restarts=self._device_clock.resets,
            samples=self._samples,
        )

    def feed(self, data: bytes, arrival_ns: int = UNDATED) -> None:
        """Decode bytes that arrived at `arrival_ns` (Unix time, ns)."""
        if self._decoder is None:
            raise ValueError("a pipeline without a device takes samples, not bytes")
        self._decoder.feed(data, arrival_ns)

    def push(self, block: SampleBlock) -> None:
        """Take samples that have their times already, from a table."""
        self._ready.append(self._estimate(block))

    def finish(self) -> None:
        """Say that no more bytes come: samples held back behind a damaged header come out."""
        if self._decoder is not None:
            self._decoder.finish()

    def port_opened(self) -> None:
        """Say that the port was opened anew: the device may have restarted meanwhile."""
        self._ready.append(self._decoded())
        self._device_clock.new_connection()

    def take(self) -> SampleBlock:
        """Return the samples completed since the last call."""
        ready, self._ready = self._ready, []
        block = join([*ready, self._decoded()])
        self._samples += len(block)
        return block

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data."""
        return self._decoder.notices() if self._decoder is not None else []

    def warnings(self) -> list[str]:
        """Return, once each, what the estimators have to say of the data or of their parameters."""
        return [text for stage in self._estimators for text in stage.notices()]

    def charts(self) -> list[Chart]:
        """Return the charts of the estimators as they are now."""
        return [
            chart for stage in self._estimators if isinstance(stage, Charting) for chart in stage.charts()
        ]

    def lanes(self) -> dict[str, str]:
        """Return the states that the estimators judge, by lane."""
        judging = [stage for stage in self._estimators if isinstance(stage, Judging)]
        return {lane: state for stage in judging for lane, state in stage.lanes().items()}

    def _decoded(self) -> SampleBlock:
        """Date what the decoder has completed, and estimate."""
        if self._decoder is None:
            return SampleBlock({})
        raw = self._decoder.take()
        n = len(raw)
        columns = dict(raw.columns)
        counter, ticks = columns.get("packet_counter"), columns.pop("device_ticks", None)
        arrival = columns.get("arrival_time_ns", missing(n, np.int64))
        device_ns, segment = self._device_clock.process(counter, ticks, arrival, n)
        times: dict[str, ColumnArray] = {
            "device_time_ns": device_ns,
            "arrival_time_ns": arrival,
            "host_time_ns": self.host_clock.process(device_ns, segment, arrival),
            "segment": segment,
        }
        if counter is not None:
            times["packet_counter"] = counter
        return self._estimate(SampleBlock({**times, **{k: v for k, v in columns.items() if k not in times}}))

    def _estimate(self, block: SampleBlock) -> SampleBlock:
        for stage in self._estimators:
            block = block.with_columns(stage.process(block))
        return block


class Digest:
    """Fingerprint of all samples, independent of the division into blocks.

    Two runs with the same digest gave the same columns with the same bits; NaNs count as one value.
    """

    def __init__(self) -> None:
        self._hashes: dict[str, hashlib._Hash] = {}
        self._rows = 0

    def update(self, block: SampleBlock) -> None:
        """Add samples."""
        for name, values in block.columns.items():
            if name not in self._hashes:
                # A column that begins late is the same as one that was missing so far.
                self._hashes[name] = hashlib.sha256(_canonical(missing(self._rows, values.dtype)))
            self._hashes[name].update(_canonical(values))
        absent = self._hashes.keys() - block.columns.keys()
        if len(block) and absent:
            raise ValueError(f"columns {sorted(absent)} vanished between blocks")
        self._rows += len(block)

    def hexdigest(self) -> str:
        """Return the fingerprint of the samples so far."""
        whole = hashlib.sha256(str(self._rows).encode())
        for name in sorted(self._hashes):
            whole.update(name.encode() + self._hashes[name].digest())
        return whole.hexdigest()


def _canonical(values: ColumnArray) -> bytes:
    if values.dtype == np.float64:
        return np.where(np.isnan(values), np.nan, values).tobytes()
    return values.tobytes()
