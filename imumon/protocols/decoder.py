"""The decoder that all families share: what a packet carries is a *layout*."""

from collections.abc import Iterable, Sequence

import numpy as np

from imumon.blocks import ColumnArray, IntArray, SampleBlock, join, missing
from imumon.columns import KNOWN, Column
from imumon.transport.statistics import Counters

from .base import CHUNK, ByteArray, Groups, Packets, Timing
from .framing import BAD_SUM, IMPOSSIBLE, Found, Frame, search
from .numbers import Record

MOST_NOTICES = 1000
"""Different notices that a decoder gives at the most; more would be a stream of rubbish.  Assumed."""
ENOUGH_PACKETS = 32  # after which a column that has not come is one that the device does not send; assumed
ONLY_CORRECTED = (
    "only rates come from which the device's filter has taken its own estimate of the bias "
    "(gyro_compensated_*): what imumon finds is the rest of it; send calibrated rates as well, as "
    "MIP's ScaledGyro"
)
"""Warning of a device, of any family, that sends no rate as it was calibrated in the factory."""
Layouts = Iterable[tuple[Record, IntArray]]  # layouts, and which packets have each


class Decoder:
    """Turns a byte stream, however it is cut, into columns; `take` returns what has come since.

    It finds packets by frames, keeps count of every byte, and makes a row of each packet that has a layout.

    `frames`: kinds of packets; where two begin at the same place the first that is valid counts.
    `timing`: how the device counts time.
    `groups`: those of all columns that may come, for a protocol that may spread one moment over several
        packets; None where each packet is a row.
    `possible`: all columns that may come.
    `layouts`: of each name of the frames, in order, where the kind of a packet alone states what it carries.
    `remarks`: on the device file, for `warnings`.
    """

    def __init__(
        self,
        frames: Sequence[Frame],
        timing: Timing,
        groups: Groups | None,
        possible: Iterable[Column] = (),
        layouts: Sequence[Record] = (),
        remarks: Sequence[str] = (),
    ) -> None:
        self.timing, self.groups = timing, groups
        self._frames = tuple(frames)
        self._done: list[Packets] = []
        self._reported = set[str]()
        self._notices = list[str]()
        self._warnings = [*remarks]
        self._parts: list[bytes] = []
        self._waiting = 0  # bytes in the parts
        self._rest = b""  # searched, and still part of what may become a packet
        self._overlap = 0  # bytes at the front of the rest that belong to the packet accepted last
        # End of each read, in bytes from the beginning of the stream, and when it arrived (Unix time, ns).
        self._ends: list[IntArray] = []
        self._times: list[IntArray] = []
        self._searched = 0  # bytes before the rest
        self._received = self._in_packets = self._checksum_errors = self._length_errors = 0
        self._names = [name for frame in frames for name in frame.names.values()]
        self._by_kind = np.zeros(len(self._names), np.int64)
        self._layout_of_kind = layouts
        self._columns = {"arrival_time_ns": KNOWN["arrival_time_ns"]}
        self._columns |= {column.name: column for layout in layouts for column in layout.columns}
        self._possible = self._columns | {column.name: column for column in possible}

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of the blocks that `take` returns now, canonical ones first; more may come later."""
        self._search(final=False)
        names = [name for name in KNOWN if name in self._columns]
        names += sorted(self._columns.keys() - KNOWN.keys())
        return tuple(self._columns[name] for name in names)

    @property
    def possible_columns(self) -> tuple[Column, ...]:
        """All columns that may ever come."""
        return tuple((self._possible | self._columns).values())

    def feed(self, data: bytes | memoryview | ByteArray, arrival_ns: int) -> None:
        """Take bytes that arrived at `arrival_ns` (Unix time, ns)."""
        self.feed_reads(data, np.array([len(data)]), np.array([arrival_ns]))

    def feed_reads(self, data: bytes | memoryview | ByteArray, ends: IntArray, arrivals_ns: IntArray) -> None:
        """Take the bytes of several reads: of each where it ends in the data, and when it arrived."""
        self._ends.append(ends + self._received)
        self._times.append(arrivals_ns.copy())
        for start in range(0, len(data), CHUNK):
            part = bytes(data[start : start + CHUNK])
            self._parts.append(part)
            self._waiting += len(part)
            self._received += len(part)
            if self._waiting > CHUNK:
                self._search(final=False)

    def take(self) -> SampleBlock:
        """Return the packets decoded since the last call, a row each."""
        return self.take_packets().block

    def take_packets(self) -> Packets:
        """Return the packets decoded since the last call, with all columns that have come so far."""
        self._search(final=False)
        done, self._done = self._done, []
        block = join([part.block for part in done])
        groups = np.concatenate([np.zeros(0, np.int64), *(part.groups for part in done)])
        columns = {
            column.name: block[column.name] if column.name in block else missing(len(groups), column.dtype)
            for column in self.columns
        }
        return Packets(SampleBlock(columns), groups)

    def finish(self) -> None:
        """Decode what is held on the understanding that no more bytes come.

        A damaged header that claims a long packet holds back the packets behind it until that length has
        arrived; at the end of the data they are found.  What is pending afterwards is a packet cut short.
        """
        self._search(final=True)

    def notices(self) -> list[str]:
        """Return, once each, what the device reported that is not data (errors, warnings, configuration)."""
        self._search(final=False)
        new, self._notices = self._notices, []
        return new

    def warnings(self) -> list[str]:
        """Return, once each, why numbers are unfit for an estimate, as when the device has corrected them."""
        corrected = "gyro_compensated_x" in self._columns and "gyro_x" not in self._columns
        if corrected and self._by_kind.sum() >= ENOUGH_PACKETS:
            self._report(ONLY_CORRECTED, is_warning=True)
        new, self._warnings = self._warnings, []
        return new

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        self._search(final=False)
        return Counters(
            bytes_received=self._received,
            bytes_in_packets=self._in_packets,
            bytes_skipped=self._received - self._in_packets - (len(self._rest) - self._overlap),  # pending
            packets=int(self._by_kind.sum()),
            checksum_errors=self._checksum_errors,
            length_errors=self._length_errors,
            packets_by_type={name: n for name, n in self._by_type().items() if n},
        )

    def _by_type(self) -> dict[str, int]:
        counts = dict.fromkeys(self._names, 0)
        for name, n in zip(self._names, self._by_kind.tolist(), strict=True):
            counts[name] += n
        return counts

    def _report(self, text: str, is_warning: bool = False) -> None:
        if text not in self._reported and (is_warning or len(self._reported) < MOST_NOTICES):
            self._reported.add(text)
            (self._warnings if is_warning else self._notices).append(text)

    def _search(self, final: bool) -> None:
        """Find the packets in what has come, and keep what may still become one."""
        if not self._waiting and not (final and self._rest):
            return
        data = b"".join([self._rest, *self._parts])
        self._parts.clear()
        self._waiting = 0
        held = np.frombuffer(data, np.uint8)
        tried, found, rest, overlap = search(self._frames, held, final, self._overlap)
        self._count(found, tried, rest)
        ends, times = np.concatenate(self._ends), np.concatenate(self._times)
        if len(found):
            last = self._searched + found.at + found.length
            packets = self._read(found, times[np.searchsorted(ends, last)])
            if len(packets.block):
                self._done.append(packets)
        self._rest, self._overlap = data[rest:], overlap
        self._searched += rest
        recent = int(np.searchsorted(ends, self._searched, "right"))
        self._ends, self._times = [ends[recent:]], [times[recent:]]

    def _count(self, found: Found, tried: Found, rest: int) -> None:
        """Count the packets, their bytes once each, and the errors outside of them."""
        # The first is of the last packet of the search before: so ends[k] is the end of the one before k.
        ends = np.append(self._overlap, found.at + found.length)
        self._in_packets += int(np.sum(ends[1:] - np.maximum(found.at, ends[:-1])))
        self._by_kind += np.bincount(found.kind, minlength=len(self._names))
        end_before = ends[np.searchsorted(found.at, tried.at, "right")]
        outside = (tried.at >= end_before) & (tried.at < rest)
        self._checksum_errors += int(np.sum(outside & (tried.length == BAD_SUM)))
        self._length_errors += int(np.sum(outside & (tried.length == IMPOSSIBLE)))

    def _plain(self, found: Found) -> Found:
        """Return the packets as the layouts have them, where they are sent in another form."""
        return found

    def _by_layout(self, found: Found) -> Layouts:
        """Yield the layouts of the packets; those without one have nothing for a row."""
        for kind in np.flatnonzero(np.bincount(found.kind)).tolist():
            yield self._layout_of_kind[kind], np.flatnonzero(found.kind == kind)

    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        """Return what the packets carry: a row for each that has something for a row, in order."""
        found = self._plain(found)
        parts = [*self._by_layout(found)]
        rows = np.sort(np.concatenate([np.zeros(0, np.int64), *(mine for _, mine in parts)]), kind="stable")
        columns: dict[str, ColumnArray] = {"arrival_time_ns": arrival_ns[rows]}
        groups = np.ones(len(rows), np.int64)  # bit 0: the main one
        for layout, mine in parts:
            my_rows, values = np.searchsorted(rows, mine), layout.read(found.only(mine))
            if self.groups is not None:
                groups[my_rows] = self.groups.bits({*layout.group_of.values()})
            for column in layout.columns:
                self._columns.setdefault(column.name, column)
                if len(mine) == len(rows):
                    columns[column.name] = values[column.name]
                    continue
                if column.name not in columns:
                    columns[column.name] = missing(len(rows), column.dtype)
                columns[column.name][my_rows] = values[column.name]
        return Packets(SampleBlock(columns), groups)
