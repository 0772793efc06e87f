"""From packets to epochs: fields of one time of validity are one row, other times are streams apart.

A device may send what it measured at one moment in several packets, and between them packets of a receiver
or a barometer that have times and rates of their own.  Here every field belongs to a group (the inertial
sensors, the magnetometer, a receiver, ...).  The inertial group makes the main stream.  Another group joins
its rows as long as its packets have the times of inertial packets, or no time at all; the first packet with
a time of its own makes the group a side stream, for good.  Receivers are side streams from the beginning:
their data are older than the packets between which they come.

An epoch is complete when a packet of its group comes with another time (or counter), or with a field that is
there already; and at once when it has every field that any of the last `GENERATION` epochs
had.  So a row waits for one epoch at the most.  Nothing is reordered and no field is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join, missing
from imumon.compiled import alone, inner, njit, record, records
from imumon.protocols.base import COMMON, Groups, Packets
from imumon.protocols.numbers import is_missing

GENERATION = 32
"""Epochs after which it is known what an epoch may have; a field that is rarer comes out a row later."""
NO_TIME, COUNTED, TIMED = range(3)


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """Epochs of one stream."""

    block: SampleBlock
    """One row each."""
    after: IntArray
    """How many rows of the main stream were complete when each began, (n,)."""
    until: IntArray
    """How many were complete when each ended, (n,)."""
    more: IntArray
    """Steps of the packet counter within the epoch, (n,): packets that came besides the first."""


@dataclass(slots=True)
class EpochCounters:
    """What became of the packets of a stream."""

    packets: int = 0
    incomplete: int = 0


RecordArray = npt.NDArray[np.void]

BITS = 62
"""Sets of columns of which each has a bit of its own in a word."""


class _Group:
    """What is carried for each group."""

    apart: int
    epoch: int  # number of the open epoch, 0: none
    key_kind: int
    key: int
    mask: int  # columns that it has
    after: int  # main rows complete when it began
    in_generation: int
    generations: int
    any_now: int  # columns that any epoch of this generation had
    any_before: int
    all_now: int
    all_before: int
    epochs: int
    incomplete: int


class _Ended:
    """An epoch that ended; `after` and `until` count main rows as `Epochs` does."""

    epoch: int
    group: int
    after: int
    until: int


class _Counts:
    """Number of the latest epoch; ended epochs so far."""

    latest: int
    ended: int


class _Arrived(NamedTuple):
    """Of each new packet the groups, what tells its epoch, and the columns that it has, (n,) each."""

    groups: IntArray
    kind: IntArray
    key: IntArray
    masks: IntArray


class _Books(NamedTuple):
    """What the assignment reads and writes."""

    groups: Sequence[_Group]
    epoch: IntArray
    """Epoch of each packet, kept and new, in each group; 0: none, (packets, groups)."""
    own: IntArray
    """The columns that it has there."""
    ended: Sequence[_Ended]
    counts: Sequence[_Counts]


class EpochAssembler:
    """Puts packets together to epochs, whatever the division into blocks."""

    def __init__(self, groups: Groups) -> None:
        self._groups = groups
        n = len(groups.names)
        self._state = records(_Group, n)
        _array(self._state)["apart"] = groups.apart
        self._counts = record(_Counts)
        self._bits: dict[tuple[int, ...], int] = {}
        self._packets = np.zeros(n, np.int64)
        self.counted_aside: list[tuple[int, int]] = []
        """Of the side packets that `process` saw last: the main rows begun before each, and its counter."""
        self._kept = SampleBlock({})
        """Packets of which some epoch is not complete, and of these epoch and own columns."""
        self._kept_epoch = self._kept_own = np.zeros((0, n), np.int64)
        self._columns: dict[str, set[str]] = {name: set() for name in groups.names}

    @property
    def counters(self) -> dict[str, EpochCounters]:
        """What became of the packets, by stream; streams without epochs are left out."""
        return {
            name: EpochCounters(int(self._packets[g]), int(group.incomplete))
            for g, (name, group) in enumerate(zip(self._groups.names, self._state, strict=True))
            if group.epochs
        }

    def columns(self, stream: str) -> frozenset[str]:
        """Return the names of the columns that a stream has so far."""
        return frozenset(self._columns.get(stream, {}))

    def process(self, packets: Packets, end: bool = False) -> dict[str, Epochs]:
        """Return the epochs that are complete, by stream; the main stream is always there.

        `packets`: those that follow the last ones.
        `end`: whether what is open is to come out: no packet follows, or the device may have restarted.
        """
        epoch, own, ended = self._assigned(packets, end)
        block = join([self._kept, packets.block])
        is_open = (epoch > 0) & (epoch == _array(self._state)["epoch"])
        found = {}
        for g, name in enumerate(self._groups.names):
            of_group = ended[ended["group"] == g]
            if g and not len(of_group):
                continue
            row = np.flatnonzero((epoch[:, g] > 0) & ~is_open[:, g])
            self._packets[g] += len(row)
            place = np.searchsorted(of_group["epoch"], epoch[row, g])
            gathered = self._gather(name, block, row, own[row, g], place, len(of_group))
            more = _steps_within(block, row, place, len(of_group))
            found[name] = Epochs(gathered, of_group["after"], of_group["until"], more)
        rows = np.flatnonzero(is_open.any(axis=1))
        self._kept = SampleBlock({name: values[rows] for name, values in block.columns.items()})
        self._kept_epoch, self._kept_own = np.where(is_open, epoch, 0)[rows], own[rows]
        return found

    def _assigned(self, packets: Packets, end: bool) -> tuple[IntArray, IntArray, RecordArray]:
        """Return epoch and own columns of kept and new packets in each group, and the epochs that ended."""
        masks, group_masks = self._masks(packets.block)
        new = _own_columns(packets.groups, masks, group_masks)
        epoch = np.concatenate([self._kept_epoch, np.zeros_like(new)])
        own = np.concatenate([self._kept_own, new])
        ended = records(_Ended, epoch.size + len(group_masks))
        behind = np.full(len(packets.block), -1, np.int64)
        self._counts.ended = 0
        arrived = _Arrived(packets.groups, *_keys(packets.block), masks)
        books = _Books(self._state, epoch, own, ended, alone(self._counts))
        _assign(arrived, group_masks, end, books, behind)
        counter = packets.block.columns.get("packet_counter", missing(len(packets.block), np.int64))
        aside = (behind >= 0) & (counter != NO_INT)
        self.counted_aside = list(zip(behind[aside].tolist(), counter[aside].tolist(), strict=True))
        return epoch, own, _array(ended)[: self._counts.ended]

    def _masks(self, block: SampleBlock) -> tuple[IntArray, IntArray]:
        """Return which columns each packet has, (n,), and which each group may have: a bit a column."""
        masks = np.zeros(len(block), np.int64)
        group_masks = np.zeros(len(self._groups.names), np.int64)
        for name, group in self._groups.of_column.items():
            if name in block:
                bit = self._bit(name)
                masks[~is_missing(block[name])] |= bit
                group_masks[group] |= bit
        return masks, group_masks

    def _bit(self, name: str) -> int:
        """Return the bit of a column: columns that always come together have one.

        Of more than `BITS` sets some share one: a row may begin too early, or a value may show twice.
        """
        return 1 << self._bits.setdefault(self._groups.layouts[name], len(self._bits)) % BITS

    def _gather(
        self, stream: str, block: SampleBlock, row: IntArray, own: IntArray, place: IntArray, n: int
    ) -> SampleBlock:
        """Return n rows of a stream: the packets `row` make the rows `place`; the first arrival counts."""
        known = self._columns[stream]
        columns: dict[str, ColumnArray] = {}
        for name, values in block.columns.items():
            taken = values[row]
            present = ~is_missing(taken)
            if name in self._groups.of_column:
                present &= own & self._bit(name) != 0
            if name not in known and name not in COMMON and not present.any():
                continue
            known.add(name)
            if len(row) == n and present.all():
                columns[name] = taken
                continue
            columns[name] = missing(n, values.dtype)
            order = slice(None, None, -1) if name == "arrival_time_ns" else slice(None)
            columns[name][place[present][order]] = taken[present][order]
        return SampleBlock(columns)


def _array(made: Sequence[Any]) -> RecordArray:
    """Return the records as NumPy sees them."""
    return cast(RecordArray, made)


def _own_columns(belongs: IntArray, masks: IntArray, group_masks: IntArray) -> IntArray:
    """Return the columns that packets have in each of their groups, (n, groups).

    Columns of other groups (another message has the same quantity) are in the first group of the packet.
    """
    there = (belongs[:, np.newaxis] >> np.arange(len(group_masks)) & 1).astype(np.bool_)
    own: IntArray = np.where(there, masks[:, np.newaxis] & group_masks, 0)
    stray = masks & ~np.bitwise_or.reduce(np.where(there, group_masks, 0), axis=1)
    own[np.arange(len(own)), there.argmax(axis=1)] |= stray
    return own


def _steps_within(block: SampleBlock, row: IntArray, place: IntArray, n: int) -> IntArray:
    """Return by how much the packet counter went on within each of n epochs, whose packets are these rows."""
    if len(row) == n or "packet_counter" not in block:
        return np.zeros(n, np.int64)
    counter = block["packet_counter"][row]
    there = counter != NO_INT
    counter, place = counter[there], place[there]
    first, last = np.zeros(n, np.int64), np.zeros(n, np.int64)
    first[place[::-1]], last[place] = counter[::-1], counter
    packets = np.bincount(place, minlength=n)
    # A counter that wrapped within the epoch went on by one a packet; the same one again is no step.
    return np.where(last < first, packets - 1, np.minimum(last - first, packets - 1)).clip(0)


def _keys(block: SampleBlock) -> tuple[IntArray, IntArray]:
    """Return kind and value of what tells epochs apart: the time of validity, else the counter."""
    kind, key = np.zeros(len(block), np.int64), np.zeros(len(block), np.int64)
    for number, name in ((COUNTED, "packet_counter"), (TIMED, "device_ticks")):
        if name in block:
            there = block[name] != NO_INT
            kind[there] = number
            key[there] = block[name][there]
    return kind, key


@njit
def _assign(arrived: _Arrived, group_masks: IntArray, end: bool, books: _Books, behind: IntArray) -> None:
    """Assign new packets to epochs (see the text of the module).

    `behind` is filled with how many main rows had begun before each packet of a side stream.
    """
    groups, main, held = books.groups, books.groups[0], len(books.epoch) - len(behind)
    for i in range(len(behind)):
        belongs, kind, key, mask = arrived.groups[i], arrived.kind[i], arrived.key[i], arrived.masks[i]
        row, together = held + i, mask
        for g in range(1, len(groups)):
            if belongs >> g & 1 and groups[g].apart:
                together &= ~books.own[row, g]
        joined = belongs & 1 != 0
        if joined:
            together |= mask & group_masks[0]
        elif together and main.epoch:
            joined = not _is_other(main, kind, key, together)
        if joined:
            books.own[row, 0] = together
            _add(0, row, kind, key, books)
        else:
            behind[i] = main.epochs + (main.epoch != 0)
        for g in range(1, len(groups)):
            if belongs >> g & 1 and (groups[g].apart or not joined):
                if groups[g].epoch and _is_other(groups[g], kind, key, books.own[row, g]):
                    groups[g].apart = 1
                _add(g, row, kind, key, books)
    if end:
        for g in range(len(groups)):
            if groups[g].epoch:
                _end(g, books)


@inner
def _is_other(group: _Group, kind: int, key: int, own: int) -> bool:
    """Test whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = kind != NO_TIME and (kind != group.key_kind or key != group.key)
    return bool(other_time or own & group.mask)


@inner
def _add(g: int, row: int, kind: int, key: int, books: _Books) -> None:
    """Add a packet to its group's epoch, which it may begin, or complete."""
    group, own = books.groups[g], books.own[row, g]
    if group.epoch and _is_other(group, kind, key, own):
        _end(g, books)
    if not group.epoch:
        books.counts[0].latest += 1
        group.epoch = books.counts[0].latest
        group.key_kind, group.key, group.mask = kind, key, 0
        group.after = books.groups[0].epochs
        if g == 0 and kind != NO_TIME:
            _pull(row, kind, key, books)
    books.epoch[row, g] = group.epoch
    group.mask |= own
    usual = group.any_now | group.any_before
    if group.generations and group.mask & usual == usual:
        _end(g, books)


@inner
def _pull(row: int, kind: int, key: int, books: _Books) -> None:
    """Take into the new main epoch what came before it with the same time, but no field a second time."""
    epoch, own, main = books.epoch, books.own, books.groups[0]
    for g in range(1, len(books.groups)):
        group = books.groups[g]
        if group.apart or not group.epoch or group.key_kind != kind or group.key != key:
            continue
        if group.mask & (own[row, 0] | main.mask):
            continue
        for k in range(row):
            if epoch[k, g] == group.epoch:
                own[k, 0] = own[k, g] | (own[k, 0] if epoch[k, 0] == main.epoch else 0)
                epoch[k, 0], epoch[k, g] = main.epoch, 0
        main.mask |= group.mask
        group.epoch = 0


@inner
def _end(g: int, books: _Books) -> None:
    """End the open epoch of a group, and learn what epochs have."""
    group, counts = books.groups[g], books.counts[0]
    ended = books.ended[counts.ended]
    ended.epoch, ended.group = group.epoch, g
    ended.after, ended.until = group.after, books.groups[0].epochs
    counts.ended += 1
    mask, always = group.mask, group.all_before
    group.epoch = 0
    group.epochs += 1
    group.incomplete += group.generations > 0 and mask & always != always
    group.any_now |= mask
    group.all_now = mask if group.in_generation == 0 else group.all_now & mask
    group.in_generation += 1
    if group.in_generation == GENERATION:
        group.any_before, group.all_before = group.any_now, group.all_now
        group.any_now = group.in_generation = 0
        group.generations += 1
