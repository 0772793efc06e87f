"""The rest detector written plainly, six axes at a time, for comparison with the kernel."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.estimation.rest.parameters import RestParameters

QUIET = np.repeat([3.5e-4, 4e-3], 3)
LARGEST = np.repeat([8.7e-3, 0.1], 3)
SENSORS = (slice(0, 3), slice(3, 6))
TINY = 1e-24
NOTHING = np.full(6, np.nan)


@dataclass
class Level:
    """Windows of one length: those complete, oldest first, the half that waits, and what was learnt."""

    means: list[FloatArray] = field(default_factory=lambda: [NOTHING, NOTHING])
    half: tuple[FloatArray, FloatArray, float] | None = None
    variance: FloatArray = field(default_factory=lambda: np.zeros(6))
    gain: FloatArray = field(default_factory=lambda: np.zeros(6))

    def forget(self) -> None:
        self.means, self.half = [NOTHING, NOTHING], None


@dataclass
class Slot:
    """A slot that has ended: sums, counts and variances of its samples, (6,), and its seconds."""

    sums: FloatArray
    counts: FloatArray
    within: FloatArray
    seconds: float

    @property
    def means(self) -> FloatArray:
        return mean(self.sums, self.counts)


def mean(sums: FloatArray, counts: FloatArray) -> FloatArray:
    result: FloatArray = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return result


def second_differences(means: FloatArray, width: int) -> FloatArray:
    """Return all second differences of means of width slots, (k, 6)."""
    part = np.array([means[k : k + width].mean(0) for k in range(len(means) - width + 1)])
    result: FloatArray = part[: -2 * width] - 2 * part[width:-width] + part[2 * width :]
    return result


class PlainDetector:
    """The same decisions as the kernel's, from lists of slots; for rows that have a time and a reading."""

    def __init__(self, parameters: RestParameters | None = None) -> None:
        self.p = parameters or RestParameters()
        self.drift = np.repeat([self.p.gyro_drift, self.p.accel_drift], 3)
        self.step = np.repeat([2.2e-3, 0.16], 3)
        self.known = np.zeros(6, bool)
        self.levels = [Level() for _ in range(8)]
        self.sample_var = np.zeros(6)
        self.rest_mean, self.anchor, self.anchor_var = np.zeros(6), np.zeros(6), np.zeros(6)
        self.rest, self.anchored, self.spike = False, False, False
        self.hold = self.long_hold = self.doubt = self.anchor_time = -np.inf
        self.last_time: float | None = None
        self.slot_time = 0.0
        self.last, self.low, self.high = NOTHING, np.full(6, -np.inf), np.full(6, np.inf)
        self.slots = 0
        self.samples: list[FloatArray] = []
        self.ring: list[Slot] = []
        self.run: list[FloatArray] = []

    def process(self, block: SampleBlock) -> IntArray:
        """Return at_rest of all rows of a block of one segment."""
        readings = np.column_stack(
            [
                block.columns.get(f"{s}_{a}", np.full(len(block), np.nan))
                for s in ("gyro", "accel")
                for a in "xyz"
            ]
        )
        times = block["device_time_ns"] * 1e-9
        return np.array([self.step_on(t, x) for t, x in zip(times, readings, strict=True)], np.int64)

    def step_on(self, t: float, x: FloatArray) -> bool:
        if self.last_time is None or t - self.last_time > 2.5:
            self.begin(t)
        elif t - self.slot_time >= 0.125 - 1e-10:
            self.end_slot(t)
            self.slot_time, self.samples = t, []
        self.last_time = t
        outside = (x < self.low) | (x > self.high)
        change = np.abs(x - self.last)
        self.step = np.where((change > 1e-9 * (np.abs(x) + 1e-3)) & (change < self.step), change, self.step)
        self.last = np.where(np.isfinite(x), x, self.last)
        self.samples.append(x)
        if self.rest and outside.any():
            self.spike = True
            self.leave(0, t, 0.0)
        return self.rest

    def begin(self, t: float) -> None:
        if self.rest and self.last_time is not None:
            self.leave(0, self.last_time, 0.0)
        self.ring, self.spike, self.long_hold = [], False, t
        self.last = NOTHING
        self.low, self.high = np.full(6, -np.inf), np.full(6, np.inf)
        self.watch(t, 1.0)
        self.slot_time, self.samples = t, []

    def watch(self, t: float, seconds: float) -> None:
        self.hold = t + max(seconds, 1.0)
        if seconds > 1.0:
            self.long_hold = self.hold
        self.run, self.quiet = [], 0
        for level in self.levels:
            level.forget()

    def leave(self, j: int, t: float, seconds: float) -> None:
        older = self.levels[j].means[0]
        self.anchor = np.where(np.isfinite(older) & (j > 2), older, self.rest_mean)
        self.anchor_var = self.levels[min(j + 2, 7)].variance.copy()
        self.anchored, self.anchor_time = True, t - 4.0 * seconds
        self.low, self.high = np.full(6, -np.inf), np.full(6, np.inf)
        self.rest, self.ring, self.doubt = False, [], -np.inf

    def resolution(self) -> FloatArray:
        result: FloatArray = np.where(self.sample_var < 0.25 * self.step**2, self.step, 0.0)
        return result

    def ended(self, t: float) -> Slot:
        values = np.array(self.samples)
        counts = np.isfinite(values).sum(0).astype(float)
        within = np.full(6, np.nan)
        for a in np.flatnonzero(counts > 1):
            within[a] = np.nanvar(values[:, a], ddof=1)
        return Slot(np.nansum(values, 0), counts, within, t - self.slot_time)

    def end_slot(self, t: float) -> None:
        slot = self.ended(t)
        self.ring = [*self.ring, slot][-32:]
        self.run.append(slot.means)
        if (self.known & (slot.counts > 0)).any():
            j, seconds = self.moved(slot)
            self.spike = False
            self.quiet += 1
            if j >= 0:
                if self.rest:
                    self.leave(j, t, seconds)
                self.watch(t, 4.0 * seconds)
            elif self.rest:
                self.keep(slot)
            elif t >= self.hold and self.quiet >= 8:
                self.come_back(t)
        self.slots += 1
        if len(self.ring) == 32 and t >= self.long_hold and self.slots % 4 == 0:
            self.trial(t)

    def moved(self, slot: Slot) -> tuple[int, float]:
        found, found_s = -1, 0.0
        sums, counts, seconds = slot.sums, slot.counts, slot.seconds
        for j, level in enumerate(self.levels):
            if seconds > 20.0:
                break
            now = mean(sums, counts)
            if self.changed(level, now, seconds):
                found, found_s = j, seconds
            self.learn(level, now, 2.0**-j)
            if level.half is None:
                level.half = sums, counts, seconds
                break
            (sums, counts, seconds), level.half = (
                (sums + level.half[0], counts + level.half[1], seconds + level.half[2]),
                None,
            )
        if found < 0 and (self.spike or self.shaken(slot)):
            return 0, slot.seconds
        return found, found_s

    def changed(self, level: Level, now: FloatArray, seconds: float) -> bool:
        result = False
        for lag, weight in ((1, 2.0), (2, 3.0)):
            d = np.abs(now - level.means[-lag]) - lag * self.drift * seconds
            variance = weight * (level.variance + TINY)
            over = np.maximum(d - self.resolution(), 0.0)
            chi = np.where(self.known & np.isfinite(d) & (d > 0), over**2 / variance, 0.0)
            result |= any(chi[sensor].sum() > 42.0 for sensor in SENSORS)
        return result

    def learn(self, level: Level, now: FloatArray, white: float) -> None:
        second = now - 2 * level.means[1] + level.means[0]
        sample = np.minimum(second**2 / 6.0, 4.0 * level.variance + TINY)
        new = level.variance + level.gain * (sample - level.variance)
        for a in np.flatnonzero(self.known & np.isfinite(second)):
            highest = 5.0 * max(white * self.levels[0].variance[a], QUIET[a] ** 2)
            level.variance[a] = min(new[a], highest)
            if level.gain[a] > 1 / 64:
                level.gain[a] /= 1 + level.gain[a]
        level.means = [level.means[1], now]

    def shaken(self, slot: Slot) -> bool:
        part = 2.0 / (9.0 * np.maximum(0.5 * (slot.counts - 1), 1.0))
        factor = 2.0 * (1 - part + 6 * np.sqrt(part)) ** 3
        limit = self.sample_var * factor + self.resolution() ** 2
        return bool((self.known & (slot.counts >= 3) & (slot.within > limit)).any())

    def keep(self, slot: Slot) -> None:
        there = self.known & (slot.counts > 0)
        count = sum(np.isfinite(m) for m in self.run)
        share = 1.0 / np.clip(count, 1, 32)
        self.rest_mean = np.where(
            there, self.rest_mean + share * (slot.means - self.rest_mean), self.rest_mean
        )
        within = np.where(np.isfinite(slot.within), slot.within, self.levels[0].variance)
        within = np.minimum(within, 4.0 * self.sample_var + TINY)
        change = (within - self.sample_var) / 64
        self.sample_var = np.where(there, self.sample_var + change, self.sample_var)
        if self.slots % 4 == 0:
            self.set_band()

    def set_band(self) -> None:
        sd = np.sqrt(self.sample_var + self.levels[0].variance)
        width = 7.0 * sd + 1.5 * self.resolution() + 4.0 * self.drift
        self.low = np.where(self.known, self.rest_mean - width, -np.inf)
        self.high = np.where(self.known, self.rest_mean + width, np.inf)

    def enter(self, means: FloatArray) -> None:
        self.rest_mean, self.rest, self.doubt = means, True, -np.inf
        self.set_band()

    def come_back(self, t: float) -> None:
        run = np.array(self.run)
        counts = np.isfinite(run).sum(0)
        means = np.where(counts > 0, np.nansum(run, 0) / np.maximum(counts, 1), self.rest_mean)
        if self.displacement(means, counts, t) <= 0.0:
            self.enter(means)

    def displacement(self, means: FloatArray, counts: IntArray, t: float) -> float:
        if not self.anchored:
            return 0.0
        there = self.known & (counts > 0)
        change = np.where(there, means - self.anchor, 0.0)
        allowed = (
            1.46e-4
            + self.p.gyro_g_sensitivity * float(np.linalg.norm(change[3:]))
            + self.p.gyro_drift * max(t - self.anchor_time, 0.0)
        )
        variance = self.levels[0].variance / np.clip(counts, 1, 32) + self.anchor_var
        beyond = np.abs(change) - allowed - 6.0 * np.sqrt(variance) - self.resolution()
        return float(np.where(there, beyond, 0.0)[:3].max(initial=0.0))

    def trial(self, t: float) -> None:
        ring = np.array([slot.means for slot in self.ring])
        there = np.isfinite(ring).all(0)
        if self.rest and not (there & ~self.known).any():
            return
        rests, v, sample = self.resting(ring, there)
        if not rests:
            self.doubt = -np.inf
            if self.rest:
                self.leave(0, t, 0.0)
                self.watch(t, 1.0)
            return
        means = np.where(there, ring.mean(0), self.rest_mean)
        if self.rest:
            self.rest_mean = np.where(self.known, self.rest_mean, means)
            self.adopt(there & ~self.known, v, sample)
            return
        if self.doubt == -np.inf:
            self.doubt = t
        beyond = self.displacement(means, 32 * there, t)
        if beyond <= 0.0 or (t - self.doubt >= self.p.doubt_s and beyond <= self.p.largest_jump):
            self.adopt(there, v, sample)
            self.enter(means)
            self.watch(t, 0.0)

    def resting(
        self, ring: FloatArray, there: npt.NDArray[np.bool_]
    ) -> tuple[bool, dict[int, FloatArray], FloatArray]:
        """Tell whether a full ring shows rest; variances of means by width, and of samples."""
        v = {width: (second_differences(ring, width) ** 2).mean(0) / 6.0 for width in (1, 4, 8)}
        within = np.array([slot.within for slot in self.ring])
        has = np.isfinite(within).any(0)
        each = np.array([np.nanmean(within[:, a]) if has[a] else np.nan for a in range(6)])
        sample = np.where(has, np.maximum(v[1], each), v[1])
        floor = np.where(sample < 0.25 * self.step**2, self.step**2 / 12, 0.0)
        seconds = sum(slot.seconds for slot in self.ring)
        result = bool(there.any())
        for sensor in SENSORS:
            axes = np.arange(6)[sensor][there[sensor]]
            if not len(axes):
                continue
            v1, quiet = v[1][axes] + floor[axes], QUIET[axes] ** 2
            scale = 1.0 / np.maximum(v1, quiet)
            slow = all(
                (v[w][axes] * scale).sum() <= 5.0 * (np.maximum(v1 / w, quiet) * scale).sum() for w in (4, 8)
            )
            change = np.abs(ring[16:, axes].mean(0) - ring[:16, axes].mean(0))
            change -= self.drift[axes] * seconds / 2 + np.sqrt(12 * floor[axes])
            chi = np.maximum(change, 0.0) ** 2 / (2 * np.maximum(v1 / 16, v[8][axes]) + TINY)
            h = second_differences(ring, 1)[:, axes] ** 2 / (6 * (v1 + TINY))
            bump = (h.max(0) > 20 * np.maximum(h.mean(0), 1.0)).any()
            halves = [[h[:15].sum(), h[15:].sum()]]
            if has[axes].any():
                ratio = (within[:, axes] + floor[axes]) / (sample[axes] + floor[axes] + TINY)
                halves.append([ratio[:16].mean(0).sum(), ratio[16:].mean(0).sum()])
            steady = all(max(pair) <= 4.0 * min(pair) + TINY for pair in halves)
            small = (v1 <= LARGEST[axes] ** 2).all()
            result &= bool(slow and chi.sum() <= 42.0 and not bump and steady and small)
        return result, v, sample

    def adopt(self, which: npt.NDArray[np.bool_], v: dict[int, FloatArray], sample: FloatArray) -> None:
        for a in np.flatnonzero(which):
            before, now = self.levels[0].variance[a], v[1][a]
            alike = max(before, now) <= 2.5 * min(before, now) and sample[a] <= 2.5 * self.sample_var[a]
            if self.known[a] and alike:
                continue
            self.known[a], self.sample_var[a] = True, sample[a]
            v4, v8 = max(now / 4, v[4][a]), max(now / 8, v[8][a])
            start = [now, max(now / 2, v4), v4, v8, *(v8 * np.sqrt(0.5) ** k for k in range(1, 5))]
            for j, level in enumerate(self.levels):
                level.variance[a], level.gain[a] = start[j], 1 / (1 + max(32 / 2**j, 3))
