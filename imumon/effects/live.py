"""An effect carried along live, block by block."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.effects.base import ACCEL, Drive, Effect, Memory

NO_DRIVERS: Mapping[str, FloatArray] = {}


class Carrier:
    """Carries an effect along live: the bias that it adds, and how unsure its state at power-on leaves it.

    Whatever the division into blocks; where the device restarts the state is forgotten.  Temperature and
    whatever else drives the effect may be missing (NaN): the last value holds; before the first the bias is
    NaN.  An effect of the specific force adds nothing where there is none at all; the bias of one of a driver
    that is not recorded is not known (NaN).
    """

    def __init__(self, effect: Effect) -> None:
        self._effect = effect
        self._others = [name for name in effect.inputs if name != ACCEL]
        self._segment: int | None = None
        self._start_ns = 0
        self._last = np.full(1 + len(self._others) + 3 * (ACCEL in effect.inputs), np.nan)
        self._memories: list[Memory] = []

    def process(
        self,
        time_ns: IntArray,
        segment: IntArray,
        temperature: FloatArray,
        accel: FloatArray | None = None,
        others: Mapping[str, FloatArray] = NO_DRIVERS,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the bias at each sample, from this sample and those before it, and the standard deviation
        that the unknown state at power-on leaves it, (n,) each.

        Times, temperature in °C and whatever else may drive an effect are (n,), `accel` in m/s² is (n, 3).
        """
        n = len(segment)
        bias, start_sd = np.zeros(n), np.zeros(n)
        parts = [temperature, *(others.get(name, np.full(n, np.nan)) for name in self._others)]
        if ACCEL in self._effect.inputs:
            if accel is None:
                return bias, start_sd
            parts.append(accel)
        driven = np.column_stack(parts)
        cuts = np.flatnonzero(np.diff(segment)) + 1
        for a, b in pairwise([0, *cuts.tolist(), n]):
            if b > a:
                if segment[a] != self._segment:
                    self._segment, self._start_ns = int(segment[a]), int(time_ns[a])
                    self._last, self._memories = np.full_like(self._last, np.nan), []
                bias[a:b], start_sd[a:b] = self._within(time_ns[a:b], driven[a:b])
        return bias, start_sd

    def _within(self, time_ns: IntArray, driven: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bias and sd within a segment."""
        held = np.column_stack([_held(part, self._last[at]) for at, part in enumerate(driven.T)])
        self._last = held[-1]
        bias, start_sd = np.full(len(held), np.nan), np.zeros(len(held))
        known = np.isfinite(held).all(axis=1)
        if not known.any():
            return bias, start_sd
        first = int(np.argmax(known))
        seconds = np.asarray((time_ns[first:] - self._start_ns) * 1e-9, np.float64)
        temperature, *others = (held[first:, at].copy() for at in range(1 + len(self._others)))
        accel = held[first:, -3:] if ACCEL in self._effect.inputs else None
        drive = Drive(seconds, temperature, accel, dict(zip(self._others, others, strict=True)))
        if not self._memories:
            self._memories = [Memory(), *(self._effect.starts(drive) or ())]
        bias[first:], *ends = [self._effect.added(memory, drive) for memory in self._memories]
        if ends:
            start_sd[first:] = 0.5 * self._effect.start_share * np.abs(ends[1] - ends[0])
        return bias, start_sd


def _held(values: FloatArray, before: float) -> FloatArray:
    """Return the values, each missing one replaced by the last there was."""
    known = np.concatenate([[np.isfinite(before)], np.isfinite(values)])
    last = np.maximum.accumulate(np.where(known, np.arange(len(known)), 0))
    return np.asarray(np.concatenate([[before], values])[last][1:])
