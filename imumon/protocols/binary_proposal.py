"""A device file proposed from binary packets of fixed length that no device file describes.

What repeats at a fixed distance is the sync pattern, and the distance is the length.  Every checksum of the
catalogue is tried at the end of the packet.  A counter and a clock are found by their differences; all other
bytes stay unknown, for somebody to fill in.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imumon.blocks import BoolArray, FloatArray, IntArray

from .base import ByteArray
from .framing import CHECKSUM_NAMES, Checksum, integers, windows
from .text_proposal import file_head

LEAST_PACKETS = 8  # packets from which a layout is proposed
SHORTEST, LONGEST = 6, 1024  # lengths of packets that are looked for, bytes
MOST_BYTES = 1 << 16
MOST_PAIRS = 64  # most frequent pairs of bytes that are tried as sync patterns; assumed
USUAL = 0.1  # share of the distances between sync patterns from which a distance is the length of a packet
CONSTANT = 0.9  # share of the packets in which a byte that is always the same must be so: some are damaged
COVERED = 0.5  # share of the bytes that must be in packets; a damaged sync pattern takes two out of the count
COVERED_UNCHECKED = 0.8  # the same where no checksum proves the packets
RIGHT = 0.3
LEAST_RIGHT = 5
"""Share and number of packets whose checksum must fit: 0.3 of 120 bytes with 1 % of bytes damaged."""
TRIED_PACKETS, TRIED_PATTERNS = 24, 8
FIRSTS = np.arange(9)  # places at which a checksum may begin: it often leaves out the sync pattern
UNITS = {"us": 1e-6, "ms": 1e-3}  # of a clock of 32 bits; in ns it would wrap after 4 s
LONGEST_SYNC = 4  # a constant byte behind these may be a status that changes one day
HIGH_BYTES = (0x00, 0xFF)
"""Such a byte behind a sync pattern is more often the high byte of a counter or of a small reading."""
COUNTS = 0.8  # share of the packets that must count on from the one before
EVEN = 0.2  # largest difference, relative to the median, of a step of a counter or clock; assumed
OFF_RATE = 0.4  # largest relative error of a clock's rate: packets are lost, and the rate is of a short time


class Proposal(NamedTuple):
    """A device file, and how well it is founded; the better of two is the greater."""

    checked: bool  # whether a checksum fits
    covered: float  # share of the bytes that are in packets
    text: str


def propose(data: bytes, seconds: float, baudrate: int | None) -> Proposal | None:
    """Return a device file for binary packets of one length; None when nothing repeats as they do.

    `data`: what came within `seconds`, at `baudrate` (bit/s); may begin and end anywhere.
    """
    held = np.frombuffer(data[:MOST_BYTES], np.uint8)
    seconds *= len(held) / max(len(data), 1)
    found = list[Proposal]()
    for anchors, length in _repeating(held):
        found += _proposed(held, anchors, length, seconds, baudrate)
        if found and found[-1].checked:
            break
    return max(found, key=lambda one: one[:2], default=None)


def _repeating(held: ByteArray) -> list[tuple[IntArray, int]]:
    """Return places of patterns of one or two bytes, and the usual distance between them, the best first."""
    pairs = held[:-1].astype(np.int64) << 8 | held[1:]
    often = np.argsort(np.bincount(pairs, minlength=1 << 16), kind="stable")[::-1][:MOST_PAIRS]
    places = [np.flatnonzero(pairs == pair) for pair in often]
    best: dict[int, tuple[float, IntArray]] = {}
    for at in (*places, *(np.flatnonzero(held == byte) for byte in range(256))):
        distances = np.diff(at)
        count = np.bincount(distances[distances <= LONGEST], minlength=SHORTEST + 1)
        lengths = np.flatnonzero(count[SHORTEST:] >= max(LEAST_PACKETS, USUAL * len(distances))) + SHORTEST
        if len(lengths) == 1:  # a pattern that is in a packet twice has two usual distances
            length = int(lengths[0])
            covered = float(count[length] * length) / len(held)
            if covered > best.get(length, (COVERED,))[0]:
                best[length] = covered, at
    tried = sorted(best, key=lambda length: -best[length][0])[:TRIED_PATTERNS]
    return [(best[length][1], length) for length in tried]


def _proposed(
    held: ByteArray, anchors: IntArray, length: int, seconds: float, baudrate: int | None
) -> Iterator[Proposal]:
    """Yield the device file for packets of a length that repeat a pattern at these places, if any."""
    at = anchors[:-1][np.diff(anchors) == length]
    shift, check = _beginning(held, at, length)
    at, packets = _whole(held, at + shift, length)
    covered = packets.size / len(held)
    constant = _constant(packets)
    begins_alike = check is not None or (constant[:2].all() and not constant.all())
    if begins_alike and covered >= (COVERED if check else COVERED_UNCHECKED):
        rate = len(at) / seconds if seconds > 0 else 0.0
        rate_text = f"{max(rate / covered, 0.01):.3g}  # in {seconds:.2g} s"
        text = [
            "# Proposed from what came; the reasons stand beside the lines.  Look at it before you trust it.",
            f"# {covered:.0%} of the bytes are in {len(at)} packets that begin alike, with another behind.",
            *file_head("binary packets", "fixed", baudrate, rate_text),
            "packet:", *(f"  {line}" for line in _layout(at, packets, check, rate)), "",
        ]  # fmt: skip
        yield Proposal(check is not None, covered, "\n".join(text))


def _whole(held: ByteArray, at: IntArray, length: int) -> tuple[IntArray, ByteArray]:
    """Return the places from which on there are so many bytes, and these, (n, length)."""
    at = at[(at >= 0) & (at + length <= len(held))]
    return at, windows(held, at, length)


def _constant(packets: ByteArray) -> BoolArray:
    """Return which bytes are the same in nearly all packets, (length,)."""
    return np.asarray(np.mean(packets == np.median(packets, axis=0), axis=0) >= CONSTANT)


def _run(constant: BoolArray) -> int:
    """Return how many bytes are constant from the first on."""
    return int(np.argmin(np.append(constant, False)))


def _beginning(held: ByteArray, anchors: IntArray, length: int) -> tuple[int, Checksum | None]:
    """Return where packets begin, from the pattern on, and their checksum, where one fits."""
    constant = _constant(_whole(held, anchors, length)[1])
    begins = np.flatnonzero(constant & ~np.roll(constant, 1))  # of runs of constant bytes
    # The high byte of a sum may be constant as well: then the packet begins behind it.
    places = np.append(begins, (begins + 1) % length)
    places = places[constant[places]]
    shifts = np.where(places > length // 2, places - length, places).tolist()
    fitting = list[tuple[float, int, int, Checksum]]()
    for shift in shifts:
        packets = np.unique(_whole(held, anchors + shift, length)[1], axis=0)
        packets = packets[np.linspace(0, len(packets) - 1, min(len(packets), TRIED_PACKETS)).astype(int)]
        fitting += [(right, check.size, shift, check) for right, check in _fitting(packets)]
    if fitting:
        return max(fitting, key=lambda found: found[:2])[2:]
    longest_run = max(shifts, key=lambda shift: _run(np.roll(constant, -shift)), default=0)
    return longest_run, None


def _fitting(packets: ByteArray) -> Iterator[tuple[float, Checksum]]:
    """Yield checksums that fit at the end of different packets, and in which share of them."""
    n, size = packets.shape
    held, begin = packets.reshape(-1), np.arange(n) * size
    for name in CHECKSUM_NAMES[1:]:
        check = Checksum(name)
        firsts = FIRSTS[: size - check.size - 1]
        first, last = (begin[:, None] + firsts).reshape(-1), begin + size - check.size
        values = check.values(held, first, last.repeat(len(firsts))).reshape(n, -1)
        for big in (False, True)[: check.size]:
            stored = integers(held, last, check.size, big)
            right = np.sum(values == stored[:, None], axis=0)
            k = int(np.argmax(right))
            if right[k] >= max(LEAST_RIGHT, RIGHT * n) and len(np.unique(stored)) >= LEAST_RIGHT:
                yield float(right[k]) / n, Checksum(name, int(firsts[k]), big)


def _layout(at: IntArray, packets: ByteArray, check: Checksum | None, rate: float) -> Iterator[str]:
    n, length = packets.shape
    constant = _constant(packets)
    usual = np.median(packets, axis=0).astype(int)
    sync = _run(constant[:LONGEST_SYNC])
    if check is not None and 2 <= check.first < sync:
        sync = check.first
    while sync > (1 if check else 2) and usual[sync - 1] in HIGH_BYTES:
        sync -= 1
    end = length - (0 if check is None else check.size)
    known = np.ones(length, np.bool_)
    known[sync:end] = False
    follows = np.diff(at) == length
    enough = np.sum(follows) >= LEAST_PACKETS // 2
    fields = [*_rising(packets[:-1][follows], packets[1:][follows], known, rate)] if enough else []
    yield f"length: {length}"
    yield f"byte_order: {'big' if any(order == 'big' for _, _, order in fields) else 'little'}"
    yield f"sync: [{', '.join(f'0x{byte:02X}' for byte in usual[:sync])}]"
    if check is None:
        yield "# No checksum that imumon knows fits at the end: where a packet begins is a guess, and at"
        yield "# another baud rate the bytes may repeat as well."
        yield "checksum: none"
    else:
        order = f", byte_order: {'big' if check.big else 'little'}" if check.size > 1 else ""
        right = np.count_nonzero(check(packets.reshape(-1), np.arange(n) * length, np.full(n, length)))
        keys = f"type: {check.name}, first: {check.first}, last: {end - 1}, at: {end}"
        yield f"checksum: {{{keys}{order}}}  # right in {right} of {n} packets"
    yield "fields:"
    for why, keys, _ in fields:
        yield f"  # {why}"
        yield f"  - {{{keys}}}"
    yield "  # unknown: give type, column or columns, scale and unit"
    for k in np.flatnonzero(~known).tolist():
        yield f"  - {{at: {k}, type: u8, column: byte_{k}}}"


def _rising(
    before: ByteArray, after: ByteArray, known: BoolArray, rate: float
) -> Iterator[tuple[str, str, str]]:
    """Yield the packet counter and the clock with reason, keys and byte order; mark their bytes as known.

    The counter rises by one a packet; the clock has 32 bits, and rises with time in a unit that fits `rate`.
    """
    for size, order in ((2, "big"), (2, "little"), (1, "little")):
        step, is_whole = _steps(before, after, known, size, order)
        places = np.flatnonzero(is_whole & (step == 1.0)).tolist()
        if places:
            k = places[0]
            known[k : k + size] = True
            yield "rises by one a packet", f"at: {k}, type: u{8 * size}, column: packet_counter", order
            break
    found = [
        (abs(step[k] * unit_s * rate - 1.0), unit, int(k), order, float(step[k]))
        for order in ("big", "little")
        for step, _ in [_steps(before, after, known, 4, order)]
        for k in np.flatnonzero(step > 1.0)
        for unit, unit_s in UNITS.items()
    ]
    off, unit, k, order, step_of_clock = min(found, default=(1.0, "", 0, "", 0.0))
    if off < OFF_RATE:
        known[k : k + 4] = True
        why = f"rises by {step_of_clock:.6g} a packet: at {rate:.4g} packets a second that is {unit}"
        yield why, f"at: {k}, type: u32, column: device_ticks, unit: {unit}", order


def _steps(
    before: ByteArray, after: ByteArray, known: BoolArray, size: int, order: str
) -> tuple[FloatArray, BoolArray]:
    """Return by how much the number of `size` bytes from each byte on rises a packet; whether it counts.

    NaN where it does not rise evenly, or a byte is known.  In counting, the low byte of a word carries, and a
    byte has all its bits: other counters stay unknown.
    """
    weights = 256 ** np.arange(size)[:: -1 if order == "big" else 1]
    first, second = (sliding_window_view(x, size, axis=1).astype(np.int64) @ weights for x in (before, after))
    step = (second - first) % 256**size
    middle = np.median(step, axis=0)
    even = np.mean(np.abs(step - middle) <= EVEN * middle, axis=0) >= COUNTS
    free = ~sliding_window_view(known, size).any(axis=1)
    at_end = second % 256 == 0 if size == 2 else second > 0x7F
    is_whole = np.any((step == 1) & at_end, axis=0)
    return np.where(even & free, middle, np.nan), is_whole
