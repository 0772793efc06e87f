"""From packets to epochs: fields of one time of validity are one row, other times are streams apart.

A device may send what it measured at one moment in several packets, and between them packets of a receiver
or a barometer that have times and rates of their own.  Here every field belongs to a group (the inertial
sensors, the magnetometer, a receiver, ...).  The inertial group makes the main stream.  Another group joins
its rows as long as its packets have the times of inertial packets, or no time at all; the first packet with
a time of its own makes the group a side stream, for good.  Receivers are side streams from the beginning:
their data are older than the packets between which they come.

An epoch is complete when a packet of its group comes with another time (or counter), or, without either, with
a field that is there already; and at once when it has every field that any of the last `GENERATION` epochs
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
    behind : array of int64, (n,)
        How many had begun.
    more : array of int64, (n,)
        Steps of the packet counter within the epoch: packets that came besides the first.
    """

    block: SampleBlock
    after: IntArray
    behind: IntArray
    more: IntArray


@dataclass(slots=True)
class EpochCounters:
    """What became of the packets of a stream."""

    epochs: int = 0
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
    behind: IntArray


class _Entries(NamedTuple):
    """Which packet belongs to which epoch; and the epochs that ended, with the main rows before them."""

    row: IntArray
    group: IntArray
    epoch: IntArray
    ended: IntArray
    ended_group: IntArray
    ended_after: IntArray
    ended_behind: IntArray
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
        self._pending: Packets | None = None
        self._kept = np.zeros((3, 0), np.int64)
        self._columns: dict[str, set[str]] = {name: set() for name in groups.names}

    @property
    def counters(self) -> dict[str, EpochCounters]:
        """What became of the packets, by stream; streams without epochs are left out."""
        state = self._state
        return {
            name: EpochCounters(int(state.epochs[g]), int(state.incomplete[g]))
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
        n, m = entries.counts[:2].tolist()
        row, group, epoch = entries.row[:n], entries.group[:n], entries.epoch[:n]
        ended, ended_group = entries.ended[:m], entries.ended_group[:m]
        found = {}
        for g, name in enumerate(self._groups.names):
            own = ended_group == g
            if g and not own.any():
                continue
            whole = (group == g) & np.isin(epoch, ended[own])
            place = np.searchsorted(ended[own], epoch[whole])
            block = self._gather(name, g, packets.block, row[whole], place, int(own.sum()))
            more = _steps_within(packets.block, row[whole], place, int(own.sum()))
            found[name] = Epochs(block, entries.ended_after[:m][own], entries.ended_behind[:m][own], more)
        self._keep(packets, row, group, epoch, np.isin(epoch, ended))
        return found

    def _assign(
        self, packets: Packets, held: int, masks: IntArray, group_masks: IntArray, end: bool
    ) -> _Entries:
        n, kept = len(packets), self._kept.shape[1]
        most = (n - held) * len(self._groups.names) + kept
        room = np.zeros((3, most), np.int64)
        room[:, :kept] = self._kept
        ends = np.zeros((4, most + len(self._groups.names)), np.int64)
        entries = _Entries._make([*room, *ends, np.zeros(2, np.int64)])
        entries.counts[0] = kept
        kind, key = _keys(packets.block)
        _assign(packets.groups, kind, key, masks, group_masks, held, end, self._state, entries)
        return entries

    def _masks(self, block: SampleBlock) -> tuple[IntArray, IntArray]:
        """Return which columns each packet has, (n,), and which each group may have: a bit a column.

        There are more columns than bits in a word in some protocols; those beyond share a bit, which at worst
        begins a row too early.
        """
        masks = np.zeros(len(block), np.int64)
        group_masks = np.zeros(len(self._groups.names), np.int64)
        grouped = [name for name in self._groups.of_column if name in block]
        for number, name in enumerate(grouped):
            bit = np.int64(1) << np.int64(number % 62)
            masks |= np.where(_present(block[name]), bit, np.int64(0))
            group_masks[self._groups.of_column[name]] |= bit
        return masks, group_masks

    def _gather(
        self, stream: str, g: int, block: SampleBlock, row: IntArray, place: IntArray, n: int
    ) -> SampleBlock:
        """Return n rows of a stream, each of the packets that belong to it; the first arrival counts."""
        known = self._columns[stream]
        columns: dict[str, ColumnArray] = {}
        single = len(row) == n
        for name, values in block.columns.items():
            belongs = self._groups.of_column.get(name)
            foreign = belongs is not None and (belongs != g if g else bool(self._state.apart[belongs]))
            if foreign and name not in known:
                continue
            taken = values[row]
            present = np.zeros(len(row), np.bool_) if foreign else _present(taken)
            if name not in known and name not in COMMON and not present.any():
                continue
            known.add(name)
            if single and not foreign:
                columns[name] = taken
                continue
            result = np.full(n, NO_INT if values.dtype == np.int64 else np.nan, values.dtype)
            order = slice(None, None, -1) if name == "arrival_time_ns" else slice(None)
            result[place[present][order]] = taken[present][order]
            columns[name] = result
        return SampleBlock(columns)

    def _keep(
        self,
        packets: Packets,
        row: IntArray,
        group: IntArray,
        epoch: IntArray,
        done: npt.NDArray[np.bool_],
    ) -> None:
        """Keep the packets of the epochs that are not complete."""
        rows, again = np.unique(row[~done], return_inverse=True)
        if not len(rows):
            self._pending, self._kept = None, np.zeros((3, 0), np.int64)
            return
        block = SampleBlock({name: values[rows] for name, values in packets.block.columns.items()})
        self._pending = Packets(block, packets.groups[rows])
        self._kept = np.stack([again.reshape(-1), group[~done], epoch[~done]])


def _present(values: ColumnArray) -> npt.NDArray[np.bool_]:
    return np.asarray(values != NO_INT if values.dtype == np.int64 else ~np.isnan(values))


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
        in_main = groups[i] & 1 != 0
        if in_main:
            own = masks[i]
            for g in range(1, n_groups):
                if state.apart[g]:
                    own &= ~group_masks[g]
            _add(0, i, kind[i], key[i], own, state, entries)
        for g in range(1, n_groups):
            if not groups[i] >> g & 1 or (in_main and not state.apart[g]):
                continue
            own = masks[i] & group_masks[g]
            if not state.apart[g] and _joins(kind[i], key[i], own, state):
                _enter(0, i, own, state, entries)
                continue
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
    if not state.epoch[0]:
        return False
    return bool(
        own & state.mask[0] == 0 if kind == NO_TIME else kind == state.key_kind[0] and key == state.key[0]
    )


@njit
def _is_other(g: int, kind: int, key: int, own: int, state: _State) -> bool:
    """Tell whether a packet cannot belong to the open epoch of its group."""
    if kind == NO_TIME:
        return bool(own & state.mask[g] != 0)
    return bool(kind != state.key_kind[g] or key != state.key[g])


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
        state.behind[g] = state.epochs[0] + (state.epoch[0] != 0)
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
    entries.row[k], entries.group[k], entries.epoch[k] = row, g, state.epoch[g]
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
    entries.ended_after[k], entries.ended_behind[k] = state.after[g], state.behind[g]
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
