"""A resting unit tested against the noise it had: means of neighbouring windows of 1, 2, 4 ... 128 slots.

The variance of a mean is learnt from second differences of three windows (a Hadamard variance), in which a
drift cancels; tested are first differences, in which it shows.  What a permitted drift or one step of the
sensor explains of a difference does not count.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.state import ACCEL, AXES, GYRO, LEVELS, BoolArray, Slot, State

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
BEND_FROM = 2
BEND_S = 600.0
"""A drift as large as permitted builds up in no less: a case takes minutes to follow a temperature."""
BEND_SIGMAS = 5.0
"""One test a second of one quantity: a false alarm in some hundred hours of Gaussian noise."""
OBLIQUE = 0.3
"""Share of a difference across the vertical that no misalignment or tilt of a turntable explains (17°)."""
CREEP = 2e-5
"""rad/s²: 70 °/h/°C at 2 °C/min is 1.1e-5; more than this, about the vertical alone, for 96 s is a turn."""
MOST_WITHIN = np.array([3.5e-2, 3.5e-2, 3.5e-2, 0.5, 0.5, 0.5])
"""rad/s and m/s², rms: more vibration is motion.  2 °/s and 0.5 m/s² are the limits of VQF's rest detection
(Laidig and Seel 2023, restThGyr and restThAcc); an engine that idles stays at a third of them."""

SLOTS = 2 ** np.arange(LEVELS)
_CUTS = SLOTS[:, np.newaxis] * np.arange(4)
_BEND_CUTS = SLOTS[:, np.newaxis] * np.array([0, 1, 4, 7])
_LAGS = np.array([1.0, 2.0])[:, np.newaxis]
_WEIGHTS = np.array([2.0, 3.0])[:, np.newaxis]
"""Of the variance in the difference to the mean one window before, and two before: as old as it is rare."""
_WHITE = 1.0 / SLOTS[:, np.newaxis]


BEFORE = (2, 3)


class Motion(NamedTuple):
    """The shortest windows that showed motion: their level and their seconds.

    sudden tells whether a sample or the vibration showed it as well; before is where, in such windows, the
    latest begins and ends that was rest still.
    """

    level: int
    seconds: float
    sudden: bool = False
    before: tuple[int, int] = BEFORE


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
    if spike or shaken(state, slot):
        return Motion(0, slot.seconds, sudden=True) if motion is None else motion._replace(sudden=True)
    return motion


def bends(state: State, drift: FloatArray) -> Motion | None:
    """Tell whether the latest window of the gyros lies off the line through the six such windows before it.

    So a turn about the vertical shows that begins more slowly than a bias may drift; what is not about the
    vertical is drift, or the accelerometers show it.  Of windows of length L with centres at -L/2, -2.5 L
    (three of them) and -5.5 L the line predicts m₂ + ⅔ (m₂ - m₁), with a variance of ²⁹⁄₉ times that of the
    mean of three; a curvature c puts it off by 4.67 c L².
    """
    history, n = state.history, state.history.length
    levels = min(int(np.count_nonzero(state.quiet_slots >= 7 * SLOTS)), LEVELS - 1)
    if levels <= BEND_FROM:
        return None
    which = slice(BEND_FROM, levels)
    cuts = n - _BEND_CUTS[which]
    seconds = history.seconds[cuts[:, 0]] - history.seconds[cuts[:, 1]]
    recent, middle, oldest = np.moveaxis(history.means(cuts)[..., GYRO], 1, 0)
    off = recent - middle - (middle - oldest) * (2.0 / 3.0)
    variance = state.variance[which, GYRO] + (29.0 / 9.0) * state.variance[BEND_FROM + 1 : levels + 1, GYRO]
    allowed = (4.67 / BEND_S) * drift[0] * seconds**2
    found = turned(state, off, variance + TINY, allowed) & (seconds <= LONGEST_S)
    if found.any():
        level = BEND_FROM + int(np.argmax(found))
        return Motion(level, float(history.seconds[n] - history.seconds[n - SLOTS[level]]), before=(4, 7))
    return None


def turned(state: State, off: FloatArray, variance: FloatArray, allowed: FloatArray) -> BoolArray:
    """Tell whether differences of gyros, (k, 3), are too large for noise and what is allowed, (k,).

    Where gravity is known, about the vertical: what is oblique is drift, for gravity would have moved.
    """
    off = np.where(state.known[GYRO], off, 0.0)
    force = state.rest_mean[ACCEL]
    if not state.known.all():
        excess = np.maximum(np.abs(off) - allowed[:, np.newaxis] - state.resolution[GYRO], 0.0)
        return np.asarray((excess**2 / variance).sum(-1) > CHI_SQUARE)
    up = force / np.linalg.norm(force)
    along = np.abs(off @ up)
    across = np.linalg.norm(off - (off @ up)[:, np.newaxis] * up, axis=1)
    vertical = across < np.maximum(OBLIQUE * along, BEND_SIGMAS * np.sqrt(variance.max(1)))
    beyond = along - allowed - np.abs(up) @ state.resolution[GYRO] > BEND_SIGMAS * np.sqrt(variance @ up**2)
    return np.asarray(vertical & beyond)


def creeps(state: State) -> Motion | None:
    """Tell whether the gyros' mean of the last 16 s is farther from that of 96 s before than a bias creeps.

    So a turn shows that begins too slowly for `bends` in the noise of a cheap gyro.
    """
    history, n, slots = state.history, state.history.length, int(SLOTS[-1])
    if state.quiet_slots < 7 * slots:
        return None
    cuts = n - slots * np.array([[0, 1], [6, 7]])
    recent, oldest = history.means(cuts)[:, 0, GYRO]
    seconds = history.seconds[n] - history.seconds[cuts[1, 0]]
    found = turned(
        state,
        (recent - oldest)[np.newaxis],
        2.0 * state.variance[-1:, GYRO] + TINY,
        CREEP * seconds[np.newaxis],
    )
    if not found[0]:
        return None
    return Motion(LEVELS - 1, float(history.seconds[n] - history.seconds[n - slots]), before=(6, 7))


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
    most = slot.within > MOST_WITHIN**2
    if not (suspect | most).any():  # the factor is 2 at least: most slots need no more than this
        return False
    if most.any():
        return True
    limit = state.sample_variance * vibration_factor(slot.count) + state.resolution**2
    return bool((suspect & (slot.within > limit)).any())
