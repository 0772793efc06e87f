"""Packets among bytes: what a frame is, its checksums, and the one search for frames, in plain NumPy.

A frame begins with a sync pattern; its length is fixed, in a field, or follows from its header; a
checksum shows whether it came whole.  A family of devices states this in a `Frame` for each kind of packet,
and `Decoder` does the rest: every byte becomes part of a packet, is skipped, or is pending.

The bytes are searched when somebody takes what they hold, not as they come: so a read of a few bytes costs
next to nothing, and what is found does not depend on how the stream was cut.

How damage is survived: after a bad checksum or an impossible length the search goes on at the next byte.  A
damaged packet that lost bytes and passes its check all the same (one in 256 with a sum of eight bits) ends
inside the next.  So where no sync pattern follows an accepted packet, a valid one that begins inside it and
ends behind it is accepted, too; bytes count once.  In one without a checksum nothing proves which is right.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial, reduce
from operator import or_
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, IntArray

from .base import ByteArray

INCOMPLETE, NO_PACKET, IMPOSSIBLE, BAD_SUM = -1, -2, -3, -4
"""Instead of a length: more bytes must come; nothing of this kind; errors: no such length, wrong checksum."""

Lengths = Callable[[ByteArray, IntArray], IntArray]
"""Takes the bytes and places of sync patterns, (n,); returns new whole lengths, or codes, (n,)."""
Check = Callable[[ByteArray, IntArray, IntArray], BoolArray]
"""Takes the bytes, places and lengths of whole packets, (n,) each; returns which are right."""


@dataclass(frozen=True)
class Frame:
    """How packets of one kind, or of several with different starts, are distinguished from other bytes."""

    names: Mapping[bytes, str]
    """Sync patterns, all of the same 1 to 8 bytes, and what the counters call packets that begin so."""
    lengths: Lengths | int  # a number: all packets have this length
    check: Check | None = None  # None: every packet is believed
    tail: bytes = b""  # what may or may not follow a packet, and belongs to it
    fits: Check | None = None
    """Tests whether what is in packets with a right checksum can be of this kind."""

    def candidates(self, held: ByteArray, final: bool) -> tuple[IntArray, IntArray, IntArray]:
        """Return where sync patterns begin, lengths of the packets or codes, and their kinds, (n,) each.

        Also patterns that the end of the bytes cuts off, of any kind.  A length is that with the tail.
        """
        size = len(next(iter(self.names)))
        first_bytes = {name[0] for name in self.names}
        begins = np.flatnonzero(reduce(or_, [held == byte for byte in first_bytes]))
        has_all = begins <= len(held) - size
        at, cut = begins[has_all], begins[~has_all]
        kind = np.full(len(at), -1)
        sync = integers(held, at, size)
        for k, name in enumerate(self.names):
            # As `integers` has it: an int64, which eight bytes may make negative.
            kind[sync == int.from_bytes(name.ljust(8, b"\0"), "little", signed=True)] = k
        at, kind = at[kind >= 0], kind[kind >= 0]
        begun = [k for k in cut if any(name.startswith(held[k:].tobytes()) for name in self.names)]
        cut = np.array(begun, np.int64)
        lengths = np.append(self._checked_lengths(held, at, final), np.full_like(cut, INCOMPLETE))
        return np.append(at, cut), lengths, np.append(kind, np.zeros_like(cut))

    def _checked_lengths(self, held: ByteArray, at: IntArray, final: bool) -> IntArray:
        """Return the lengths of the packets that begin here, with their tails, or the codes of why not."""
        lengths = self.lengths
        checked = np.full_like(at, lengths) if isinstance(lengths, int) else lengths(held, at)
        checked[(checked > 0) & (at + checked > len(held))] = INCOMPLETE
        whole = np.flatnonzero(checked > 0)
        at, length = at[whole], checked[whole]
        right = np.ones(len(at), np.bool_) if self.check is None else self.check(held, at, length)
        with_tail = self._with_tail(held, at, length, final) if self.tail else length
        checked[whole] = np.where(right, with_tail, BAD_SUM)
        if self.fits is not None:
            good = whole[right]
            fit = self.fits(held, at[right], length[right])
            checked[good[~fit]] = IMPOSSIBLE
        return checked

    def _with_tail(self, held: ByteArray, at: IntArray, length: IntArray, final: bool) -> IntArray:
        """Return the lengths with that of the tail where it follows; `INCOMPLETE` where it may come yet."""
        agrees = np.ones(len(at), np.bool_)
        for k, byte in enumerate(self.tail):
            place = at + length + k
            agrees &= (place >= len(held)) | (held[np.minimum(place, len(held) - 1)] == byte)
        is_whole = at + length + len(self.tail) <= len(held)
        cut = length if final else INCOMPLETE
        return np.where(agrees, np.where(is_whole, length + len(self.tail), cut), length)


@dataclass(frozen=True, eq=False)
class Found:
    """Packets, or candidates: where each begins, its length (or code), number of its kind, (n,) each."""

    held: ByteArray
    at: IntArray
    length: IntArray
    kind: IntArray

    def __len__(self) -> int:
        return len(self.at)

    def only(self, rows: IntArray | BoolArray | slice) -> "Found":
        """Return some of the packets."""
        return Found(self.held, self.at[rows], self.length[rows], self.kind[rows])

    def replaced(self, packets: Mapping[int, bytes]) -> "Found":
        """Return the packets, of which some rows are these bytes."""
        at, length, end = self.at.copy(), self.length.copy(), len(self.held)
        for row, packet in packets.items():
            at[row], length[row], end = end, len(packet), end + len(packet)
        held = np.frombuffer(b"".join([self.held.tobytes(), *packets.values()]), np.uint8)
        return Found(held, at, length, self.kind)


def windows(held: ByteArray, at: IntArray, size: int) -> ByteArray:
    """Return so many bytes from each place on, (n, size)."""
    if not size or not len(at):
        return np.zeros((len(at), size), np.uint8)
    # Items of one type are copied as wholes, much faster than byte by byte.
    every = np.ndarray((len(held) - size + 1,), f"V{size}", held, strides=(1,))
    return every[at].view(np.uint8).reshape(-1, size)


def integers(held: ByteArray, at: IntArray, size: int, big: bool = False) -> IntArray:
    """Return the unsigned integers of `size` bytes that begin at these places (of 8 bytes: as int64)."""
    value = np.zeros(len(at), np.int64)
    for n, k in enumerate(range(size)[:: -1 if big else 1]):
        value |= held[at + k].astype(np.int64) << 8 * n
    return value


def candidates(frames: Sequence[Frame], held: ByteArray, final: bool) -> Found:
    """Return what `Frame.candidates` has of all frames in order, one for each place.

    The first frame counts that finds a packet there; or that may still find one, when more bytes come.
    """
    of_frames = []
    kinds_before = 0
    for frame in frames:
        at, length, kind = frame.candidates(held, final)
        of_frames.append((at, length, kinds_before + kind))
        kinds_before += len(frame.names)
    found = Found(held, *map(np.concatenate, zip(*of_frames, strict=True)))
    if len(frames) == 1:
        return found
    is_none = (found.length <= 0) & (final | (found.length != INCOMPLETE))
    order = np.lexsort((is_none, found.at))  # by place; there what is no packet last, else as the frames are
    is_first = np.diff(found.at[order], prepend=-1) > 0
    return found.only(order[is_first])


def search(frames: Sequence[Frame], held: ByteArray, final: bool, end: int) -> tuple[Found, Found, int, int]:
    """Return the candidates, the packets among them, where the rest begins, and where the last ends in it.

    The rest, which more bytes may make a packet, begins with a candidate that is not complete; at the end of
    the data (`final`) only where no packet follows.  `end`: where the last packet of the search before ends.
    """
    tried = candidates(frames, held, final)
    is_checked = [frame.check is not None for frame in frames for _ in frame.names]
    is_sync = np.zeros(len(held) + 1, np.bool_)
    is_sync[tried.at] = True
    # What is a packet, or may still become one.
    hopeful = np.flatnonzero((tried.length > 0) | (tried.length == INCOMPLETE))
    at, lengths = tried.at[hopeful], tried.length[hopeful]
    # Most packets stand one directly behind the other: such a run is taken at once.
    adjoins = (lengths[:-1] > 0) & (lengths[1:] > 0) & (at[1:] == at[:-1] + lengths[:-1])
    run_ends = np.append(np.flatnonzero(~adjoins), len(at) - 1)
    last_of_run = run_ends[np.searchsorted(run_ends, np.arange(len(at)))]
    runs: list[IntArray] = [hopeful[:0]]
    k, rest = 0, len(held)
    has_check = True  # the last packet; only one with a checksum ends behind the beginning of a rest
    while k < len(at):
        start, length = int(at[k]), int(lengths[k])
        may_lack_bytes = has_check and not is_sync[end]
        if start < end and (not may_lack_bytes or 0 < length <= end - start):
            k += 1  # a part of the last packet
        elif length > 0:
            last = int(last_of_run[k])
            runs.append(hopeful[k : last + 1])
            end = int(at[last] + lengths[last])
            has_check = is_checked[tried.kind[hopeful[last]]]
            k, rest = last + 1, len(held)
        elif not final:
            rest = start
            break
        else:  # passed over
            if start >= end:
                rest = min(rest, start)
            k += 1
    return tried, tried.only(np.concatenate(runs)), rest, max(end - rest, 0)


def counted_lengths(
    offset: int, size: int, overhead: int, longest: int, held: ByteArray, at: IntArray
) -> IntArray:
    """Return the lengths of packets that state how many bytes they have besides `overhead`; see `Lengths`.

    `offset`, `size`: place and bytes of the number, low byte first.  `longest`: packet that is believed.
    """
    result = np.full_like(at, INCOMPLETE)
    there = np.flatnonzero(at + offset + size <= len(held))
    stated = overhead + integers(held, at[there] + offset, size)
    result[there] = np.where(stated <= longest, stated, IMPOSSIBLE)
    return result


class Crc(NamedTuple):
    """A cyclic redundancy check in the terms of Greg Cook's catalogue (reveng.sourceforge.io)."""

    width: int  # bits, 16 or 32
    polynomial: int
    initial: int
    reflected: bool  # input and output
    final_xor: int


CRCS = {
    "crc16-arc": Crc(16, 0x8005, 0x0000, True, 0x0000),
    "crc16-modbus": Crc(16, 0x8005, 0xFFFF, True, 0x0000),
    "crc16-xmodem": Crc(16, 0x1021, 0x0000, False, 0x0000),
    "crc16-ccitt-false": Crc(16, 0x1021, 0xFFFF, False, 0x0000),
    "crc16-aug-ccitt": Crc(16, 0x1021, 0x1D0F, False, 0x0000),
    "crc16-genibus": Crc(16, 0x1021, 0xFFFF, False, 0xFFFF),
    "crc16-kermit": Crc(16, 0x1021, 0x0000, True, 0x0000),
    "crc16-mcrf4xx": Crc(16, 0x1021, 0xFFFF, True, 0x0000),
    "crc16-x25": Crc(16, 0x1021, 0xFFFF, True, 0xFFFF),
    "crc32": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF),
    "crc32-mpeg2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0x00000000),
    "crc32c": Crc(32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF),
}
"""CRCs by the names of the catalogue, whose CRC-16/ARC is here crc16-arc."""


def _total(data: ByteArray, weights: npt.ArrayLike = 1) -> IntArray:
    """Return the sum of each row times weights: exact in float64, and five times as fast as in integers."""
    real = data.astype(np.float64)
    return (real @ np.broadcast_to(weights, data.shape[1]).astype(np.float64)).astype(np.int64)


def _words(data: ByteArray, order: str) -> IntArray:
    return _total(np.pad(data, ((0, 0), (0, data.shape[1] % 2))).view(f"{order}u2"))


def _fletcher(data: ByteArray, modulus: int) -> IntArray:
    second = _total(data, np.arange(data.shape[1], 0, -1))
    return second % modulus * 256 + _total(data) % modulus


SUMS: dict[str, tuple[int, Callable[[ByteArray], IntArray]]] = {
    "sum8": (1, _total),
    "sum8-negated": (1, lambda data: -_total(data)),
    "xor8": (1, lambda data: np.bitwise_xor.reduce(data, axis=1).astype(np.int64)),
    "sum16": (2, _total),
    "sum16-words-le": (2, partial(_words, order="<")),
    "sum16-words-be": (2, partial(_words, order=">")),
    "fletcher16": (2, partial(_fletcher, modulus=255)),
    "fletcher16-256": (2, partial(_fletcher, modulus=256)),
}
"""Checksums that are no CRCs: their bytes, and what takes rows of bytes, (n, size), to their sums, (n,).

sum8-negated makes the sum of all bytes and the checksum zero.  sum16-words-* adds numbers of 16 bits, low
(le) or high byte (be) first; a last byte alone has zero for the other.  fletcher16 is modulo 255 (RFC 1145,
second sum in the high byte); fletcher16-256 is the variant modulo 256 that MIP and UBX use.
"""

CHECKSUM_NAMES = ("none", *SUMS, *CRCS)


@dataclass(frozen=True)
class Checksum:
    """A checksum that stands at byte `at` of a packet, of its bytes first <= k < end.

    Without `at` it stands in the last bytes, without `end` it covers all before it.  `zeros` more bytes, and
    those up to a multiple of `align`, which are not sent, count as if they followed the others (CRCs only).
    """

    name: str
    first: int = 0
    big: bool = False  # whether the most significant byte comes first
    zeros: int = 0
    end: int | None = None
    at: int | None = None
    align: int = 1

    @property
    def size(self) -> int:
        """Bytes of the checksum."""
        return CRCS[self.name].width // 8 if self.name in CRCS else SUMS[self.name][0]

    def values(self, held: ByteArray, first: IntArray, end: IntArray) -> IntArray:
        """Return the checksums of the bytes from each `first` to before each `end`."""
        found, sizes = np.zeros(len(first), np.int64), end - first
        for size in np.flatnonzero(np.bincount(sizes)).tolist():  # each size once
            which = np.flatnonzero(sizes == size)
            data = windows(held, first[which], size)
            if self.name in SUMS:
                found[which] = SUMS[self.name][1](data)
                continue
            zeros = self.zeros + (-size % self.align)
            covered = size + zeros
            table, empty = by_distance(CRCS[self.name], 1 << covered.bit_length())  # a power of 2: few tables
            distance = np.arange(covered - 1, zeros - 1, -1, dtype=np.int32)
            found[which] = np.bitwise_xor.reduce(table.take(data + 256 * distance), axis=1) ^ empty[covered]
        return found & ((1 << 8 * self.size) - 1)

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Return which packets are right; see `Check`."""
        place = length - self.size if self.at is None else self.at
        computed = self.values(held, at + self.first, at + (place if self.end is None else self.end))
        return np.asarray(computed == integers(held, at + place, self.size, self.big))

    def sealed(self, body: bytes) -> bytes:
        """Return the packet: the body and its checksum."""
        return self.sealed_rows(np.frombuffer(body, np.uint8)[None]).tobytes()

    def sealed_rows(self, bodies: ByteArray) -> ByteArray:
        """Return packets of bodies of one size, (n, size), with their checksums at `at` or behind them."""
        n, size = bodies.shape
        begin = np.arange(n) * size
        at = size if self.at is None else self.at
        end = at if self.end is None else self.end
        sums = self.values(bodies.reshape(-1), begin + self.first, begin + end)
        most_first = sums.astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - self.size :]
        stored = most_first if self.big else most_first[:, ::-1]
        return np.concatenate([bodies[:, :at], stored, bodies[:, at + self.size :]], axis=1)


@lru_cache
def by_distance(crc: Crc, longest: int) -> tuple[IntArray, IntArray]:
    """Return what a byte adds to the CRC by its distance to the end and its value, and the CRC of zeros.

    Shapes: ((longest + 1) * 256,), distance first, and (longest + 1,).  A CRC is linear: that of any bytes is
    the CRC of as many zeros, XOR what each byte adds.
    """
    mask = (1 << crc.width) - 1
    polynomial, initial = crc.polynomial, crc.initial
    if crc.reflected:
        polynomial, initial = (int(f"{n:0{crc.width}b}"[::-1], 2) for n in (polynomial, initial))
    step = np.arange(256) << (0 if crc.reflected else crc.width - 8)
    for _ in range(8):
        if crc.reflected:
            step = (step >> 1) ^ np.where(step & 1, polynomial, 0)
        else:
            step = ((step << 1) & mask) ^ np.where(step >> (crc.width - 1), polynomial, 0)

    # A column for each value of a byte, and the last one for the register that only zeros come into.
    rows = np.empty((longest + 1, 257), np.uint16 if crc.width == 16 else np.uint32)
    rows[0] = np.append(step, initial)
    for k in range(longest):  # the next row is for one more byte, which is zero
        register = rows[k]
        if crc.reflected:
            rows[k + 1] = (register >> 8) ^ step[register & 0xFF]
        else:
            rows[k + 1] = ((register << 8) & mask) ^ step[register >> (crc.width - 8)]
    return rows[:, :256].reshape(-1), rows[:, 256] ^ crc.final_xor
