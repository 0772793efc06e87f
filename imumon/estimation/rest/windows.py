"""A resting unit tested against the noise it had: means of neighbouring windows of 1, 2, 4 ... 128 slots.

The variance of a mean is learnt from second differences of three windows (a Hadamard variance), in which a
drift cancels; tested are first differences, in which it shows.  What a permitted drift or one step of the
sensor explains of a difference does not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.state import AXES, LEVELS, Slot, State

CHI_SQUARE = 42.0
"""Three axes together: once in 2e8 for Gaussian noise of known variance."""
LONGEST_S = 20.0
"""Longer windows would only see drift."""
QUIET = np.array([3.5e-4, 3.5e-4, 3.5e-4, 4e-3, 4e-3, 4e-3])
"""Standard deviation of a mean below which no noise is suspicious, rad/s (72 deg/h) and m/s² (0.02 deg)."""
COLOUR = 5.0
"""Variance of the means of longer windows may be so many times that of white noise: a hand is slower."""
LEAST_GAIN, MOST_SURPRISE = 1.0 / 64.0, 4.0
TINY = 1e-24

SLOTS = 2 ** np.arange(LEVELS)
_CUTS = SLOTS[:, np.newaxis] * np.arange(4)
_LAGS = np.array([1.0, 2.0])[:, np.newaxis]
_WEIGHTS = np.array([2.0, 3.0])[:, np.newaxis]
"""Of the variance in the difference to the mean one window before, and two before: as old as it is rare."""
_WHITE = 1.0 / SLOTS[:, np.newaxis]


class Motion(NamedTuple):
    """The shortest windows that showed motion: their level and their seconds."""

    level: int
    seconds: float


def seen(state: State, slot: Slot, drift: FloatArray, spike: bool) -> Motion | None:
    """Take the slot that was added last; return the motion that it shows.

    Parameters
    ----------
    drift : array, (6,)
        Permitted, rad/s² and m/s³.
    spike : bool
        Whether a sample was outside the band.
    """
    motion = _windows(state, drift)
    if motion is None and (spike or shaken(state, slot)):
        return Motion(0, slot.seconds)
    return motion


def _windows(state: State, drift: FloatArray) -> Motion | None:
    """Compare the windows that end now with the two before them, and learn from them."""
    history, n = state.history, state.history.length
    quiet = state.quiet_slots
    ending = min((quiet & -quiet).bit_length(), LEVELS)
    cuts = n - _CUTS[:ending]
    seconds = history.seconds[n] - history.seconds[cuts[:, 1]]
    means = history.means(np.maximum(cuts, state.windows_from))
    if seconds[-1] > LONGEST_S:
        ending = int(np.count_nonzero(seconds <= LONGEST_S))
        means, seconds = means[:ending], seconds[:ending]
    if not ending:
        return None
    found = _unlikely(state, means, seconds, drift)
    _learn(state, means)
    if not found.any():
        return None
    level = int(np.argmax(found))
    return Motion(level, float(seconds[level]))


def _unlikely(state: State, means: FloatArray, seconds: FloatArray, drift: FloatArray) -> FloatArray:
    """Tell of each level whether its windows, (k, 3, 6), differ by more than noise, drift and step."""
    allowed = _LAGS * drift * seconds[:, np.newaxis, np.newaxis] + state.resolution
    excess = np.abs(means[:, :1] - means[:, 1:]) - allowed
    excess = np.where(state.known & (excess > 0.0), excess, 0.0)
    chi = excess**2 / (_WEIGHTS * (state.variance[: len(means), np.newaxis] + TINY))
    limit = chi.reshape(len(means), -1, AXES // 2).sum(-1) > CHI_SQUARE
    return np.asarray(limit.any(-1))


def _learn(state: State, means: FloatArray) -> None:
    """Take the second difference as a measure of the variance; a single one cannot raise it much."""
    k = len(means)
    old, gain = state.variance[:k], state.gain[:k]
    second = means[:, 0] - 2.0 * means[:, 1] + means[:, 2]
    sample = np.minimum(second**2 / 6.0, MOST_SURPRISE * old + TINY)
    highest = COLOUR * np.maximum(_WHITE[:k] * state.variance[0], QUIET**2)
    learns = state.known & np.isfinite(second)
    state.variance[:k] = np.where(learns, np.minimum(old + gain * (sample - old), highest), old)
    state.gain[:k] = np.where(learns & (gain > LEAST_GAIN), gain / (1.0 + gain), gain)


def vibration_factor(count: FloatArray) -> FloatArray:
    """Return how many times its mean the variance of count samples may be (Wilson and Hilferty)."""
    part = 2.0 / (9.0 * np.maximum(0.5 * (count - 1.0), 1.0))
    return np.asarray(2.0 * (1.0 - part + 6.0 * np.sqrt(part)) ** 3)


def shaken(state: State, slot: Slot) -> bool:
    """Tell whether samples vary more within the slot than they did at rest."""
    suspect = state.known & (slot.within > 2.0 * state.sample_variance) & (slot.count >= 3)
    if not suspect.any():  # the factor is 2 at least: most slots need no more than this
        return False
    limit = state.sample_variance * vibration_factor(slot.count) + state.resolution**2
    return bool((suspect & (slot.within > limit)).any())
