"""An effect carried along live, block by block."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import ACCEL, TEMPERATURE, Drive, Effect, Memory


class Carrier:
    """Carries an effect along live: the bias that it adds, and how unsure its state at power-on leaves it.

    Whatever the division into blocks; where the device restarts the state is forgotten.
    """

    def __init__(self, effect: Effect) -> None:
        self._effect = effect
        self._segment: int | None = None
        self._start_ns = 0
        self._memories: list[Memory] = []

    def process(
        self, time_ns: IntArray, segment: IntArray, drivers: Mapping[str, FloatArray]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bias at each sample, from this sample and those before it, and the standard deviation
        that the unknown state at power-on leaves it, (n,) each.

        `drivers` are the temperature in °C, (n,), the specific force in m/s², (n, 3), and other columns by
        their names, (n,).  They are NaN only before their first value in a segment, where the bias is NaN, as
        it is where a column is missing.  An effect of the specific force adds nothing without it.
        """
        n, needed = len(segment), (TEMPERATURE, *self._effect.inputs)
        bias, start_sd = np.zeros(n), np.zeros(n)
        if ACCEL in needed and ACCEL not in drivers:
            return bias, start_sd
        driven = {name: drivers.get(name, np.full(n, np.nan)) for name in needed}
        known = np.isfinite(np.column_stack(list(driven.values()))).all(axis=1)
        cuts = np.flatnonzero(np.diff(segment)) + 1
        for a, b in pairwise([0, *cuts.tolist(), n]):
            if b == a:
                continue
            if segment[a] != self._segment:
                self._segment, self._start_ns, self._memories = int(segment[a]), int(time_ns[a]), []
            first = a + int(np.argmax(known[a:b])) if known[a:b].any() else b
            bias[a:first] = np.nan
            if first < b:
                seconds = np.asarray((time_ns[first:b] - self._start_ns) * 1e-9, np.float64)
                part = {name: values[first:b].copy() for name, values in driven.items()}
                drive = Drive(seconds, part.pop(TEMPERATURE), part.pop(ACCEL, None), part)
                bias[first:b], start_sd[first:b] = self._added(drive)
        return bias, start_sd

    def _added(self, drive: Drive) -> tuple[FloatArray, FloatArray]:
        """Return bias and standard deviation of samples that follow those of the last call."""
        if not self._memories:
            self._memories = [Memory(), *(self._effect.starts(drive) or ())]
        bias, *ends = [self._effect.added(memory, drive) for memory in self._memories]
        if not ends:
            return bias, np.zeros(len(bias))
        return bias, 0.5 * self._effect.start_share * np.abs(ends[1] - ends[0])
