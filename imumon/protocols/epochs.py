"""From packets to epochs: fields of one time of validity are one row, other times are streams apart.

A device may send what it measured at one moment in several packets, and between them packets of a receiver
or a barometer that have times and rates of their own.  Here every field belongs to a group (the inertial
sensors, the magnetometer, a receiver, ...).  The inertial group makes the main stream.  A packet of another
group joins the open main row, unless it has another time, or a field that is there already.  Else it waits in
an epoch of its group, which the next main row takes if it has the same time.  A packet that fits neither the
main row nor the waiting epoch makes its group a side stream, for good.  Receivers are side streams from the
beginning: their data are older than the packets between which they come.

An epoch is complete when a packet of its group comes with another time (or counter), or with a field that is
there already; and at once when it has every field that any epoch had in this generation, of `GENERATION`
epochs, and the one before.  So a row waits for one epoch at the most.  Nothing is reordered, no field lost.
An epoch is incomplete when it lacks a field that every epoch of the generation before had.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join, missing
from imumon.compiled import inner, njit, records

from .base import COMMON, Groups, Packets
from .numbers import is_missing

GENERATION = 32
"""Epochs after which it is known what one may have; with a rarer field a row comes out later.  Assumed."""
NO_TIME, COUNTED, TIMED = range(3)  # what distinguishes epochs: nothing, the counter, the time of validity
EPOCH, AFTER, UNTIL = range(3)  # columns of the ended epochs: number, and main rows as `Epochs` counts them
BITS = 62  # sets of columns in a word of 64 bits, whose sign stays free; assumed


class Epochs(NamedTuple):
    """Epochs of one stream."""

    block: SampleBlock
    """One row each."""
    after: IntArray
    """How many rows of the main stream were complete when each began, (n,)."""
    until: IntArray
    """How many were complete when each ended, (n,)."""
    more: IntArray
    """Steps of the packet counter within each, (n,): one for each packet of the device besides the first."""


class _Group:  # State of a group; columns are bits, as in `_Work.masks`.
    apart: int  # whether it is a side stream
    epoch: int  # number of the open epoch, 0: none
    key_kind: int  # of the open epoch, as in `_Work`
    key: int  # the same
    mask: int  # columns that it has
    after: int  # main rows complete when it began
    in_generation: int  # epochs of this generation
    generations: int  # whole ones before it
    any_now: int  # columns that any epoch of this generation had
    any_before: int  # columns that any of the generation before had
    all_now: int  # columns that every epoch of this generation had
    all_before: int  # columns that every one of the generation before had
    epochs: int  # that have ended
    packets: int
    incomplete: int  # epochs that lacked one of `all_before`
    ended: int  # epochs that have ended in this call


class _Work(NamedTuple):
    """What the assignment reads of each new packet, (n,), and what it writes."""

    group_bits: IntArray  # groups, a bit each
    key_kind: IntArray  # `NO_TIME`, `COUNTED` or `TIMED`
    key: IntArray  # counter or time of validity: with another kind or key an epoch is another
    masks: IntArray  # columns, a bit for each set that always comes together
    may: IntArray  # columns that each group may have, (groups,)
    groups: Sequence[_Group]
    epoch: IntArray  # of each packet, kept and new, in each group; 0: none, (packets, groups)
    own: IntArray  # the columns that it has there
    ended: IntArray  # `EPOCH`, `AFTER`, `UNTIL` of the `_Group.ended` of each group, (groups, packets + 1, 3)
    behind: IntArray  # main rows that had begun before each packet of a side stream; -1 for others


class EpochAssembler:
    """Puts packets together to epochs; how they are divided into blocks makes no difference."""

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
        for g, (name, group) in enumerate(zip(self._groups.names, self._state, strict=True)):
            of_group = ended[g, : group.ended]  # in the order of their numbers
            if g and not len(of_group):
                continue
            packet = np.flatnonzero((epoch[:, g] > 0) & ~is_open[:, g])
            group.packets += len(packet)
            row = np.searchsorted(of_group[:, EPOCH], epoch[packet, g])
            gathered = self._gather(name, block, packet, own[packet, g], row, len(of_group))
            more = _steps_within(block, packet, row, len(of_group))
            found[name] = Epochs(gathered, of_group[:, AFTER], of_group[:, UNTIL], more)
        kept = np.flatnonzero(is_open.any(axis=1))
        self._kept = block.kept(kept)
        self._kept_epoch, self._kept_own = np.where(is_open, epoch, 0)[kept], own[kept]
        return found

    def _assigned(self, packets: Packets, end: bool) -> tuple[IntArray, IntArray, IntArray]:
        """Return epoch and own columns of kept and new packets in each group, and the epochs that ended."""
        block, n = packets.block, len(packets.block)
        # Bits of the columns that each packet has, and that each group may have.
        masks, may = np.zeros(n, np.int64), np.zeros(len(self._state), np.int64)
        for name, group in self._groups.number_of.items():
            if name in block:
                masks[~is_missing(block[name])] |= self._bit(name)
                may[group] |= self._bit(name)
        belongs = ((packets.groups[:, None] >> np.arange(len(may))) & 1).astype(np.bool_)
        new: IntArray = np.where(belongs, masks[:, None] & may, 0)
        # Columns of other groups (another message has the same quantity) go into the packet's first group.
        stray = masks & ~np.bitwise_or.reduce(np.where(belongs, may, 0), axis=1)
        new[np.arange(n), belongs.argmax(axis=1)] |= stray
        none = missing(n, np.int64)
        counter, ticks = block.columns.get("packet_counter", none), block.columns.get("device_ticks", none)
        key = np.where(ticks != NO_INT, ticks, counter)
        key_kind = np.where(ticks != NO_INT, TIMED, np.where(counter != NO_INT, COUNTED, NO_TIME))
        epoch, own = np.vstack([self._kept_epoch, np.zeros_like(new)]), np.vstack([self._kept_own, new])
        ended = np.zeros((len(may), len(epoch) + 1, 3), np.int64)
        behind = np.full(n, -1, np.int64)
        _assign(_Work(packets.groups, key_kind, key, masks, may, self._state, epoch, own, ended, behind), end)
        aside = (behind >= 0) & (counter != NO_INT)
        self.counted_aside = list(zip(behind[aside].tolist(), counter[aside].tolist(), strict=True))
        return epoch, own, ended

    def _bit(self, name: str) -> int:
        """Return the bit of a column: columns that always come together have one.

        Of more than `BITS` sets some share one: a row may begin too early, or a value may show twice.
        """
        return 1 << (self._bits.setdefault(self._groups.layouts[name], len(self._bits)) % BITS)

    def _gather(
        self, stream: str, block: SampleBlock, packet: IntArray, own: IntArray, row: IntArray, n: int
    ) -> SampleBlock:
        """Return n rows of a stream, to which these packets go with their own columns."""
        known = self._columns[stream]
        columns: dict[str, ColumnArray] = {}
        for name, values in block.columns.items():
            taken = values[packet]
            present = ~is_missing(taken)
            if name in self._groups.number_of:
                present &= (own & self._bit(name)) != 0
            if name not in known and name not in COMMON and not present.any():
                continue
            known.add(name)
            columns[name] = missing(n, values.dtype)
            # Assigned in order: of several values the last stays, but of times of arrival the first.
            order = slice(None, None, -1) if name == "arrival_time_ns" else slice(None)
            columns[name][row[present][order]] = taken[present][order]
        return SampleBlock(columns)


def _steps_within(block: SampleBlock, packet: IntArray, row: IntArray, n: int) -> IntArray:
    """Return by how much the packet counter went on within each of n rows that these packets make."""
    if len(packet) == n or "packet_counter" not in block:
        return np.zeros(n, np.int64)
    counter = block["packet_counter"][packet]
    there = counter != NO_INT
    counter, row = counter[there], row[there]
    first, last = np.zeros((2, n), np.int64)
    first[row[::-1]], last[row] = counter[::-1], counter  # assigned in order: the last of a row stays
    others = np.bincount(row, minlength=n) - 1  # packets besides the first; -1 in a row without a counter
    # A counter that wrapped within the row went on by one a packet; the same one again is no step.
    return np.where(last < first, others, np.minimum(last - first, others)).clip(0)


@njit
def _assign(work: _Work, end: bool) -> None:
    """Give each new packet to the open epochs of its groups; with `end` end these epochs.

    Say the inertial packets have the times 10 and 20 ms, and behind them those of the magnetometer 10 and 21,
    of a receiver 5 and 15.  The first magnetic field joins the main row of 10 ms.  The second is not of the
    open row, 20 ms: it begins an epoch of its own.  The receiver's group is apart from the beginning.
    """
    groups, own, main = work.groups, work.own, work.groups[0]
    kept = len(work.epoch) - len(work.behind)
    for g in range(len(groups)):
        groups[g].ended = 0
    for i in range(len(work.behind)):
        row = kept + i
        bits, key_kind, key, mask = work.group_bits[i], work.key_kind[i], work.key[i], work.masks[i]
        # For the main row are the columns that groups that are apart leave, and those of the main group.
        for_main = mask
        for g in range(1, len(groups)):
            if (bits >> g) & 1 and groups[g].apart:
                for_main &= ~own[row, g]
        joins = (bits & 1) != 0
        if joins:
            for_main |= mask & work.may[0]
        elif for_main and main.epoch:
            joins = not _is_other(main, key_kind, key, for_main)
        if joins:
            own[row, 0] = for_main
            _add(0, row, key_kind, key, work)
        else:
            work.behind[i] = main.epochs + (main.epoch != 0)  # with the open one
        for g in range(1, len(groups)):
            if (bits >> g) & 1 and (groups[g].apart or not joins):
                # It fits neither the main row nor the epoch of its group that waits for one.
                if groups[g].epoch and _is_other(groups[g], key_kind, key, own[row, g]):
                    groups[g].apart = 1
                _add(g, row, key_kind, key, work)
    if end:
        for g in range(len(groups)):
            if groups[g].epoch:
                _end(g, work)


@inner
def _is_other(group: _Group, key_kind: int, key: int, own: int) -> bool:
    """Test whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = key_kind != NO_TIME and (key_kind != group.key_kind or key != group.key)
    return bool(other_time or own & group.mask)


@inner
def _add(g: int, row: int, key_kind: int, key: int, work: _Work) -> None:
    """Add a packet to its group's epoch, which it may begin, or complete."""
    group, main, own = work.groups[g], work.groups[0], work.own[row, g]
    if group.epoch and _is_other(group, key_kind, key, own):
        _end(g, work)
    if not group.epoch:
        group.epoch = group.epochs + 1
        group.key_kind, group.key, group.mask = key_kind, key, 0
        group.after = main.epochs
        if g == 0 and key_kind != NO_TIME:
            _pull(row, key_kind, key, work)
    work.epoch[row, g] = group.epoch
    group.mask |= own
    usual = group.any_now | group.any_before
    if group.generations and group.mask & usual == usual:
        _end(g, work)


@inner
def _pull(row: int, key_kind: int, key: int, work: _Work) -> None:
    """Take into the new main epoch what came before it with the same time, but no field a second time."""
    epoch, own, main = work.epoch, work.own, work.groups[0]
    for g in range(1, len(work.groups)):
        group = work.groups[g]
        if group.apart or not group.epoch or group.key_kind != key_kind or group.key != key:
            continue
        # Fields that the new row has already, or that packets of this epoch gave to an earlier main row.
        first, clash = row, group.mask & (own[row, 0] | main.mask)
        for k in range(row):
            if epoch[k, g] == group.epoch:
                first = min(first, k)
                if epoch[k, 0] != main.epoch:
                    clash |= own[k, 0]
        if clash:
            continue
        for k in range(first, row):
            if epoch[k, g] == group.epoch:
                own[k, 0] |= own[k, g]
                epoch[k, 0], epoch[k, g] = main.epoch, 0
        main.mask |= group.mask
        group.epoch = 0


@inner
def _end(g: int, work: _Work) -> None:
    """End the open epoch of a group, and learn what epochs have."""
    group, main, mask = work.groups[g], work.groups[0], work.groups[g].mask
    ended = work.ended[g, group.ended]
    ended[EPOCH], ended[AFTER], ended[UNTIL] = group.epoch, group.after, main.epochs
    group.ended += 1
    group.epoch = 0
    group.epochs += 1
    if group.generations and group.all_before & ~mask:
        group.incomplete += 1
    group.any_now |= mask
    group.all_now = mask if group.in_generation == 0 else group.all_now & mask
    group.in_generation += 1
    if group.in_generation == GENERATION:
        group.any_before, group.all_before = group.any_now, group.all_now
        group.any_now = group.in_generation = 0
        group.generations += 1
