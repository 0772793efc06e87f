"""Packets among bytes: what a frame is, and the one search for frames, in plain NumPy.

A frame begins with a sync pattern; its length is fixed, in a field, or follows from what its header says; a
checksum tells whether it came whole.  A family of devices says so in a `Frame` for each kind of packet, and
`Decoder` does the rest: every byte becomes part of a packet, is skipped, or is pending.

The bytes are searched when somebody takes what they hold (live 12 times a second), not as they come: so a
read of a few bytes costs next to nothing, and what is found does not depend on how the stream was cut.

How damage is survived: after a bad checksum or an impossible length the search goes on at the next byte.  A
damaged packet that lost bytes and passes its check all the same (one in 256 with a sum of eight bits) ends
inside the next.  So where no sync pattern follows an accepted packet, a valid one that begins inside it and
ends behind it is accepted, too; bytes count once.  Not so inside a packet that has no checksum.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from imumon.blocks import BoolArray, IntArray, SampleBlock, join, missing
from imumon.columns import Column
from imumon.protocols.base import Groups, Packets, Timing
from imumon.protocols.stream import CHUNK, ByteArray
from imumon.transport.statistics import Counters

INCOMPLETE, NO_PACKET, IMPOSSIBLE, BAD_SUM = -1, -2, -3, -4
"""Instead of a length: more bytes must come, nothing of this kind, no such length, the checksum differs."""

MOST_AT_ONCE = 1 << 20
"""Bytes that are searched at once at the most: what is made of them takes twenty times as much memory."""
MOST_NOTICES = 1000
"""Different notices that a decoder gives at the most; more would be a stream of rubbish."""

Lengths = Callable[[ByteArray, IntArray], IntArray]
"""Takes the bytes and places of sync patterns, (n,); returns the whole length or one of the codes, (n,)."""
Check = Callable[[ByteArray, IntArray, IntArray], BoolArray]
"""Takes the bytes, places and lengths of whole packets, (n,) each; tells which are right."""


def unchecked(held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Believe every packet."""
    del held, length
    return np.ones(len(at), np.bool_)


@dataclass(frozen=True, slots=True)
class Frame:
    """How packets of one kind are told from other bytes."""

    name: str
    """What the kind is called in the counters."""
    sync: bytes
    """What a packet begins with."""
    lengths: Lengths
    """See `Lengths`."""
    check: Check
    """See `Check`."""
    tail: bytes = b""
    """What may or may not follow a packet, and belongs to it."""
    fits: Check | None = None
    """Tells of packets that came whole whether they can be of this kind by what is in them."""

    def places(self, held: ByteArray) -> IntArray:
        """Return where the sync pattern is, also where its first bytes are at the very end."""
        sync = np.frombuffer(self.sync, np.uint8)
        found: IntArray = np.flatnonzero(held == sync[0])
        for k in range(1, len(sync)):
            there = found + k < len(held)
            found = found[~there | (held[np.minimum(found + k, len(held) - 1)] == sync[k])]
        return found

    def measured(self, held: ByteArray, at: IntArray) -> IntArray:
        """Return for each place the length that a packet has there, if it is right, or why there is none."""
        length = np.full(len(at), INCOMPLETE, np.int64)
        begun = np.flatnonzero(at + len(self.sync) <= len(held))
        length[begun] = self.lengths(held, at[begun])
        length[(length > 0) & (at + length > len(held))] = INCOMPLETE
        return length

    def verdicts(self, held: ByteArray, at: IntArray, length: IntArray, final: bool) -> IntArray:
        """Return for each whole packet its length with its tail, or what is wrong, (n,)."""
        right = self.check(held, at, length)
        whole = self._with_tail(held, at, length, final) if self.tail else length
        verdict = np.where(right, whole, BAD_SUM)
        if self.fits is not None:
            which = np.flatnonzero(right)
            verdict[which[~self.fits(held, at[which], length[which])]] = IMPOSSIBLE
        return verdict

    def _with_tail(self, held: ByteArray, at: IntArray, length: IntArray, final: bool) -> IntArray:
        """Return the lengths with that of the tail where it follows; `INCOMPLETE` where it may come yet."""
        agree = np.ones(len(at), np.bool_)
        for k, byte in enumerate(self.tail):
            place = at + length + k
            agree &= (place >= len(held)) | (held[np.minimum(place, len(held) - 1)] == byte)
        there = at + length + len(self.tail) <= len(held)
        cut = length if final else np.full(len(at), INCOMPLETE)
        return np.where(agree, np.where(there, length + len(self.tail), cut), length)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Packets among held bytes: where each begins, its length, and the number of its frame, (n,) each."""

    held: ByteArray
    at: IntArray
    length: IntArray
    frame: IntArray

    def __len__(self) -> int:
        """Return the number of packets."""
        return len(self.at)

    def only(self, rows: IntArray | BoolArray) -> Found:
        """Return some of the packets."""
        return Found(self.held, self.at[rows], self.length[rows], self.frame[rows])

    def bytes(self, size: int | None = None) -> ByteArray:
        """Return the first bytes of each packet, (n, size); of packets of one length all when not given."""
        if size is None:
            size = int(self.length[0]) if len(self) else 0
        return windows(self.held, self.at, size)


def windows(held: ByteArray, at: IntArray, size: int) -> ByteArray:
    """Return so many bytes from each place on, (n, size)."""
    if not size or not len(at):
        return np.zeros((len(at), size), np.uint8)
    # Taken as items of one type they are copied as wholes, twenty times faster than byte by byte.
    every = np.ndarray((len(held) - size + 1,), f"V{size}", held, strides=(1,))
    return every[at].view(np.uint8).reshape(-1, size)


class Decoder(ABC):
    """Turns a byte stream into columns, whatever the chunking; `take` returns what has come since.

    It finds packets by frames and keeps count of every byte; a subclass reads what is in them.

    Parameters
    ----------
    frames : sequence of Frame
        Kinds of packets; where two begin at the same place the first that is valid counts.
    """

    timing: Timing
    groups: Groups | None = None
    """Groups of the fields, for a protocol that may spread one moment over several packets; else None."""

    def __init__(self, frames: Sequence[Frame]) -> None:
        self._frames = tuple(frames)
        self._done: list[Packets] = []
        self._notices: dict[str, bool] = {}
        self._warned: dict[str, bool] = {}
        self._parts: list[bytes] = []
        self._waiting = 0  # bytes in the parts
        self._rest = b""  # searched, and still part of what may become a packet
        self._overlap = 0  # bytes at the front of the rest that belong to the packet accepted last
        # Bytes up to each end, counted from the first, arrived at these times.
        self._ends: list[IntArray] = []
        self._times: list[IntArray] = []
        self._searched = 0  # bytes before the rest
        self._received = self._in_packets = self._checksum_errors = self._length_errors = 0
        self._by_frame = [0] * len(self._frames)

    @property
    @abstractmethod
    def columns(self) -> tuple[Column, ...]:
        """Columns of the blocks that `take` returns now; a device may begin to send more."""

    @property
    @abstractmethod
    def possible_columns(self) -> tuple[Column, ...]:
        """All columns that may ever come."""

    @abstractmethod
    def _read(self, found: Found, arrival_ns: IntArray) -> Packets:
        """Return what the packets carry: a row for each that has something for a row, in order."""

    def feed(self, data: bytes | memoryview | ByteArray, arrival_ns: int) -> None:
        """Take bytes that arrived at `arrival_ns` (Unix time, ns)."""
        self.feed_reads(data, np.array([len(data)]), np.array([arrival_ns]))

    def feed_reads(self, data: bytes | memoryview | ByteArray, ends: IntArray, arrivals_ns: IntArray) -> None:
        """Take the bytes of several reads: of each where it ends in the data, and when it arrived."""
        self._ends.append(ends + self._received)
        self._times.append(arrivals_ns.copy())
        for start in range(0, len(data), MOST_AT_ONCE):
            part = bytes(data[start : start + MOST_AT_ONCE])
            self._parts.append(part)
            self._waiting += len(part)
            self._received += len(part)
            if self._waiting > CHUNK:
                self._search(final=False)

    def take(self) -> SampleBlock:
        """Return the packets decoded since the last call, a row each."""
        return self.take_packets().block

    def take_packets(self) -> Packets:
        """Return the packets decoded since the last call, with the groups of their fields."""
        self._search(final=False)
        done, self._done = self._done, []
        if not done:
            empty = {column.name: missing(0, column.dtype) for column in self.columns}
            return Packets(SampleBlock(empty), np.zeros(0, np.int64))
        return Packets(join([part.block for part in done]), np.concatenate([part.groups for part in done]))

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data (errors, warnings, configuration)."""
        self._search(final=False)
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

    def finish(self) -> None:
        """Decode what is held on the understanding that no more bytes come.

        A damaged header that claims a long packet holds back the packets behind it until that length has
        arrived; at the end of the data they are found.  What is pending afterwards is a packet cut short.
        """
        self._search(final=True)

    def counters(self) -> Counters:
        """Return what became of the bytes so far."""
        self._search(final=False)
        named = {f.name: n for f, n in zip(self._frames, self._by_frame, strict=True) if n}
        return Counters(
            bytes_received=self._received,
            bytes_in_packets=self._in_packets,
            bytes_skipped=self._received - self._in_packets - len(self._rest) + self._overlap,
            packets=sum(self._by_frame),
            checksum_errors=self._checksum_errors,
            length_errors=self._length_errors,
            packets_by_type=named,
        )

    def _search(self, final: bool) -> None:
        """Find the packets in what has come, and keep what may still become one."""
        if not self._waiting and not (final and self._rest):
            return
        data = b"".join([self._rest, *self._parts])
        self._parts.clear()
        self._waiting = 0
        candidates = _Candidates(self._frames, np.frombuffer(data, np.uint8), final)
        taken, rest, overlap = candidates.walk(self._overlap)
        found = candidates.found(taken)
        self._count(found, candidates.at, candidates.verdict, rest)
        ends, times = np.concatenate(self._ends), np.concatenate(self._times)
        if len(found):
            last = self._searched + found.at + found.length
            packets = self._read(found, times[np.searchsorted(ends, last)])
            if len(packets):
                self._done.append(packets)
        self._rest, self._overlap = data[rest:], overlap
        self._searched += rest
        recent = int(np.searchsorted(ends, self._searched, "right"))
        self._ends, self._times = [ends[recent:]], [times[recent:]]

    def _count(self, found: Found, at: IntArray, verdict: IntArray, rest: int) -> None:
        """Count the packets, their bytes once each, and the errors outside of them."""
        ends = found.at + found.length
        begins = np.maximum(found.at, np.concatenate([[self._overlap], ends[:-1]])) if len(found) else ends
        self._in_packets += int(np.sum(ends - begins))
        for number, packets in enumerate(np.bincount(found.frame, minlength=len(self._frames)).tolist()):
            self._by_frame[number] += packets
        inside = np.searchsorted(found.at, at, "right") - 1
        covered = np.where(inside >= 0, ends[inside], 0) if len(found) else np.zeros(len(at), np.int64)
        outside = (at >= np.maximum(covered, self._overlap)) & (at < rest)
        self._checksum_errors += int(np.sum(outside & (verdict == BAD_SUM)))
        self._length_errors += int(np.sum(outside & (verdict == IMPOSSIBLE)))


def _once(texts: dict[str, bool]) -> list[str]:
    """Return the texts that were not given before."""
    new = [text for text, given in texts.items() if not given]
    texts.update(dict.fromkeys(new, True))
    return new


class _Candidates:
    """Places of sync patterns in order, one for each place, with what a packet there would be.

    The first frame counts that finds a packet there; or that may still find one, when more bytes come.
    """

    def __init__(self, frames: Sequence[Frame], held: ByteArray, final: bool) -> None:
        self._frames, self._held, self._final = frames, held, final
        places = [frame.places(held) for frame in frames]
        at = np.concatenate(places)
        frame = np.repeat(np.arange(len(frames)), [len(one) for one in places])
        verdicts = [self._verdicts(f, one) for f, one in zip(frames, places, strict=True) if len(one)]
        verdict = np.concatenate([*verdicts, np.zeros(0, np.int64)])
        if len(frames) > 1:
            hopeless = (verdict <= 0) & (final | (verdict != INCOMPLETE))
            order = np.argsort(2 * at + hopeless, kind="stable")
            order = order[np.diff(at[order], prepend=-1) > 0]
            at, frame, verdict = at[order], frame[order], verdict[order]
        self.at, self._frame, self.verdict = at, frame, verdict
        self._begins = np.zeros(len(held) + 1, np.bool_)
        self._begins[at] = True

    def _verdicts(self, frame: Frame, at: IntArray) -> IntArray:
        """Return for each place the length of the packet there, or why there is none."""
        verdict = frame.measured(self._held, at)
        whole = np.flatnonzero(verdict > 0)
        verdict[whole] = frame.verdicts(self._held, at[whole], verdict[whole], self._final)
        return verdict

    def found(self, which: IntArray) -> Found:
        """Return some candidates as packets."""
        return Found(self._held, self.at[which], self.verdict[which], self._frame[which])

    def walk(self, done: int) -> tuple[IntArray, int, int]:
        """Return which candidates are taken, where the rest begins, and how many of its bytes are taken.

        A candidate that is not complete holds back what follows; at the end of the data it is passed over,
        and stays pending when no packet follows.
        """
        of_interest = np.flatnonzero((self.verdict > 0) | (self.verdict == INCOMPLETE))
        at, verdict = self.at[of_interest], self.verdict[of_interest]
        # Most packets stand one directly behind the other: such a run is taken at once.
        joined = (verdict[:-1] > 0) & (verdict[1:] > 0) & (at[1:] == at[:-1] + verdict[:-1])
        stops = np.append(np.flatnonzero(~joined), len(at) - 1)
        run_end = stops[np.searchsorted(stops, np.arange(len(at)))] + 1
        runs: list[IntArray] = [of_interest[:0]]
        k, rest, pending, is_checked = 0, len(self._held), -1, True
        while k < len(at):
            start, length = int(at[k]), int(verdict[k])
            overlaps = start < done
            if overlaps and (0 < length <= done - start or self._begins[done] or not is_checked):
                k += 1
            elif length > 0:
                stop = int(run_end[k])
                runs.append(of_interest[k:stop])
                done, pending, k = int(at[stop - 1] + verdict[stop - 1]), -1, stop
                is_checked = self._frames[self._frame[of_interest[stop - 1]]].check is not unchecked
            elif not self._final:
                rest = start
                break
            else:
                pending = start if pending < 0 and start >= done else pending
                k += 1
        if pending >= 0:
            rest = pending
        return np.concatenate(runs), rest, max(done - rest, 0)


def fixed_length(size: int) -> Lengths:
    """Return the `Lengths` of packets that are all of one size."""

    return partial(_all_of, size)


def counted_length(at: int, size: int, more: int, longest: int) -> Lengths:
    """Return the `Lengths` of packets that say how many bytes they have besides `more`, low byte first.

    Parameters
    ----------
    at, size : int
        Place and bytes of the number.
    more : int
        Bytes that it does not count.
    longest : int
        Longest packet that is believed.
    """
    return partial(_counted, at, size, more, longest)


def _all_of(size: int, held: ByteArray, at: IntArray) -> IntArray:
    del held
    return np.full(len(at), size, np.int64)


def _counted(at: int, size: int, more: int, longest: int, held: ByteArray, begin: IntArray) -> IntArray:
    result = np.full(len(begin), INCOMPLETE, np.int64)
    there = np.flatnonzero(begin + at + size <= len(held))
    counted = np.zeros(len(there), np.int64)
    for k in range(size):
        counted |= held[begin[there] + at + k].astype(np.int64) << 8 * k
    result[there] = np.where(counted + more <= longest, counted + more, IMPOSSIBLE)
    return result
