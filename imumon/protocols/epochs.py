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


class _Entry:
    """A packet belongs to an epoch, with these of its columns."""

    row: int
    group: int
    epoch: int
    own: int


class _Ended:
    """An epoch that ended; `after` and `until` count main rows as `Epochs` does."""

    epoch: int
    group: int
    after: int
    until: int


class _Counts:
    """Number of the latest epoch; entries and ended epochs so far."""

    latest: int
    entries: int
    ended: int


class _Arrived(NamedTuple):
    """Of each packet the groups, what tells its epoch, and the columns that it has."""

    groups: IntArray
    kind: IntArray
    key: IntArray
    masks: IntArray


class _Books(NamedTuple):
    """What the assignment reads and writes."""

    groups: Sequence[_Group]
    entries: Sequence[_Entry]
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
        self._pending: Packets | None = None
        self._kept = _array(records(_Entry, 0))
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

        Parameters
        ----------
        packets : Packets
            Those that follow the last ones.
        end : bool
            Whether what is open is to come out as it is: no packet follows, or the device may have restarted.
        """
        held = 0 if self._pending is None else len(self._pending)
        if self._pending is not None:
            packets = Packets(
                join([self._pending.block, packets.block]),
                np.concatenate([self._pending.groups, packets.groups]),
            )
        entries, ended, behind = self._assigned(packets, held, end)
        self.counted_aside = _counted(packets.block, behind, held)
        is_open = entries["epoch"] == _array(self._state)["epoch"][entries["group"]]
        complete = entries[~is_open]
        found = {}
        for g, name in enumerate(self._groups.names):
            own = ended[ended["group"] == g]
            if g and not len(own):
                continue
            made = complete[complete["group"] == g]
            self._packets[g] += len(made)
            place = np.searchsorted(own["epoch"], made["epoch"])
            block = self._gather(name, packets.block, made, place, len(own))
            more = _steps_within(packets.block, made["row"], place, len(own))
            found[name] = Epochs(block, own["after"], own["until"], more)
        self._keep(packets, entries[is_open])
        return found

    def _assigned(self, packets: Packets, held: int, end: bool) -> tuple[RecordArray, RecordArray, IntArray]:
        """Return the entries, the epochs that ended, and the main rows begun before each side packet."""
        n, kept, n_groups = len(packets), len(self._kept), len(self._groups.names)
        masks, group_masks = self._masks(packets.block)
        most = (n - held) * n_groups + kept
        entries, ended = records(_Entry, most), records(_Ended, most + n_groups)
        _array(entries)[:kept] = self._kept
        behind = np.full(n, -1, np.int64)
        self._counts.entries, self._counts.ended = kept, 0
        arrived = _Arrived(packets.groups, *_keys(packets.block), masks)
        books = _Books(self._state, entries, ended, alone(self._counts))
        _assign(arrived, group_masks, held, end, books, behind)
        return _array(entries)[: self._counts.entries], _array(ended)[: self._counts.ended], behind

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
        self, stream: str, block: SampleBlock, entries: RecordArray, place: IntArray, n: int
    ) -> SampleBlock:
        """Return n rows of a stream, `place` being those of the entries; the first arrival counts."""
        row, known = entries["row"], self._columns[stream]
        columns: dict[str, ColumnArray] = {}
        for name, values in block.columns.items():
            taken = values[row]
            present = ~is_missing(taken)
            if name in self._groups.of_column:
                present &= entries["own"] & self._bit(name) != 0
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

    def _keep(self, packets: Packets, entries: RecordArray) -> None:
        """Keep the packets of the entries whose epochs are not complete."""
        rows, again = np.unique(entries["row"], return_inverse=True)
        self._kept = entries.copy()
        self._kept["row"] = again.reshape(-1)
        if not len(rows):
            self._pending = None
            return
        block = SampleBlock({name: values[rows] for name, values in packets.block.columns.items()})
        self._pending = Packets(block, packets.groups[rows])


def _array(made: Sequence[Any]) -> RecordArray:
    """Return the records as NumPy sees them."""
    return cast(RecordArray, made)


def _counted(block: SampleBlock, behind: IntArray, held: int) -> list[tuple[int, int]]:
    """Return (main rows begun before, counter) of the side packets from row `held` on that have a counter."""
    if "packet_counter" not in block:
        return []
    counter = block["packet_counter"]
    aside = np.flatnonzero((behind >= 0) & (counter != NO_INT))
    aside = aside[aside >= held]
    return list(zip(behind[aside].tolist(), counter[aside].tolist(), strict=True))


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
def _assign(
    arrived: _Arrived, group_masks: IntArray, first: int, end: bool, books: _Books, behind: IntArray
) -> None:
    """Assign packets from row `first` on to epochs (see the text of the module).

    `behind` is filled with how many main rows had begun before each packet of a side stream.
    """
    groups, main = books.groups, books.groups[0]
    for i in range(first, len(arrived.groups)):
        belongs, kind, key, mask = arrived.groups[i], arrived.kind[i], arrived.key[i], arrived.masks[i]
        joined, aside, stray = belongs & 1 != 0, np.int64(0), _stray(belongs, mask, group_masks)
        for g in range(1, len(groups)):
            if belongs >> g & 1 and groups[g].apart:
                aside |= _own(g, belongs, mask, stray, group_masks)
        together = mask & ~aside
        if joined:
            together |= mask & group_masks[0]
            _add(0, i, kind, key, together, books)
        elif together and main.epoch and not _is_other(main, kind, key, together):
            _enter(0, i, together, books)
            joined = True
        if not joined:
            behind[i] = main.epochs + (main.epoch != 0)
        for g in range(1, len(groups)):
            if belongs >> g == 0:
                break
            if not belongs >> g & 1 or (joined and not groups[g].apart):
                continue
            own = _own(g, belongs, mask, stray, group_masks)
            if groups[g].epoch and _is_other(groups[g], kind, key, own):
                groups[g].apart = 1
            _add(g, i, kind, key, own, books)
    if end:
        for g in range(len(groups)):
            if groups[g].epoch:
                _end(g, books)


@inner
def _stray(belongs: int, mask: int, group_masks: IntArray) -> int:
    """Return the columns of a packet whose own group it is not of: another message has the same quantity."""
    for g in range(len(group_masks)):
        if belongs >> g & 1:
            mask &= ~group_masks[g]
    return mask


@inner
def _own(g: int, belongs: int, mask: int, stray: int, group_masks: IntArray) -> int:
    """Return the columns that a packet has in one of its groups; stray ones are in the first of these."""
    first = belongs & -belongs == 1 << g
    return int(mask & group_masks[g] | (stray if first else 0))


@inner
def _is_other(group: _Group, kind: int, key: int, own: int) -> bool:
    """Test whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = kind != NO_TIME and (kind != group.key_kind or key != group.key)
    return bool(other_time or own & group.mask)


@inner
def _add(g: int, row: int, kind: int, key: int, own: int, books: _Books) -> None:
    """Add a packet to its group's epoch, which it may begin."""
    group = books.groups[g]
    if group.epoch and _is_other(group, kind, key, own):
        _end(g, books)
    if not group.epoch:
        books.counts[0].latest += 1
        group.epoch = books.counts[0].latest
        group.key_kind, group.key, group.mask = kind, key, 0
        group.after = books.groups[0].epochs
        if g == 0 and kind != NO_TIME:
            _pull(kind, key, own, books)
    _enter(g, row, own, books)


@inner
def _pull(kind: int, key: int, own: int, books: _Books) -> None:
    """Take into the new main epoch what came before it with the same time, but no field a second time."""
    entries, main = books.entries, books.groups[0]
    for g in range(1, len(books.groups)):
        group = books.groups[g]
        if group.apart or not group.epoch or group.key_kind != kind or group.key != key:
            continue
        if group.mask & (own | main.mask):
            continue
        for k in range(books.counts[0].entries - 1, -1, -1):
            if entries[k].epoch == group.epoch:
                entries[k].epoch, entries[k].group = main.epoch, 0
        main.mask |= group.mask
        group.epoch = 0


@inner
def _enter(g: int, row: int, own: int, books: _Books) -> None:
    """Enter a packet into the open epoch, and end that when it has all that it may have."""
    group, counts = books.groups[g], books.counts[0]
    entry = books.entries[counts.entries]
    entry.row, entry.group, entry.epoch, entry.own = row, g, group.epoch, own
    counts.entries += 1
    group.mask |= own
    usual = group.any_now | group.any_before
    if group.generations and group.mask & usual == usual:
        _end(g, books)


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
