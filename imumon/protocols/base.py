"""What every decoder and encoder is: bytes in, columns out, every byte accounted for."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeVar

import numpy as np

from imumon.blocks import IntArray, SampleBlock, join, missing
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.stream import ByteArray
from imumon.transport.statistics import Counters

T = TypeVar("T")

MAIN = "imu"
"""Name of the stream of the inertial sensors."""
COMMON = ("arrival_time_ns", "device_ticks", "packet_counter")
"""Columns of a packet that every stream of its fields has."""

MOST_NOTICES = 1000
"""Different notices that a decoder gives at the most; more would be a stream of rubbish."""

ONLY_CORRECTED = (
    "only rates come from which the device's filter has taken its own estimate of the bias "
    "(gyro_compensated_*): what imumon finds is the rest of it"
)
"""Warning of a device that sends no rate as it was calibrated in the factory."""


@dataclass(frozen=True, slots=True)
class Timing:
    """How a device counts time."""

    counter_bits: int | None = None
    """``packet_counter`` wraps at 2**counter_bits and rises by one a packet; None when there is no
    counter."""
    tick_ns: Fraction | None = None
    """Nanoseconds per count of ``device_ticks``; None when the device sends no time."""
    tick_bits: int = 0
    """``device_ticks`` wraps at 2**tick_bits; 0 when it never wraps."""
    rate_hz: float | None = None
    """Nominal packet rate, which dates packets of a device that sends no time."""


@dataclass(frozen=True, slots=True)
class Groups:
    """Which columns belong together."""

    names: tuple[str, ...]
    """Groups in the order of their bits; the first is `MAIN`."""
    of_column: Mapping[str, int]
    """Group of each column; a column that is not here goes with every row of its packet."""
    apart: tuple[bool, ...]
    """Groups that never join the main stream."""


@dataclass(frozen=True, slots=True, eq=False)
class Packets:
    """Decoded packets in order of arrival."""

    block: SampleBlock
    """One row each."""
    groups: IntArray
    """Bits of the groups of which the packet has fields, (n,)."""

    def __len__(self) -> int:
        """Return the number of packets."""
        return len(self.block)


class Decoder(ABC):
    """Turns a byte stream into columns, whatever the chunking; `take` hands out what has come since.

    After a bad checksum or an impossible length the search steps one byte and looks again, so a damaged
    packet never hides a good one.
    """

    timing: Timing
    groups: Groups | None = None
    """Groups of the fields, for a protocol that may spread one moment over several packets; else None."""

    def __init__(self) -> None:
        self._end, self._arrival_ns = np.zeros(1, np.int64), np.zeros(1, np.int64)
        self._done: list[Packets] = []
        self._notices: dict[str, bool] = {}
        self._warned: dict[str, bool] = {}

    @property
    @abstractmethod
    def columns(self) -> tuple[Column, ...]:
        """Columns of the blocks that `take` returns now; a device may begin to send more."""

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """All columns that may ever come."""
        return self.columns

    @abstractmethod
    def feed_reads(self, data: bytes | memoryview | ByteArray, ends: IntArray, arrivals_ns: IntArray) -> None:
        """Decode the bytes of several reads: of each where it ends in the data, and when it arrived."""

    @abstractmethod
    def finish(self) -> None:
        """Decode what is held on the understanding that no more bytes come.

        A damaged header that claims a long packet holds back the packets behind it until that length has
        arrived; at the end of the data they are found.  What is pending afterwards is a packet cut short.
        """

    @abstractmethod
    def counters(self) -> Counters:
        """Return what became of the bytes so far."""

    @abstractmethod
    def _settle(self) -> None:
        """Put everything that is decoded into `_done`."""

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data (errors, warnings, configuration)."""
        return _once(self._notices)

    def warnings(self) -> list[str]:
        """Return, once each, why numbers are not fit for an estimate: the device has corrected them, say."""
        return _once(self._warned)

    def _say(self, text: str) -> None:
        """Keep a notice unless it was given before."""
        if len(self._notices) < MOST_NOTICES:
            self._notices.setdefault(text, False)

    def _warn(self, text: str) -> None:
        self._warned.setdefault(text, False)

    def feed(self, data: bytes | memoryview | ByteArray, arrival_ns: int) -> None:
        """Decode bytes that arrived at `arrival_ns` (Unix time, ns)."""
        self._end[0], self._arrival_ns[0] = len(data), arrival_ns
        self.feed_reads(data, self._end, self._arrival_ns)

    def take(self) -> SampleBlock:
        """Return the packets decoded since the last call, a row each, as arrays of their own."""
        return self.take_packets().block

    def take_packets(self) -> Packets:
        """Return the packets decoded since the last call, with the groups of their fields."""
        self._settle()
        done, self._done = self._done, []
        if not done:
            empty = {column.name: missing(0, column.dtype) for column in self.columns}
            return Packets(SampleBlock(empty), np.zeros(0, np.int64))
        return Packets(join([part.block for part in done]), np.concatenate([part.groups for part in done]))


def _once(texts: dict[str, bool]) -> list[str]:
    """Return the texts that were not given before."""
    new = [text for text, given in texts.items() if not given]
    texts.update(dict.fromkeys(new, True))
    return new


class Encoder(ABC):
    """Makes the bytes that a device would send, for tests, the virtual device and benchmarks."""

    @abstractmethod
    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return one packet per row; columns that the block lacks are sent as zero.

        Counters and clocks wrap as in the device.  What is missing is sent as NaN, or as zero where the
        number has no NaN.

        Raises BAD_DATA when a value does not fit the field that carries it.
        """


def chosen(names: Sequence[str], there: Mapping[str, T], what: str) -> list[T]:
    """Return what is sent, by its names.

    Raises BAD_CONFIG when there is nothing of a name, or nothing to send.
    """
    for name in names:
        if name not in there:
            known = ", ".join(sorted(there))
            raise ImumonError(Reason.BAD_CONFIG, f"no {what} {name!r}", f"there are: {known}")
    if not names:
        raise ImumonError(Reason.BAD_CONFIG, "there is nothing to send")
    return [there[name] for name in names]
