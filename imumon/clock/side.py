"""Side streams: their counts on the clock of the main stream, and what they lend its rows.

A side stream (a receiver, a barometer) counts with the device's clock as the main stream does, but its data
may be older or newer than the inertial data between which they come.  So each of its counts is taken as near
to that of the latest main row as the range of the counter allows.
"""

from collections.abc import Mapping

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock, join, missing
from imumon.columns import TEMPERATURES
from imumon.protocols.base import Timing
from imumon.protocols.epochs import Epochs

HISTORY = 4096
"""Main rows that are remembered; a side epoch that waited for longer is dated by the oldest."""


class SideClock:
    """Device time, host time and segment of side rows, whatever the division into blocks.

    `timing`: how the device counts.
    """

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._first = 0
        before = dict.fromkeys(("ticks", "device_time_ns", "host_time_ns"), np.array([NO_INT]))
        # Main rows; the first stands for the time before any.
        self._main = SampleBlock({**before, "segment": np.zeros(1, np.int64)})

    def follow(self, main: SampleBlock, ticks: IntArray | None) -> None:
        """Take the dated rows of the main stream that the next side rows refer to."""
        sent = missing(len(main), np.int64) if ticks is None else ticks
        times = {name: main[name] for name in ("device_time_ns", "host_time_ns", "segment")}
        old = len(self._main)
        drop = max(old - HISTORY - 1, 0)
        self._first += drop
        self._main = join([self._main.rows(drop, old), SampleBlock({"ticks": sent, **times})])

    def times(self, side: Epochs) -> dict[str, ColumnArray]:
        """Return the time columns of side rows.

        Rows without a count of the device's clock have the time of the main row before them; before the first
        main row a count stands for itself.
        """
        at = np.maximum(side.after, side.until - HISTORY) - self._first
        main = self._main.kept(at)
        ticks, device, host = main["ticks"], main["device_time_ns"], main["host_time_ns"]
        block = side.block
        counts = block.columns.get("device_ticks", missing(len(block), np.int64))
        arrival = block["arrival_time_ns"]
        own = self._on_main_clock(counts, ticks, device)
        known = own != NO_INT
        mapped = np.where(known & (host != NO_INT) & (device != NO_INT), host + own - device, arrival)
        return {
            "device_time_ns": np.where(known, own, arrival),
            "arrival_time_ns": arrival,
            "host_time_ns": np.where(arrival == NO_INT, mapped, np.minimum(mapped, arrival)),
            "segment": main["segment"],
        }

    def _on_main_clock(self, counts: IntArray, ticks: IntArray, device: IntArray) -> IntArray:
        """Return counts in ns on the unwrapped clock of the main rows, whose count and time are given."""
        unit, bits = self._timing.tick_ns, self._timing.tick_bits
        if unit is None:
            return device
        there = counts != NO_INT
        anchored, alone = there & (ticks != NO_INT), there & (ticks == NO_INT)
        steps = np.where(anchored, counts - ticks, np.where(alone, counts, 0))
        if 0 < bits < 63:
            nearest = (steps + (1 << (bits - 1))) % (1 << bits) - (1 << (bits - 1))
            steps = np.where(anchored, nearest, steps)
        whole, part = np.divmod(steps, unit.denominator)
        moved = whole * unit.numerator + part * unit.numerator // unit.denominator
        return np.asarray(np.where(alone, 0, device) + moved)


class HeldReadings:
    """Adds to main rows the latest temperature of the side streams, whatever the division into blocks.

    A reading holds from the first main row that was begun after it was complete; a row's own counts first.
    """

    def __init__(self) -> None:
        self._latest: dict[str, float] = {}
        self._rows = 0

    @property
    def names(self) -> frozenset[str]:
        """The columns that are held so far."""
        return frozenset(self._latest)

    def process(self, main: SampleBlock, side: Mapping[str, Epochs]) -> SampleBlock:
        """Return main rows with the columns of `TEMPERATURES` that only side streams have."""
        first = self._rows
        self._rows += len(main)
        for name in TEMPERATURES:
            having = [epochs for epochs in side.values() if name in epochs.block]
            if not having and name not in self._latest:
                continue
            values = np.concatenate([np.zeros(0), *(epochs.block[name] for epochs in having)])
            at = np.concatenate([np.zeros(0, np.int64), *(epochs.until - first for epochs in having)])
            order = np.argsort(at, kind="stable")
            order = order[np.isfinite(values[order])]
            known = np.append(self._latest.get(name, np.nan), values[order])
            held = known[np.searchsorted(at[order], np.arange(len(main)), side="right")]
            self._latest[name] = float(known[-1])
            if name in main:
                held = np.where(np.isnan(main[name]), held, main[name])
            main = main.with_columns({name: held})
        return main


class SharedCounter:
    """Removes from the main stream's packet counter the steps that packets of side streams made.

    Many devices number all their messages in one sequence, so a receiver's message leaves a hole between two
    inertial ones that is no loss.

    `bits`: width of the counter; None when the device has none.
    """

    def __init__(self, bits: int | None) -> None:
        self._modulus = 1 << bits if bits else 0
        self._taken = 0
        self._rows = 0
        self._waiting: list[tuple[int, int]] = []
        self._last = NO_INT

    def process(self, counter: IntArray, more: IntArray, side: list[tuple[int, int]]) -> IntArray:
        """Return the counter of the next main rows as if only they were counted.

        `counter` (n,): `NO_INT` where a row has none.
        `more` (n,): steps of the counter within each row (`imumon.protocols.epochs.Epochs`).
        `side`: number of main rows begun before each side packet, and its counter.
        """
        if not self._modulus:
            return counter
        valid = np.flatnonzero(counter != NO_INT)
        values = np.append(self._last, counter[valid])  # the first is that of the call before
        less, waiting = more.copy(), []
        for after, number in [*self._waiting, *side]:
            k = int(np.searchsorted(valid, after - self._rows))
            if k == len(valid):
                waiting.append((after, number))
            elif values[k] != NO_INT:
                step = (values[k + 1] - values[k]) % self._modulus
                less[valid[k]] += 0 < (number - values[k]) % self._modulus < step
        total = self._taken + np.cumsum(less)
        self._taken += int(less.sum())
        self._last = int(values[-1])
        self._rows += len(counter)
        self._waiting = waiting
        return np.where(counter == NO_INT, NO_INT, (counter - total) % self._modulus)
