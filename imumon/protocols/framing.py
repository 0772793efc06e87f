"""Packets among bytes: what a frame is, its checksums, and the one search for frames, in plain NumPy.

A frame begins with a sync pattern; its length is fixed, in a field, or follows from its header; a
checksum shows whether it came whole.  A family of devices states this in a `Frame` for each kind of packet,
and `Decoder` does the rest: every byte becomes part of a packet, is skipped, or is pending.

The bytes are searched when somebody takes what they hold (live 12 times a second), not as they come: so a
read of a few bytes costs next to nothing, and what is found does not depend on how the stream was cut.

How damage is survived: after a bad checksum or an impossible length the search goes on at the next byte.  A
damaged packet that lost bytes and passes its check all the same (one in 256 with a sum of eight bits) ends
inside the next.  So where no sync pattern follows an accepted packet, a valid one that begins inside it and
ends behind it is accepted, too; bytes count once.  Not so inside a packet that has no checksum.
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
"""Instead of a length: more bytes must come, nothing of this kind, no such length, the checksum differs."""

Lengths = Callable[[ByteArray, IntArray], IntArray]
"""Takes the bytes and places of sync patterns, (n,); returns the whole length or one of the codes, (n,)."""
Check = Callable[[ByteArray, IntArray, IntArray], BoolArray]
"""Takes the bytes, places and lengths of whole packets, (n,) each; returns which are right."""


@dataclass(frozen=True)
class Frame:
    """How packets of one kind, or of several with different starts, are distinguished from other bytes."""

    names: Mapping[bytes, str]
    """What packets begin with, differing in one byte, and what the counters call those that begin so."""
    lengths: Lengths
    check: Check | None = None
    """See `Check`; None: every packet is believed."""
    tail: bytes = b""
    """What may or may not follow a packet, and belongs to it."""
    fits: Check | None = None
    """Tells of packets that came whole whether they can be of this kind by what is in them."""

    def candidates(self, held: ByteArray, final: bool) -> tuple[IntArray, IntArray, IntArray]:
        """Return where packets may begin, their lengths or why there are none, and their kinds, (n,) each.

        Also where only the first bytes are there.  A length is that with the tail.
        """
        starts, size = {name[0] for name in self.names}, len(next(iter(self.names)))
        at = np.flatnonzero(reduce(or_, [held == byte for byte in starts]))
        at, cut = np.split(at, [np.searchsorted(at, len(held) - size, "right")])
        begins, kind = integers(held, at, size), np.full(len(at), -1)
        for k, name in enumerate(self.names):
            kind[begins == int.from_bytes(name.ljust(8, b"\0"), "little", signed=True)] = k
        at, kind = at[kind >= 0], kind[kind >= 0]
        begun = [any(name.startswith(held[k:].tobytes()) for name in self.names) for k in cut.tolist()]
        cut = cut[np.array(begun, np.bool_)]
        verdict = np.append(self._verdicts(held, at, final), np.full_like(cut, INCOMPLETE))
        return np.append(at, cut), verdict, np.append(kind, np.zeros_like(cut))

    def _verdicts(self, held: ByteArray, at: IntArray, final: bool) -> IntArray:
        """Return the lengths of the packets at these places, with their tails, or why there are none."""
        verdict = self.lengths(held, at)
        verdict[(verdict > 0) & (at + verdict > len(held))] = INCOMPLETE
        whole = np.flatnonzero(verdict > 0)
        at, length = at[whole], verdict[whole]
        right = np.ones(len(at), np.bool_) if self.check is None else self.check(held, at, length)
        with_tail = self._with_tail(held, at, length, final) if self.tail else length
        verdict[whole] = np.where(right, with_tail, BAD_SUM)
        if self.fits is not None:
            fit = self.fits(held, at[right], length[right])
            verdict[whole[right][~fit]] = IMPOSSIBLE
        return verdict

    def _with_tail(self, held: ByteArray, at: IntArray, length: IntArray, final: bool) -> IntArray:
        """Return the lengths with that of the tail where it follows; `INCOMPLETE` where it may come yet."""
        agree = np.ones(len(at), np.bool_)
        for k, byte in enumerate(self.tail):
            place = at + length + k
            agree &= (place >= len(held)) | (held[np.minimum(place, len(held) - 1)] == byte)
        there = at + length + len(self.tail) <= len(held)
        cut = length if final else INCOMPLETE
        return np.where(agree, np.where(there, length + len(self.tail), cut), length)


@dataclass(frozen=True, eq=False)
class Found:
    """Packets among held bytes: where each begins, its length, and the number of its kind, (n,) each."""

    held: ByteArray
    at: IntArray
    length: IntArray
    kind: IntArray

    def __len__(self) -> int:
        return len(self.at)

    def only(self, rows: IntArray | BoolArray) -> "Found":
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
    # Taken as items of one type they are copied as wholes, twenty times faster than byte by byte.
    every = np.ndarray((len(held) - size + 1,), f"V{size}", held, strides=(1,))
    return every[at].view(np.uint8).reshape(-1, size)


def integers(held: ByteArray, at: IntArray, size: int, big: bool = False) -> IntArray:
    """Return the unsigned integers of `size` bytes that begin at these places."""
    value = np.zeros(len(at), np.int64)
    for n, k in enumerate(range(size)[:: -1 if big else 1]):
        value |= held[at + k].astype(np.int64) << 8 * n
    return value


def candidates(frames: Sequence[Frame], held: ByteArray, final: bool) -> Found:
    """Return what `Frame.candidates` has of all frames in order, one for each place.

    The first frame counts that finds a packet there; or that may still find one, when more bytes come.
    """
    tried, before = [], 0
    for frame in frames:
        at, verdict, kind = frame.candidates(held, final)
        tried.append((at, verdict, before + kind))
        before += len(frame.names)
    found = Found(held, *map(np.concatenate, zip(*tried, strict=True)))
    if len(frames) == 1:
        return found
    hopeless = (found.length <= 0) & (final | (found.length != INCOMPLETE))
    order = np.argsort(2 * found.at + hopeless, kind="stable")
    return found.only(order[np.diff(found.at[order], prepend=-1) > 0])


def search(frames: Sequence[Frame], held: ByteArray, final: bool, done: int) -> tuple[Found, Found, int, int]:
    """Return the candidates, the packets among them, where the rest begins, and how much of it is taken.

    A candidate that is not complete holds back what follows; at the end of the data (`final`) it is passed
    over, and stays pending when no packet follows.  The first `done` bytes are those of an earlier packet.
    """
    tried = candidates(frames, held, final)
    is_checked = [frame.check is not None for frame in frames for _ in frame.names]
    begins = np.zeros(len(held) + 1, np.bool_)
    begins[tried.at] = True
    of_interest = np.flatnonzero((tried.length > 0) | (tried.length == INCOMPLETE))
    at, verdict = tried.at[of_interest], tried.length[of_interest]
    # Most packets stand one directly behind the other: such a run is taken at once.
    joined = (verdict[:-1] > 0) & (verdict[1:] > 0) & (at[1:] == at[:-1] + verdict[:-1])
    stops = np.append(np.flatnonzero(~joined), len(at) - 1)
    run_end = stops[np.searchsorted(stops, np.arange(len(at)))] + 1
    runs: list[IntArray] = [of_interest[:0]]
    k, rest, may_overlap = 0, len(held), True
    while k < len(at):
        start, length = int(at[k]), int(verdict[k])
        if start < done and (0 < length <= done - start or begins[done] or not may_overlap):
            k += 1
        elif length > 0:
            stop = int(run_end[k])
            runs.append(of_interest[k:stop])
            done, rest, k = int(at[stop - 1] + verdict[stop - 1]), len(held), stop
            may_overlap = is_checked[tried.kind[of_interest[stop - 1]]]
        elif not final:
            rest = start
            break
        else:
            rest = min(rest, start) if start >= done else rest
            k += 1
    return tried, tried.only(np.concatenate(runs)), rest, max(done - rest, 0)


def fixed_length(size: int) -> Lengths:
    """Return the `Lengths` of packets that are all of one size."""
    return partial(_counted, 0, 0, size, size)


def counted_length(at: int, size: int, more: int, longest: int) -> Lengths:
    """Return the `Lengths` of packets that state how many bytes they have besides `more`, low byte first.

    `at`, `size`: place and bytes of the number.  `longest`: longest packet that is believed.
    """
    return partial(_counted, at, size, more, longest)


def _counted(at: int, size: int, more: int, longest: int, held: ByteArray, begin: IntArray) -> IntArray:
    result = np.full(len(begin), INCOMPLETE, np.int64)
    there = np.flatnonzero(begin + at + size <= len(held))
    counted = more + integers(held, begin[there] + at, size)
    result[there] = np.where(counted <= longest, counted, IMPOSSIBLE)
    return result


class Crc(NamedTuple):
    """A cyclic redundancy check in the terms of Greg Cook's catalogue."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
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
"""CRCs by the names of the catalogue, with a hyphen behind the width."""


def _total(data: ByteArray, weights: npt.ArrayLike = 1) -> IntArray:
    """Return the sum of each row times weights: exact in float64, and five times as fast."""
    real = data.astype(np.float64)
    return (real @ np.broadcast_to(weights, data.shape[1]).astype(np.float64)).astype(np.int64)


def _words(data: ByteArray, order: str) -> IntArray:
    even = np.pad(data, ((0, 0), (0, data.shape[1] % 2)))
    return _total(even.view(f"{order}u2"))


def _fletcher(data: ByteArray, modulus: int) -> IntArray:
    second = _total(data, np.arange(data.shape[1], 0, -1))
    return second % modulus << 8 | _total(data) % modulus


SIMPLE: dict[str, tuple[int, Callable[[ByteArray], IntArray]]] = {
    "sum8": (1, _total),
    "sum8-negated": (1, lambda data: -_total(data)),
    "xor8": (1, lambda data: np.bitwise_xor.reduce(data, axis=1).astype(np.int64)),
    "sum16": (2, _total),
    "sum16-words-le": (2, partial(_words, order="<")),
    "sum16-words-be": (2, partial(_words, order=">")),
    "fletcher16": (2, partial(_fletcher, modulus=255)),
    "fletcher16-256": (2, partial(_fletcher, modulus=256)),
}
"""Bytes of the others, and what takes rows of bytes, (n, size), to their checksums, (n,).

sum8-negated makes the sum of all bytes and the checksum zero.  sum16-words-* adds numbers of 16 bits, low
(le) or high byte (be) first; a last byte alone has zero for the other.  fletcher16 is modulo 255 (RFC 1145,
second sum in the high byte); fletcher16-256 is the variant modulo 256 that MIP and UBX use.
"""

CHECKSUM_NAMES = ("none", *SIMPLE, *CRCS)


@dataclass(frozen=True)
class Checksum:
    """A checksum of all bytes from `first` to before `end`, which stands at `at`.

    Without these two it covers all, and stands in the last bytes of a packet.  `zeros` more bytes, and those
    up to a multiple of `align`, which are not sent, count as if they followed the others (CRCs only).
    """

    name: str
    first: int = 0
    big: bool = False
    """Whether the most significant byte comes first."""
    zeros: int = 0
    end: int | None = None
    at: int | None = None
    align: int = 1

    @property
    def size(self) -> int:
        """Bytes of the checksum."""
        return CRCS[self.name].width // 8 if self.name in CRCS else SIMPLE[self.name][0]

    def values(self, held: ByteArray, first: IntArray, last: IntArray) -> IntArray:
        """Return the checksums of the bytes from each first to before each last place."""
        found, sizes = np.zeros(len(first), np.int64), last - first
        for size in np.flatnonzero(np.bincount(sizes)).tolist():
            which = np.flatnonzero(sizes == size)
            data = windows(held, first[which], size)
            if self.name in SIMPLE:
                found[which] = SIMPLE[self.name][1](data)
                continue
            # CRCs are linear: each byte adds what its value and its distance to the end give.
            zeros = self.zeros + -size % self.align
            longest = size + zeros
            table, empty = by_distance(CRCS[self.name], 1 << longest.bit_length())
            distance = np.arange(longest - 1, zeros - 1, -1)
            found[which] = np.bitwise_xor.reduce(table.take(data + 256 * distance), axis=1) ^ empty[longest]
        return found & (1 << 8 * self.size) - 1

    def __call__(self, held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
        """Tell which packets are right; see `Check`."""
        place = length - self.size if self.at is None else self.at
        computed = self.values(held, at + self.first, at + (place if self.end is None else self.end))
        return np.asarray(computed == integers(held, at + place, self.size, self.big))

    def sealed(self, body: bytes) -> bytes:
        """Return the packet: the body and its checksum."""
        return self.sealed_rows(np.frombuffer(body, np.uint8)[None]).tobytes()

    def sealed_rows(self, bodies: ByteArray) -> ByteArray:
        """Return packets of bodies of one size, (n, size), with their checksums behind them or in place."""
        n, size = bodies.shape
        begin = np.arange(n) * size
        sums = self.values(bodies.reshape(-1), begin + self.first, begin + (self.end or size))
        most_first = sums.astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - self.size :]
        stored = most_first if self.big else most_first[:, ::-1]
        at = size if self.at is None else self.at
        return np.concatenate([bodies[:, :at], stored, bodies[:, at + self.size :]], axis=1)


@lru_cache
def by_distance(crc: Crc, longest: int) -> tuple[IntArray, IntArray]:
    """Return what a byte adds to the CRC by its distance to the end and its value, and the CRC of zeros.

    Shapes: ((longest + 1) * 256,), distance first, and (longest + 1,).
    """
    top, mask = crc.width - 1, (1 << crc.width) - 1
    polynomial, initial = crc.polynomial, crc.initial
    if crc.reflected:
        polynomial, initial = (int(f"{n:0{crc.width}b}"[::-1], 2) for n in (polynomial, initial))
    step = np.arange(256) << (0 if crc.reflected else crc.width - 8)
    for _ in range(8):
        if crc.reflected:
            step = (step >> 1) ^ np.where(step & 1, polynomial, 0)
        else:
            step = ((step << 1) & mask) ^ np.where(step >> top & 1, polynomial, 0)

    rows = np.empty((longest + 1, 257), np.uint16 if crc.width == 16 else np.uint32)
    rows[0] = np.append(step, initial)
    for k in range(longest):  # the next row is for one more byte, which is zero
        register = rows[k]
        if crc.reflected:
            rows[k + 1] = (register >> 8) ^ step[register & 0xFF]
        else:
            rows[k + 1] = ((register << 8) & mask) ^ step[register >> crc.width - 8]
    return rows[:, :256].reshape(-1), rows[:, 256] ^ crc.final_xor
