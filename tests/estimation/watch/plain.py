"""Plain twin of the watch: the same tests, slot by slot, in dictionaries."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.watch import kernel as k


class HighPass:
    """What is left of a value by a low-pass that has taken it in."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds
        self.low = math.nan

    def __call__(self, value: float, dt: float) -> float:
        if not math.isfinite(value):
            return math.nan
        self.low = (
            value
            if math.isnan(self.low)
            else self.low + (1 - math.exp(-dt / self.seconds)) * (value - self.low)
        )
        return value - self.low


class PlainWatch:
    """One axis."""

    def __init__(self) -> None:
        self.temperature = [HighPass(s) for s in k.TEMPERATURE_S]
        self.rate = [HighPass(s) for s in k.RATE_S]
        self.scale = [k.LEAST_DEGC] * len(k.TEMPERATURE_S) + [k.LEAST_RATE] * (1 + len(k.RATE_S))
        self.past = [0.0] * len(k.PAST_S)
        self.tests: dict[tuple[int, float, int], float] = {}
        self.sizes = [0.0] * len(k.LARGE)
        self.peaks = np.zeros(k.REGRESSORS + 1)
        self.block: list[tuple[list[float], float]] = []
        self.slots = 0
        self.first = self.last = math.nan

    def slot(self, seconds: float, v: float, temperature: float, rate: float) -> None:
        if self.slots == 0:
            self.first = self.last = seconds
        dt = seconds - self.last
        driven = [f(temperature, dt) for f in self.temperature] + [rate] + [f(rate, dt) for f in self.rate]
        for i, value in enumerate(driven):
            if math.isfinite(value):
                least = k.LEAST_DEGC if i < len(k.TEMPERATURE_S) else k.LEAST_RATE
                self.scale[i] = max(abs(value), math.exp(-dt / k.SCALE_S) * self.scale[i], least)
                driven[i] = value / self.scale[i]
            else:
                driven[i] = 0.0
        v = min(max(v, -k.CLIP), k.CLIP)
        earlier = []
        for i, seconds_kept in enumerate(k.PAST_S):
            keep = math.exp(-0.5 / seconds_kept) if seconds_kept > 0.5 else 0.0
            earlier.append(min(max(self.past[i] / (3 * math.sqrt((1 - keep) / (1 + keep))), -1.0), 1.0))
            self.past[i] = keep * self.past[i] + (1 - keep) * v
        warm = [math.exp((self.first - seconds) / tau) for tau in k.WARM_UP_S]
        if self.slots >= k.LEARNING:
            self.block.append(([*driven, 1.0, *warm, *earlier], v))
        self.last = seconds
        self.slots += 1
        if len(self.block) == k.BLOCK:
            self._end()

    def _end(self) -> None:
        for r in range(k.REGRESSORS):
            signs = (1, -1) if r < k.PAST else (1,)
            for theta in k.THETAS:
                for sign in signs:
                    gain = sum(
                        theta * (sign * x[r] * v - k.TOLERANCE * abs(x[r]))
                        - theta**2 * x[r] ** 2 * k.KAPPA / 2
                        for x, v in self.block
                    )
                    value = max(self.tests.get((r, theta, sign), 0.0), 0.0) + gain
                    self.tests[r, theta, sign] = value
                    self.peaks[r] = max(self.peaks[r], value)
        for i, factor in enumerate(k.LARGE):
            gain = sum(factor * v * v + 0.5 * math.log(1 - 2 * factor * k.KAPPA) for _, v in self.block)
            self.sizes[i] = max(self.sizes[i], 0.0) + gain
            self.peaks[-1] = max(self.peaks[-1], self.sizes[i])
        self.block = []


def peaks(
    seconds: FloatArray, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> FloatArray:
    """Return the highest evidence of each axis and trait, (3, 13)."""
    found = []
    for axis in range(3):
        one = PlainWatch()
        for row in zip(seconds, innovation[:, axis], temperature[:, axis], rate[:, axis], strict=True):
            one.slot(*(float(value) for value in row))
        found.append(one.peaks)
    return np.array(found)
