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
from typing import Any

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


RecordArray = npt.NDArray[np.void]

STATE = np.dtype(
    [
        (name, np.int64)
        for name in (
            "apart",
            "epoch",  # number of the open epoch, 0: none
            "key_kind",
            "key",
            "mask",  # columns that it has
            "after",  # main rows complete when it began
            "in_generation",
            "generations",
            "any_now",  # columns that any epoch of this generation had
            "any_before",
            "all_now",
            "all_before",
            "epochs",
            "incomplete",
        )
    ]
)
"""What is carried for each group."""
ENTRY = np.dtype([(name, np.int64) for name in ("row", "group", "epoch", "own")])
"""A packet belongs to an epoch, with these of its columns."""
ENDED = np.dtype([(name, np.int64) for name in ("epoch", "group", "after", "until")])
"""An epoch that ended; `after` and `until` count main rows as `Epochs` does."""
COUNTS = np.dtype([(name, np.int64) for name in ("latest", "entries", "ended")])
"""Number of the latest epoch; entries and ended epochs so far."""


class EpochAssembler:
    """Puts packets together to epochs, whatever the division into blocks.

    Parameters
    ----------
    groups : Groups
    """

    def __init__(self, groups: Groups) -> None:
        self._groups = groups
        n = len(groups.names)
        self._state: RecordArray = np.zeros(n, STATE)
        self._state["apart"] = groups.apart
        self._counts: RecordArray = np.zeros(1, COUNTS)
        self._bits: dict[str, int] = {}
        self._packets = np.zeros(n, np.int64)
        self.counted_aside: list[tuple[int, int]] = []
        """Of the side packets that `process` saw last: the main rows begun before each, and its counter."""
        self._pending: Packets | None = None
        self._kept: RecordArray = np.zeros(0, ENTRY)
        self._columns: dict[str, set[str]] = {name: set() for name in groups.names}

    @property
    def counters(self) -> dict[str, EpochCounters]:
        """What became of the packets, by stream; streams without epochs are left out."""
        state = self._state
        return {
            name: EpochCounters(int(self._packets[g]), int(state["incomplete"][g]))
            for g, name in enumerate(self._groups.names)
            if state["epochs"][g]
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
        entries, ends, behind = self._assigned(packets, held, masks, group_masks, end)
        self.counted_aside = _counted(packets.block, behind, held)
        found = {}
        for g, name in enumerate(self._groups.names):
            ended = ends[ends["group"] == g]
            if g and not len(ended):
                continue
            made = entries[(entries["group"] == g) & np.isin(entries["epoch"], ended["epoch"])]
            self._packets[g] += len(made)
            place = np.searchsorted(ended["epoch"], made["epoch"])
            block = self._gather(name, packets.block, made, place, len(ended))
            more = _steps_within(packets.block, made["row"], place, len(ended))
            found[name] = Epochs(block, ended["after"], ended["until"], more)
        self._keep(packets, entries[~np.isin(entries["epoch"], ends["epoch"])])
        return found

    def _assigned(
        self, packets: Packets, held: int, masks: IntArray, group_masks: IntArray, end: bool
    ) -> tuple[RecordArray, RecordArray, IntArray]:
        """Return the entries, the epochs that ended, and the main rows begun before each side packet."""
        n, kept = len(packets), len(self._kept)
        most = (n - held) * len(self._groups.names) + kept
        entries, ends = np.zeros(most, ENTRY), np.zeros(most + len(self._groups.names), ENDED)
        entries[:kept] = self._kept
        behind = np.full(n, -1, np.int64)
        self._counts["entries"], self._counts["ended"] = kept, 0
        kind, key = _keys(packets.block)
        _assign(packets.groups, kind, key, masks, group_masks, held, end, self._state, entries, ends,
                behind, self._counts)  # fmt: skip
        return entries[: self._counts["entries"][0]], ends[: self._counts["ended"][0]], behind

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
        self, stream: str, block: SampleBlock, entries: RecordArray, place: IntArray, n: int
    ) -> SampleBlock:
        """Return n rows of a stream, `place` being those of the entries; the first arrival counts."""
        row, own = entries["row"], entries["own"]
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


# Records are passed as whole arrays: a record of its own would be copied at each call.


@njit
def _assign(
    groups: IntArray, kind: IntArray, key: IntArray, masks: IntArray, group_masks: IntArray, first: int,
    end: bool, state: Any, entries: Any, ends: Any, behind: IntArray, counts: Any,
) -> None:  # fmt: skip
    """Assign packets from row `first` on to epochs (see the text of the module).

    `behind` is filled with how many main rows had begun before each packet of a side stream.
    """
    n_groups = len(group_masks)
    columns_apart = np.int64(0)
    for g in range(1, n_groups):
        if state[g].apart:
            columns_apart |= group_masks[g]
    for i in range(first, len(groups)):
        joined, together = groups[i] & 1 != 0, masks[i] & ~columns_apart
        if joined:
            _add(0, i, kind[i], key[i], together, state, entries, ends, counts)
        elif together and state[0].epoch and not _is_other(0, kind[i], key[i], together, state):
            _enter(0, i, together, state, entries, ends, counts)
            joined = True
        if not joined:
            behind[i] = state[0].epochs + (state[0].epoch != 0)
        for g in range(1, n_groups):
            if groups[i] >> g == 0:
                break
            if not groups[i] >> g & 1 or (joined and not state[g].apart):
                continue
            own = masks[i] & group_masks[g]
            if state[g].epoch and _is_other(g, kind[i], key[i], own, state):
                state[g].apart = 1
                columns_apart |= group_masks[g]
            _add(g, i, kind[i], key[i], own, state, entries, ends, counts)
    if end:
        for g in range(n_groups):
            if state[g].epoch:
                _end(g, state, ends, counts)


@njit
def _is_other(g: int, kind: int, key: int, own: int, state: Any) -> bool:
    """Tell whether a packet cannot belong to the open epoch of its group: another time, or a field again."""
    other_time = kind != NO_TIME and (kind != state[g].key_kind or key != state[g].key)
    return bool(other_time or own & state[g].mask)


@njit
def _add(
    g: int, row: int, kind: int, key: int, own: int, state: Any, entries: Any, ends: Any, counts: Any
) -> None:
    """Add a packet to its group's epoch, which it may begin."""
    if state[g].epoch and _is_other(g, kind, key, own, state):
        _end(g, state, ends, counts)
    if not state[g].epoch:
        counts[0].latest += 1
        state[g].epoch = counts[0].latest
        state[g].key_kind, state[g].key, state[g].mask = kind, key, 0
        state[g].after = state[0].epochs
        if g == 0 and kind != NO_TIME:
            _pull(kind, key, state, entries, counts)
    _enter(g, row, own, state, entries, ends, counts)


@njit
def _pull(kind: int, key: int, state: Any, entries: Any, counts: Any) -> None:
    """Take into the new main epoch what came before it with the same time."""
    for g in range(1, len(state)):
        if state[g].apart or not state[g].epoch or state[g].key_kind != kind or state[g].key != key:
            continue
        for k in range(counts[0].entries - 1, -1, -1):
            if entries[k].epoch == state[g].epoch:
                entries[k].epoch, entries[k].group = state[0].epoch, 0
        state[0].mask |= state[g].mask
        state[g].epoch = 0


@njit
def _enter(g: int, row: int, own: int, state: Any, entries: Any, ends: Any, counts: Any) -> None:
    """Enter a packet into the open epoch, and end that when it has all that it may have."""
    k = counts[0].entries
    entries[k].row, entries[k].group, entries[k].epoch, entries[k].own = row, g, state[g].epoch, own
    counts[0].entries = k + 1
    state[g].mask |= own
    usual = state[g].any_now | state[g].any_before
    if state[g].generations and state[g].mask & usual == usual:
        _end(g, state, ends, counts)


@njit
def _end(g: int, state: Any, ends: Any, counts: Any) -> None:
    """End the open epoch of a group, and learn what epochs have."""
    k = counts[0].ended
    ends[k].epoch, ends[k].group = state[g].epoch, g
    ends[k].after, ends[k].until = state[g].after, state[0].epochs
    counts[0].ended = k + 1
    mask, always = state[g].mask, state[g].all_before
    state[g].epoch = 0
    state[g].epochs += 1
    state[g].incomplete += state[g].generations > 0 and mask & always != always
    state[g].any_now |= mask
    state[g].all_now = mask if state[g].in_generation == 0 else state[g].all_now & mask
    state[g].in_generation += 1
    if state[g].in_generation == GENERATION:
        state[g].any_before, state[g].all_before = state[g].any_now, state[g].all_now
        state[g].any_now = state[g].in_generation = 0
        state[g].generations += 1
