"""From packets to epochs: fields of one time of validity are one row, other times are streams apart.

A device may send what it measured at one moment in several packets, and between them packets of a receiver
or a barometer that have times and rates of their own.  Here every field belongs to a group (the inertial
sensors, the magnetometer, a receiver, ...).  The inertial group makes the main stream.  Another group joins
its rows as long as its packets have the times of inertial packets, or no time at all; the first packet with
a time of its own makes the group a side stream, for good.  Receivers are side streams from the beginning:
their data are older than the packets between which they come.

An epoch is complete when a packet of its group comes with another time (or counter), or with a field that is
there already; and at once when it has every field that any epoch of this generation of `GENERATION` epochs
or the one before had.  So a row waits for one epoch at the most.  Nothing is reordered and no field is lost.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join, missing
from imumon.compiled import inner, njit, records

from .base import COMMON, Groups, Packets
from .numbers import is_missing

GENERATION = 32
"""Epochs after which it is known what an epoch may have; a field that is rarer comes out a row later."""
NO_TIME, COUNTED, TIMED = range(3)
EPOCH, GROUP, AFTER, UNTIL = range(4)
"""Columns of the ended epochs: number, group, and main rows as `Epochs` counts them."""


class Epochs(NamedTuple):
    """Epochs of one stream."""

    block: SampleBlock
    """One row each."""
    after: IntArray
    """How many rows of the main stream were complete when each began, (n,)."""
    until: IntArray
    """How many were complete when each ended, (n,)."""
    more: IntArray
    """Steps of the packet counter within the epoch, (n,): packets that came besides the first."""


BITS = 62
"""Sets of columns of which each has a bit of its own in a word."""


class _Group:
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
    packets: int
    incomplete: int
    latest: int  # of the first group alone: number of the latest epoch of all groups
    ended: int  # and how many have ended in this call


class _Work(NamedTuple):
    """What the assignment reads of each new packet, (n,), and what it writes."""

    belongs: IntArray
    """Groups, a bit each."""
    kind: IntArray
    key: IntArray
    """What distinguishes epochs: nothing, the counter, or else the time of validity; and its value."""
    masks: IntArray
    """Columns, a bit for each set."""
    may: IntArray
    """Columns that each group may have."""
    groups: Sequence[_Group]
    epoch: IntArray
    """Epoch of each packet, kept and new, in each group; 0: none, (packets, groups)."""
    own: IntArray
    """The columns that it has there."""
    ended: IntArray
    """Of each epoch that ended: `EPOCH`, `GROUP`, `AFTER`, `UNTIL`, (packets * groups + groups, 4)."""
    behind: IntArray
    """Main rows that had begun before each packet of a side stream; -1 for others."""


class EpochAssembler:
    """Puts packets together to epochs, whatever the division into blocks."""

    def __init__(self, groups: Groups) -> None:
        self._groups = groups
        n = len(groups.names)
        self._state = records(_Group, n)
        for group, apart in zip(self._state, groups.apart, strict=True):
            group.apart = apart
        self._bits: dict[tuple[int, ...], int] = {}
        self.counted_aside: list[tuple[int, int]] = []
        """Of the side packets that `process` took last: the main rows begun before each, and its counter."""
        # Packets of which some epoch is not complete, and of these epoch and own columns.
        self._kept = SampleBlock({})
        self._kept_epoch = self._kept_own = np.zeros((0, n), np.int64)
        self._columns: dict[str, set[str]] = {name: set() for name in groups.names}

    @property
    def counters(self) -> dict[str, tuple[int, int]]:
        """Packets and incomplete epochs by stream; streams without epochs are left out."""
        return {
            name: (int(group.packets), int(group.incomplete))
            for name, group in zip(self._groups.names, self._state, strict=True)
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
        is_open = (epoch > 0) & (epoch == [group.epoch for group in self._state])
        found = {}
        for g, name in enumerate(self._groups.names):
            of_group = ended[ended[:, GROUP] == g]
            if g and not len(of_group):
                continue
            row = np.flatnonzero((epoch[:, g] > 0) & ~is_open[:, g])
            self._state[g].packets += len(row)
            place = np.searchsorted(of_group[:, EPOCH], epoch[row, g])
            gathered = self._gather(name, block, row, own[row, g], place, len(of_group))
            more = _steps_within(block, row, place, len(of_group))
            found[name] = Epochs(gathered, of_group[:, AFTER], of_group[:, UNTIL], more)
        rows = np.flatnonzero(is_open.any(axis=1))
        self._kept = block.kept(rows)
        self._kept_epoch, self._kept_own = np.where(is_open, epoch, 0)[rows], own[rows]
        return found

    def _assigned(self, packets: Packets, end: bool) -> tuple[IntArray, IntArray, IntArray]:
        """Return epoch and own columns of kept and new packets in each group, and the epochs that ended."""
        block, n = packets.block, len(packets.block)
        masks, may = np.zeros(n, np.int64), np.zeros(len(self._state), np.int64)
        for name, group in self._groups.of_column.items():
            if name in block:
                masks[~is_missing(block[name])] |= self._bit(name)
                may[group] |= self._bit(name)
        there = (packets.groups[:, None] >> np.arange(len(may)) & 1).astype(np.bool_)
        new: IntArray = np.where(there, masks[:, None] & may, 0)
        # Columns of other groups (another message has the same quantity) go into the packet's first group.
        stray = masks & ~np.bitwise_or.reduce(np.where(there, may, 0), axis=1)
        new[np.arange(n), there.argmax(axis=1)] |= stray
        none = missing(n, np.int64)
        counter, ticks = block.columns.get("packet_counter", none), block.columns.get("device_ticks", none)
        key = np.where(ticks != NO_INT, ticks, counter)
        kind = np.where(ticks != NO_INT, TIMED, np.where(counter != NO_INT, COUNTED, NO_TIME))
        epoch, own = np.vstack([self._kept_epoch, np.zeros_like(new)]), np.vstack([self._kept_own, new])
        ended, behind = np.zeros((epoch.size + len(may), 4), np.int64), np.full(n, -1, np.int64)
        self._state[0].ended = 0
        work = _Work(packets.groups, kind, key, masks, may, self._state, epoch, own, ended, behind)
        _assign(work, end)
        aside = (behind >= 0) & (counter != NO_INT)
        self.counted_aside = list(zip(behind[aside].tolist(), counter[aside].tolist(), strict=True))
        return epoch, own, ended[: self._state[0].ended]

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
            columns[name] = missing(n, values.dtype)
            order = slice(None, None, -1) if name == "arrival_time_ns" else slice(None)
            columns[name][place[present][order]] = taken[present][order]
        return SampleBlock(columns)


def _steps_within(block: SampleBlock, row: IntArray, place: IntArray, n: int) -> IntArray:
    """Return by how much the packet counter went on within each of n epochs, whose packets are these rows."""
    if len(row) == n or "packet_counter" not in block:
        return np.zeros(n, np.int64)
    counter = block["packet_counter"][row]
    there = counter != NO_INT
    counter, place = counter[there], place[there]
    first, last = np.zeros((2, n), np.int64)
    first[place[::-1]], last[place] = counter[::-1], counter
    packets = np.bincount(place, minlength=n)
    # A counter that wrapped within the epoch went on by one a packet; the same one again is no step.
    return np.where(last < first, packets - 1, np.minimum(last - first, packets - 1)).clip(0)


@njit
def _assign(work: _Work, end: bool) -> None:
    """Give each new packet to the open epochs of its groups; with `end` end these epochs.

    A packet joins the main row with the fields, `together`, of its groups that are not side streams.
    """
    groups, own, main, held = work.groups, work.own, work.groups[0], len(work.epoch) - len(work.behind)
    for i in range(len(work.behind)):
        belongs, kind, key, mask = work.belongs[i], work.kind[i], work.key[i], work.masks[i]
        row, together = held + i, mask
        for g in range(1, len(groups)):
            if belongs >> g & 1 and groups[g].apart:
                together &= ~own[row, g]
        joined = belongs & 1 != 0
        if joined:
            together |= mask & work.may[0]
        elif together and main.epoch:
            joined = not _is_other(main, kind, key, together)
        if joined:
            own[row, 0] = together
            _add(0, row, kind, key, work)
        else:
            work.behind[i] = main.epochs + (main.epoch != 0)
        for g in range(1, len(groups)):
            if belongs >> g & 1 and (groups[g].apart or not joined):
                if groups[g].epoch and _is_other(groups[g], kind, key, own[row, g]):
                    groups[g].apart = 1
                _add(g, row, kind, key, work)
    if end:
        for g in range(len(groups)):
            if groups[g].epoch:
                _end(g, work)


@inner
def _is_other(group: _Group, kind: int, key: int, own: int) -> bool:
    """Test whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = kind != NO_TIME and (kind != group.key_kind or key != group.key)
    return bool(other_time or own & group.mask)


@inner
def _add(g: int, row: int, kind: int, key: int, work: _Work) -> None:
    """Add a packet to its group's epoch, which it may begin, or complete."""
    group, own = work.groups[g], work.own[row, g]
    if group.epoch and _is_other(group, kind, key, own):
        _end(g, work)
    if not group.epoch:
        work.groups[0].latest += 1
        group.epoch = work.groups[0].latest
        group.key_kind, group.key, group.mask = kind, key, 0
        group.after = work.groups[0].epochs
        if g == 0 and kind != NO_TIME:
            _pull(row, kind, key, work)
    work.epoch[row, g] = group.epoch
    group.mask |= own
    usual = group.any_now | group.any_before
    if group.generations and group.mask & usual == usual:
        _end(g, work)


@inner
def _pull(row: int, kind: int, key: int, work: _Work) -> None:
    """Take into the new main epoch what came before it with the same time, but no field a second time."""
    epoch, own, main = work.epoch, work.own, work.groups[0]
    for g in range(1, len(work.groups)):
        group = work.groups[g]
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
def _end(g: int, work: _Work) -> None:
    """End the open epoch of a group, and learn what epochs have."""
    group, main = work.groups[g], work.groups[0]
    ended = work.ended[main.ended]
    ended[EPOCH], ended[GROUP], ended[AFTER], ended[UNTIL] = group.epoch, g, group.after, main.epochs
    main.ended += 1
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
