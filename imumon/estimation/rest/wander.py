"""How far a gyro's mean wanders at rest, and by how much more it moves when a slow turn begins.

Differences of two means of the same length, a lag apart, have a mean square: the structure function of the
bias, noise and all.  It is learnt at rest, for lags of 4 to 128 s.  A difference about the vertical that is
too large for it, and for a bias that creeps, is a turn; one that is not about the vertical would have tilted
the unit, so it is drift.  The same function tells how far a bias can have gone since the last rest.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.state import ACCEL, GYRO, LAGS, WIDTHS, State
from imumon.estimation.rest.windows import CHI_SQUARE, LONGEST_S, MOST_SURPRISE, TINY, Motion

EVERY = 8
"""Slots between two tests."""
LONGEST_LAG_S = 160.0
SIGMAS = 4.0
"""One independent test in 10 s or so: a false alarm in some ten hours of Gaussian noise; it costs 16 s."""
OBLIQUE = 0.3
"""Share of a difference across the vertical that no misalignment or tilt of a turntable explains (17°)."""
PERHAPS = 0.75
"""Share of the limit, three standard deviations, from which on a difference may be a turn: it stays rest, and
the whole difference is the hypothesis."""
CREEP = 2e-5
"""rad/s²: 70 °/h/°C at 2 °C/min is 1.1e-5; more than this, about the vertical alone, is a turn."""
ALL_CREEP = 10.0
"""What makes a bias creep, temperature, has all axes creep: one by more than ten times what both others do,
in one unit of a hundred where each of them may have any part of the slope of the first."""
PRIOR_LAGS, MOST_LAGS = 4.0, 32.0
"""Lags that an expectation is worth against what was learnt, and that are remembered."""
WIDER, FARTHER = 0.75, 1.2
"""What the mean square at a lag is expected to be, over that at half of it: for means twice as long, and for
such as long.  White noise has 1/2 and 1, flicker 1 and 1.2, a random walk 2 and 2."""
_ENDS = np.stack([0 * LAGS, WIDTHS, LAGS, LAGS + WIDTHS], axis=1)
_LEVELS = np.log2(WIDTHS).astype(int)
_GROWTH = np.where(np.diff(WIDTHS) > 0, WIDER, FARTHER)


def mean_squares(state: State) -> FloatArray:
    """Return the mean square of the differences at each lag, (lags, 3).

    What was learnt is weighed against what the next shorter lag, and at first white noise, lets expect.
    """
    known = state.wander_lags[:, np.newaxis]
    expected = 2.0 * state.windows.variance[_LEVELS[0], GYRO]
    squares = np.empty_like(state.wander)
    for k, learnt in enumerate(state.wander):
        squares[k] = (PRIOR_LAGS * expected + known[k] * learnt) / (PRIOR_LAGS + known[k])
        expected = squares[k] * _GROWTH[min(k, len(_GROWTH) - 1)]
    return squares


def wanders(state: State) -> Motion | None:
    """Tell whether a recent mean is too far from one before it, or may be, and learn how far they go."""
    n, windows = state.length, state.windows
    which = np.flatnonzero(state.quiet_slots >= LAGS + WIDTHS)
    ends = windows.seconds[n - _ENDS[which]]
    lag_s, width_s = ends[:, 0] - ends[:, 2], ends[:, 0] - ends[:, 1]
    short = (lag_s <= LONGEST_LAG_S) & (width_s <= LONGEST_S)
    which, lag_s = which[short], lag_s[short]
    if not len(which):
        return None
    means = state.means(n - _ENDS[which])[..., GYRO]
    state.squares = mean_squares(state)
    off, square = means[:, 0] - means[:, 2], state.squares[which]
    lags = state.wander_lags[which]
    limit2 = SIGMAS**2 * square * (1.0 + 2.0 / (PRIOR_LAGS + lags))[:, np.newaxis] + TINY
    ratio = turned(state, off, limit2, CREEP * lag_s)
    more = state.span_s(EVERY) / lag_s
    sample = np.fmin(off * off, MOST_SURPRISE * square)
    state.wander[which] += (more / (lags + more))[:, np.newaxis] * (sample - state.wander[which])
    state.wander_lags[which] = np.minimum(lags + more, MOST_LAGS)
    if not (ratio > PERHAPS).any():
        return None
    certain = bool((ratio > 1.0).any())
    shortest, clearest = which[np.argmax(ratio > (1.0 if certain else PERHAPS))], which[np.argmax(ratio)]
    before = (int(LAGS[clearest]), int(LAGS[clearest] + WIDTHS[clearest]))
    width = int(WIDTHS[shortest])
    return Motion(width.bit_length() - 1, state.span_s(width), False, before, turning=True, certain=certain)


def turned(state: State, off: FloatArray, limit2: FloatArray, creep: FloatArray) -> FloatArray:
    """Return how many times the limit differences of gyros, (k, 3), are beyond a creeping bias, (k,).

    Where gravity is known, about the vertical: what is oblique is drift, for gravity would have moved, and
    counts as zero.

    Parameters
    ----------
    limit2 : array, (k, 3)
        Squares of the limits of each axis.
    creep : array, (k,)
        By how much a bias may have crept, rad/s.
    """
    known = state.windows.known
    off = np.where(known[GYRO] & np.isfinite(off), off, 0.0)
    if not known.all():
        excess = np.maximum(np.abs(off) - creep[:, np.newaxis] - state.resolution[GYRO], 0.0)
        return np.asarray(np.sqrt((excess**2 / limit2).sum(-1)) * (5.0 / np.sqrt(CHI_SQUARE)))
    force = state.windows.rest_mean[ACCEL]
    up = force / np.sqrt(force @ force)
    along = np.abs(off @ up)
    across2 = np.maximum((off * off).sum(1) - along * along, 0.0)
    vertical = across2 < np.maximum((OBLIQUE * along) ** 2, limit2.max(1))
    crept = np.minimum(creep, ALL_CREEP * np.sqrt(across2))
    ratio = (along - crept - np.abs(up) @ state.resolution[GYRO]) / np.sqrt(limit2 @ up**2)
    return np.where(vertical, ratio, 0.0)


def wander_after(state: State, seconds: float) -> FloatArray:
    """Return the mean square by which each gyro's mean may differ after a time, (3,).

    Beyond the longest lag it grows as between flicker and walk.
    """
    lags_s, squares = LAGS * state.slot_s, state.squares
    k = int(np.searchsorted(lags_s, min(max(seconds, lags_s[0]), lags_s[-1])))
    return np.asarray(squares[k] * max(seconds / lags_s[k], 1.0) ** 0.5)
