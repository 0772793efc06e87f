"""Times of side streams: their counts on the clock of the main stream, which they never touch.

A side stream (a receiver, a barometer) counts with the device's clock as the main stream does, but its data
may be older or newer than the inertial data between which they come.  So each of its counts is taken as near
to that of the latest main row as the range of the counter allows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, IntArray, SampleBlock
from imumon.protocols.base import Timing


@dataclass(slots=True)
class _Anchor:
    """The latest row of the main stream."""

    ticks: int
    device_ns: int
    host_ns: int
    segment: int


_NONE = _Anchor(NO_INT, NO_INT, NO_INT, 0)


class SideClock:
    """Device time, host time and segment of side rows, whatever the division into blocks.

    Parameters
    ----------
    timing : Timing
        How the device counts.
    """

    def __init__(self, timing: Timing) -> None:
        self._timing = timing
        self._anchor = _NONE
        self._before = 0
        self._rows: dict[str, IntArray] = {}

    def follow(self, main: SampleBlock, ticks: IntArray | None) -> None:
        """Take the dated rows of the main stream that the next side rows refer to."""
        anchor, n = self._anchor, len(main)
        if self._rows and len(self._rows["ticks"]) > 1:
            anchor = _Anchor(*(int(self._rows[name][-1]) for name in ("ticks", "device", "host", "segment")))
            self._before += len(self._rows["ticks"]) - 1
        self._anchor = anchor
        counts = np.full(n, NO_INT, np.int64) if ticks is None else ticks
        self._rows = {
            "ticks": np.concatenate([[anchor.ticks], counts]),
            "device": np.concatenate([[anchor.device_ns], main["device_time_ns"]]),
            "host": np.concatenate([[anchor.host_ns], main["host_time_ns"]]),
            "segment": np.concatenate([[anchor.segment], main["segment"]]),
        }

    def times(self, side: SampleBlock, after: IntArray) -> dict[str, ColumnArray]:
        """Return the time columns of side rows.

        Parameters
        ----------
        side : SampleBlock
            With ``device_ticks`` where the device sends them; rows without have the time of the main row.
        after : array of int64, (n,)
            Number of main rows before each.
        """
        at = after - self._before
        ticks, device, host, segment = (
            self._rows[name][at] for name in ("ticks", "device", "host", "segment")
        )
        own = side.columns.get("device_ticks")
        counts = np.full(len(side), NO_INT, np.int64) if own is None else own
        unit = self._timing.tick_ns
        if unit is None:
            own_ns = device
        else:
            anchored = (ticks != NO_INT) & (counts != NO_INT)
            ahead = np.where(anchored, counts - ticks, 0)
            if 0 < self._timing.tick_bits < 63:
                modulus = 1 << self._timing.tick_bits
                ahead = (ahead + modulus // 2) % modulus - modulus // 2
            alone = (ticks == NO_INT) & (counts != NO_INT)
            start = np.where(anchored, device, 0)
            steps = np.where(anchored, ahead, np.where(alone, counts, 0))
            # Exact for clocks whose tick is a whole number of ns; others are a ns off at the most.
            moved = steps // unit.denominator * unit.numerator + (
                steps % unit.denominator * unit.numerator // unit.denominator
            )
            own_ns = np.where(anchored | alone, start + moved, device)
        arrival = side["arrival_time_ns"] if "arrival_time_ns" in side else np.full(len(side), NO_INT)
        dated = (host != NO_INT) & (device != NO_INT)
        mapped = np.where(dated, host + own_ns - device, arrival)
        host_ns = np.where(arrival == NO_INT, mapped, np.minimum(mapped, arrival))
        host_ns = np.where((host == NO_INT) & (arrival == NO_INT), NO_INT, host_ns)
        return {
            "device_time_ns": np.where(own_ns == NO_INT, arrival, own_ns),
            "arrival_time_ns": arrival,
            "host_time_ns": host_ns,
            "segment": segment,
        }


class SharedCounter:
    """Takes out of the main stream's packet counter what other packets than its rows have counted.

    Many devices number all their messages in one sequence, so a receiver's message leaves a hole between two
    inertial ones that is no loss.

    Parameters
    ----------
    bits : int or None
        Width of the counter; None when the device has none.
    """

    def __init__(self, bits: int | None) -> None:
        self._modulus = 1 << bits if bits else 0
        self._taken = 0
        self._rows = 0
        self._waiting: list[tuple[int, int]] = []
        self._last = NO_INT

    def process(self, counter: IntArray, more: IntArray, side: list[tuple[int, int]]) -> IntArray:
        """Return the counter of the next main rows as if only they were counted.

        Parameters
        ----------
        counter : array of int64, (n,)
            `NO_INT` where a row has none.
        more : array of int64, (n,)
            Steps of the counter within each row (`imumon.protocols.epochs.Epochs`).
        side : list of (int, int)
            Number of main rows begun before each side packet, and its counter.
        """
        if not self._modulus:
            return counter
        valid = np.flatnonzero(counter != NO_INT)
        values = counter[valid]
        before = np.concatenate([[self._last], values[:-1]]) if len(values) else values
        less, waiting = more.copy(), []
        for after, number in [*self._waiting, *side]:
            k = int(np.searchsorted(valid, after - self._rows))
            if k == len(valid):
                waiting.append((after, number))
            elif before[k] != NO_INT:
                step = (values[k] - before[k]) % self._modulus
                less[valid[k]] += 0 < (number - before[k]) % self._modulus < step
        total = self._taken + np.cumsum(less)
        if len(counter):
            self._taken = int(total[-1])
        self._last = int(values[-1]) if len(values) else self._last
        self._rows += len(counter)
        self._waiting = waiting
        return np.where(counter == NO_INT, NO_INT, (counter - total) % self._modulus)
