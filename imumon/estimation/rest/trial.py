"""Rest without knowledge of the noise: 32 slots that look like noise about a constant.

White noise averages out over longer windows; hands, vehicles and anything else that moves do not.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.estimation.rest.state import ACCEL, GYRO, LEVELS, State
from imumon.estimation.rest.wander import forget
from imumon.estimation.rest.windows import CHI_SQUARE, COLOUR, MOST_WITHIN, QUIET, QUIETER, SLOTS, TINY

RING = 32
"""Slots that a trial looks at."""
HALF = RING // 2
ALIKE = 2.5
LARGEST_SD = np.array([8.7e-3, 8.7e-3, 8.7e-3, 0.1, 0.1, 0.1])
"""No sensor has slot means noisier than this: 0.5 deg/s, 0.1 m/s²."""
LARGEST_MEAN_SD = np.array([3.5e-3, 3.5e-3, 3.5e-3, 0.03, 0.03, 0.03])
"""The same where a slot has `MEAN_OF` samples or more: 0.1 °/s/√Hz and 1.5 mg/√Hz, more than any sensor on
sale has.  An engine that idles averages out; a road does not."""
MEAN_OF = 3
WHITE = 1.5
"""A gyro may be noisier if its slots are no noisier than so many times what white noise of its samples makes
them: it is the sensor then.  Accelerometers may not, for a road shakes them as evenly."""
STEADY = 4.0
"""Ratio of the variances in the two halves of a trial."""
LARGEST_RATIO = 20.0
"""A single second difference, squared, over the mean of them: more is a bump."""
NEIGHBOUR = np.sqrt(0.5)
"""Variance at a level of which nothing is known over that of half the windows: between white and flicker."""


class Noise(NamedTuple):
    """The noise of a unit at rest, by a trial; arrays are (6,).

    Parameters
    ----------
    present : array of bool
        Axes that were there in all slots.
    mean : array
        Of the ring; NaN where an axis was missing.
    of_1, of_4, of_8 : array
        Variance of the mean of so many slots.
    sample : array
        Variance of a sample.
    """

    present: BoolArray
    mean: FloatArray
    of_1: FloatArray
    of_4: FloatArray
    of_8: FloatArray
    sample: FloatArray

    def is_alike(self, state: State) -> BoolArray:
        """Tell of which axes the noise is that of the last rest, (6,)."""
        before = state.windows.variance[0]
        alike = np.maximum(before, self.of_1) <= ALIKE * np.minimum(before, self.of_1)
        return np.asarray(alike & (self.sample <= ALIKE * state.windows.sample_variance))


def second_differences(means: FloatArray, width: int) -> FloatArray:
    """Return all second differences of means of width slots, (k, 6)."""
    sums = np.concatenate([np.zeros((1, means.shape[1])), np.cumsum(means, 0)])
    part = (sums[width:] - sums[:-width]) / width
    return np.asarray(part[: -2 * width] - 2.0 * part[width:-width] + part[2 * width :])


def look(state: State, drift: FloatArray) -> Noise | None:
    """Return the noise of the latest slots where they are noise about a constant; None where they are not."""
    windows = state.windows
    n, samples = state.length, windows.samples
    ring = windows.average[n - RING : n]
    single = ring[:-2] - 2.0 * ring[1:-1] + ring[2:]
    of_1 = (single * single).mean(0) / 6.0
    count = (samples[n] - samples[n - RING]) / RING
    largest = np.where(count >= MEAN_OF, LARGEST_MEAN_SD, LARGEST_SD)
    loud = of_1 > largest**2
    if loud[ACCEL].any():
        return None
    each, halves = _within(windows.within[n - RING : n])
    if (loud & ~(of_1 * count < WHITE * each)).any():
        return None
    mean = ring.mean(0)
    present = np.isfinite(mean)
    shaken = each > MOST_WITHIN**2
    shaken[GYRO] &= ~_is_white(of_1 * count, each, windows.jumps[n - RING : n].mean(0))[GYRO]
    if not present.any() or (present & shaken).any():
        return None
    of_4, of_8 = ((second_differences(ring, width) ** 2).mean(0) / 6.0 for width in (4, 8))
    sample = np.fmax(of_1, each)
    noise = Noise(present, mean, of_1, of_4, of_8, sample)
    step2 = windows.step**2
    floor = np.where(sample < 0.25 * step2, step2 / 12.0, 0.0)
    scaled = single**2 / (6.0 * (of_1 + floor + TINY))
    if (scaled.max(0) > LARGEST_RATIO * np.maximum(scaled.mean(0), 1.0)).any():
        return None
    power = np.array([scaled[: HALF - 1].sum(0), scaled[HALF - 1 :].sum(0)])
    ratio = (halves + floor) / (sample + floor + TINY)
    rests = all(
        _is_noise(noise, floor, sensor, _change(ring, noise, floor, drift * state.span_s(RING)))
        and _is_steady(power[:, sensor], ratio[:, sensor])
        for sensor in (GYRO, ACCEL)
        if present[sensor].any()
    )
    return noise if rests else None


def _is_white(of_means: FloatArray, of_samples: FloatArray, of_steps: FloatArray) -> BoolArray:
    """Tell whether means, samples and their steps vary alike, each for white noise of the same density, (6,).

    Vibration does not: below the rate of the slots the means vary by more, above it they average out, and
    only at a quarter of the sample rate its steps are those of white noise.
    """
    means = (of_means < WHITE * of_samples) & (ALIKE * of_means > of_samples)
    return np.asarray(means & (of_steps < WHITE * of_samples) & (WHITE * of_steps > of_samples))


def _within(within: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean variance within slots, (6,), and in both halves, (2, 6); NaN for single samples."""
    finite = np.isfinite(within)
    halves = np.where(finite, within, 0.0).reshape(2, HALF, -1).sum(1)
    counts = finite.reshape(2, HALF, -1).sum(1)
    return halves.sum(0) / counts.sum(0), halves / counts


def _change(ring: FloatArray, noise: Noise, floor: FloatArray, drift: FloatArray) -> FloatArray:
    """Return by how many variances the means of both halves differ, beyond drift and step, (6,)."""
    change = np.abs(ring[HALF:].mean(0) - ring[:HALF].mean(0)) - drift / 2.0 - np.sqrt(12.0 * floor)
    variance = np.maximum((noise.of_1 + floor) / HALF, noise.of_8)
    return np.asarray(np.maximum(change, 0.0) ** 2 / (2.0 * variance + TINY))


def _is_noise(noise: Noise, floor: FloatArray, sensor: slice, change: FloatArray) -> bool:
    """Tell whether longer means of a sensor's three axes are as quiet as noise makes them."""
    there = noise.present[sensor]
    v1, quiet = (noise.of_1 + floor)[sensor][there], QUIET[sensor][there] ** 2
    scale = 1.0 / np.maximum(v1, quiet)
    for slots, slow in ((4.0, noise.of_4), (8.0, noise.of_8)):
        white = np.maximum(v1 / slots, quiet)
        if (slow[sensor][there] * scale).sum() > COLOUR * (white * scale).sum():
            return False
    return bool(change[sensor][there].sum() <= CHI_SQUARE)


def _is_steady(*powers: FloatArray) -> bool:
    """Tell whether powers in two halves, (2, 3) each, are alike."""
    for power in powers:
        low, high = sorted(np.nansum(power, 1).tolist())
        if high > STEADY * low + TINY:
            return False
    return True


def adopt(state: State, noise: Noise, which: BoolArray) -> None:
    """Take the noise of some axes, (6,), as that of the unit at rest, unless it is known from more data."""
    new = which & noise.present & ~(state.windows.known & noise.is_alike(state))
    of_4, of_8 = np.maximum(noise.of_1 / 4.0, noise.of_4), np.maximum(noise.of_1 / 8.0, noise.of_8)
    start = [noise.of_1, np.maximum(noise.of_1 / 2.0, of_4), of_4, of_8]
    start += [of_8 * NEIGHBOUR**k for k in range(1, LEVELS - 3)]
    windows = state.windows
    windows.known[new] = True
    windows.sample_variance[new] = noise.sample[new]
    windows.quietest[new] = QUIETER * noise.sample[new]
    windows.variance[:, new] = np.array(start)[:, new]
    if new[GYRO].any():
        forget(state, 0.0)
    windows.gain[:, new] = 1.0 / (1.0 + np.maximum(RING / SLOTS, 3.0))[:, np.newaxis]
