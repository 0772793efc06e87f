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

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join
from imumon.compiled import njit
from imumon.protocols.base import COMMON, Groups, Packets

GENERATION = 32
"""Epochs after which it is known what an epoch may have; a field that is rarer comes out a row later."""
NO_TIME, COUNTED, TIMED = range(3)


@dataclass(frozen=True, slots=True, eq=False)
class Epochs:
    """Epochs of one stream.

    Parameters
    ----------
    block : SampleBlock
        One row each.
    after : array of int64, (n,)
        How many rows of the main stream were complete when each began.
    until : array of int64, (n,)
        How many were complete when each ended.
    more : array of int64, (n,)
        Steps of the packet counter within the epoch: packets that came besides the first.
    """

    block: SampleBlock
    after: IntArray
    until: IntArray
    more: IntArray


@dataclass(slots=True)
class EpochCounters:
    """What became of the packets of a stream."""

    packets: int = 0
    incomplete: int = 0


class _State(NamedTuple):
    """One entry per group; an epoch of 0 is none."""

    apart: IntArray
    epoch: IntArray
    key_kind: IntArray
    key: IntArray
    mask: IntArray
    in_generation: IntArray
    generations: IntArray
    any_now: IntArray
    any_before: IntArray
    all_now: IntArray
    all_before: IntArray
    epochs: IntArray
    incomplete: IntArray
    latest: IntArray
    after: IntArray


class _Entries(NamedTuple):
    """Which packet belongs to which epoch, with which columns; and the epochs that ended.

    `ended_after` and `ended_until` count main rows as `Epochs` does; `behind` is how many had begun before
    each packet of a side stream, -1 for main packets.
    """

    row: IntArray
    group: IntArray
    epoch: IntArray
    own: IntArray
    ended: IntArray
    ended_group: IntArray
    ended_after: IntArray
    ended_until: IntArray
    behind: IntArray
    counts: IntArray


class EpochAssembler:
    """Puts packets together to epochs, whatever the division into blocks.

    Parameters
    ----------
    groups : Groups
    """

    def __init__(self, groups: Groups) -> None:
        self._groups = groups
        n = len(groups.names)
        self._state = _State._make(np.zeros((len(_State._fields), n), np.int64))
        self._state.apart[:] = groups.apart
        self._bits: dict[str, int] = {}
        self._packets = np.zeros(n, np.int64)
        self.counted_aside: list[tuple[int, int]] = []
        """Of the side packets that `process` saw last: the main rows begun before each, and its counter."""
        self._pending: Packets | None = None
        self._kept = np.zeros((4, 0), np.int64)
        self._columns: dict[str, set[str]] = {name: set() for name in groups.names}

    @property
    def counters(self) -> dict[str, EpochCounters]:
        """What became of the packets, by stream; streams without epochs are left out."""
        state = self._state
        return {
            name: EpochCounters(int(self._packets[g]), int(state.incomplete[g]))
            for g, name in enumerate(self._groups.names)
            if state.epochs[g]
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
        masks, group_masks = self._masks(packets.block)
        entries = self._assign(packets, held, masks, group_masks, end)
        self.counted_aside = _counted(packets.block, entries.behind, held)
        n, m = entries.counts[:2].tolist()
        made = np.stack([entries.row[:n], entries.group[:n], entries.epoch[:n], entries.own[:n]])
        ended, ended_group = entries.ended[:m], entries.ended_group[:m]
        found = {}
        for g, name in enumerate(self._groups.names):
            of_group = ended_group == g
            if g and not of_group.any():
                continue
            row, _, epoch, own = made[:, (made[1] == g) & np.isin(made[2], ended[of_group])]
            self._packets[g] += len(row)
            place, count = np.searchsorted(ended[of_group], epoch), int(of_group.sum())
            block = self._gather(name, packets.block, (row, own, place), count)
            more = _steps_within(packets.block, row, place, count)
            after, until = entries.ended_after[:m][of_group], entries.ended_until[:m][of_group]
            found[name] = Epochs(block, after, until, more)
        self._keep(packets, made[:, ~np.isin(made[2], ended)])
        return found

    def _assign(
        self, packets: Packets, held: int, masks: IntArray, group_masks: IntArray, end: bool
    ) -> _Entries:
        n, kept = len(packets), self._kept.shape[1]
        most = (n - held) * len(self._groups.names) + kept
        room = np.zeros((4, most), np.int64)
        room[:, :kept] = self._kept
        ends = np.zeros((4, most + len(self._groups.names)), np.int64)
        behind = np.full(n, -1, np.int64)
        entries = _Entries(
            room[0],
            room[1],
            room[2],
            room[3],
            ends[0],
            ends[1],
            ends[2],
            ends[3],
            behind,
            np.zeros(2, np.int64),
        )
        entries.counts[0] = kept
        kind, key = _keys(packets.block)
        _assign(packets.groups, kind, key, masks, group_masks, held, end, self._state, entries)
        return entries

    def _masks(self, block: SampleBlock) -> tuple[IntArray, IntArray]:
        """Return which columns each packet has, (n,), and which each group may have: a bit a column."""
        masks = np.zeros(len(block), np.int64)
        group_masks = np.zeros(len(self._groups.names), np.int64)
        for name, group in self._groups.of_column.items():
            if name in block:
                bit = np.int64(1) << self._bit(name)
                masks |= np.where(_present(block[name]), bit, np.int64(0))
                group_masks[group] |= bit
        return masks, group_masks

    def _bit(self, name: str) -> np.int64:
        """Return the bit of a column.

        Some protocols have more columns than a word has bits; those beyond share one, which at worst begins a
        row too early, or shows a value in two streams.
        """
        return np.int64(self._bits.setdefault(name, len(self._bits)) % 62)

    def _gather(
        self, stream: str, block: SampleBlock, entries: tuple[IntArray, IntArray, IntArray], n: int
    ) -> SampleBlock:
        """Return n rows of a stream from entries: packet, its columns that belong here, and its row.

        Of several arrivals the first counts.
        """
        row, own, place = entries
        known = self._columns[stream]
        columns: dict[str, ColumnArray] = {}
        for name, values in block.columns.items():
            taken = values[row]
            present = _present(taken)
            if name in self._groups.of_column:
                present &= own >> self._bit(name) & 1 != 0
            if name not in known and name not in COMMON and not present.any():
                continue
            known.add(name)
            if len(row) == n and present.all():
                columns[name] = taken
                continue
            result = np.full(n, NO_INT if values.dtype == np.int64 else np.nan, values.dtype)
            order = slice(None, None, -1) if name == "arrival_time_ns" else slice(None)
            result[place[present][order]] = taken[present][order]
            columns[name] = result
        return SampleBlock(columns)

    def _keep(self, packets: Packets, made: IntArray) -> None:
        """Keep the packets of the entries whose epochs are not complete."""
        rows, again = np.unique(made[0], return_inverse=True)
        if not len(rows):
            self._pending, self._kept = None, np.zeros((4, 0), np.int64)
            return
        block = SampleBlock({name: values[rows] for name, values in packets.block.columns.items()})
        self._pending = Packets(block, packets.groups[rows])
        self._kept = np.concatenate([again.reshape(1, -1), made[1:]])


def _present(values: ColumnArray) -> npt.NDArray[np.bool_]:
    return np.asarray(values != NO_INT if values.dtype == np.int64 else ~np.isnan(values))


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
    groups: IntArray, kind: IntArray, key: IntArray, masks: IntArray, group_masks: IntArray,
    first: int, end: bool, state: _State, entries: _Entries,
) -> None:  # fmt: skip
    """Assign packets from row `first` on to epochs (see the text of the module)."""
    n_groups = len(group_masks)
    for i in range(first, len(groups)):
        joined, together = groups[i] & 1 != 0, masks[i]
        for g in range(1, n_groups):
            if state.apart[g]:
                together &= ~group_masks[g]
        if joined:
            _add(0, i, kind[i], key[i], together, state, entries)
        elif together and _joins(kind[i], key[i], together, state):
            _enter(0, i, together, state, entries)
            joined = True
        entries.behind[i] = -1 if joined else state.epochs[0] + (state.epoch[0] != 0)
        for g in range(1, n_groups):
            if not groups[i] >> g & 1 or (joined and not state.apart[g]):
                continue
            own = masks[i] & group_masks[g]
            if state.epoch[g] and _is_other(g, kind[i], key[i], own, state):
                state.apart[g] = 1
            _add(g, i, kind[i], key[i], own, state, entries)
    if end:
        for g in range(n_groups):
            if state.epoch[g]:
                _end(g, state, entries)


@njit
def _joins(kind: int, key: int, own: int, state: _State) -> bool:
    """Tell whether a packet without inertial fields belongs to the open epoch of the main stream."""
    return bool(state.epoch[0] and not _is_other(0, kind, key, own, state))


@njit
def _is_other(g: int, kind: int, key: int, own: int, state: _State) -> bool:
    """Tell whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = kind != NO_TIME and (kind != state.key_kind[g] or key != state.key[g])
    return bool(other_time or own & state.mask[g])


@njit
def _add(g: int, row: int, kind: int, key: int, own: int, state: _State, entries: _Entries) -> None:
    """Add a packet to its group's epoch, which it may begin."""
    if state.epoch[g] and _is_other(g, kind, key, own, state):
        _end(g, state, entries)
    if not state.epoch[g]:
        state.latest[0] += 1
        state.epoch[g] = state.latest[0]
        state.key_kind[g], state.key[g], state.mask[g] = kind, key, 0
        state.after[g] = state.epochs[0]
        if g == 0 and kind != NO_TIME:
            _pull(kind, key, state, entries)
    _enter(g, row, own, state, entries)


@njit
def _pull(kind: int, key: int, state: _State, entries: _Entries) -> None:
    """Take into the new main epoch what came before it with the same time."""
    for g in range(1, len(state.epoch)):
        if state.apart[g] or not state.epoch[g] or state.key_kind[g] != kind or state.key[g] != key:
            continue
        for k in range(entries.counts[0] - 1, -1, -1):
            if entries.epoch[k] == state.epoch[g]:
                entries.epoch[k], entries.group[k] = state.epoch[0], 0
        state.mask[0] |= state.mask[g]
        state.epoch[g] = 0


@njit
def _enter(g: int, row: int, own: int, state: _State, entries: _Entries) -> None:
    """Enter a packet into the open epoch, and end that when it has all that it may have."""
    k = entries.counts[0]
    entries.row[k], entries.group[k], entries.epoch[k], entries.own[k] = row, g, state.epoch[g], own
    entries.counts[0] = k + 1
    state.mask[g] |= own
    usual = state.any_now[g] | state.any_before[g]
    if state.generations[g] and state.mask[g] & usual == usual:
        _end(g, state, entries)


@njit
def _end(g: int, state: _State, entries: _Entries) -> None:
    """End the open epoch of a group, and learn what epochs have."""
    k = entries.counts[1]
    entries.ended[k], entries.ended_group[k] = state.epoch[g], g
    entries.ended_after[k], entries.ended_until[k] = state.after[g], state.epochs[0]
    entries.counts[1] = k + 1
    mask = state.mask[g]
    state.epoch[g] = 0
    state.epochs[g] += 1
    always = state.all_before[g]
    state.incomplete[g] += state.generations[g] > 0 and mask & always != always
    state.any_now[g] |= mask
    state.all_now[g] = mask if state.in_generation[g] == 0 else state.all_now[g] & mask
    state.in_generation[g] += 1
    if state.in_generation[g] == GENERATION:
        state.any_before[g], state.all_before[g] = state.any_now[g], state.all_now[g]
        state.any_now[g] = state.in_generation[g] = 0
        state.generations[g] += 1
