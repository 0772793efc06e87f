"""Does it turn steadily, or has the bias changed?  Both make a gyro's mean differ from that of the last rest.

While nothing decides, the difference is the hypothesis of a turn: it is no rest, and the bias may be off by
as much.  What decides: a difference that a bias may have (drift and walk since, g-sensitivity, the earth rate
from the other side) is bias, and so is one that is not about the vertical although gravity stays where it is;
a magnetometer, or the device's own yaw, that turns along says turn, and one that stays says bias.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import ACCEL, GYRO, KEPT, LEVELS, SLOT_S, Anchor, State
from imumon.estimation.rest.wander import CREEP, OBLIQUE, turned, wander_after
from imumon.estimation.rest.windows import CHI_SQUARE, MEMORY_SLOTS, SLOTS, TINY

EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0
STEADY_SIGMAS = 3.0
PLAIN_SIGMAS = 2.0
"""Sigmas of a change of which nobody would ask whether it is a turn."""
BACK_SIGMAS = 3.0
BACK_S, SLOW_BACK_S = 0.25, 4.0
TILTED = 0.05
"""m/s² (0.3°): less change of the specific force from rest to rest is drift of the accelerometers."""


class Explained(Enum):
    """Whether a bias may have changed as the gyros' mean has since an earlier rest."""

    NO = 0
    PERHAPS = 1
    PLAINLY = 2


def hypothesis(
    state: State, parameters: RestParameters, slots: int, now_s: float
) -> tuple[FloatArray, Explained]:
    """Return the rate of the turn that the gyros show if their bias is still that of the last rest, (3,).

    Parameters
    ----------
    slots : int
        The latest, which are quiet.

    Returns
    -------
    array, (3,)
        rad/s; where it is plainly the bias that has changed, what was the hypothesis in that rest, or zero.
    Explained
        Whether the bias can have changed by as much.
    """
    if not state.anchors:
        return np.zeros(3), Explained.PLAINLY
    recent, variance = recent_mean(state, slots)
    # It is while the unit moved that a turn began, or the bias changed: a steady mean does neither.
    since_s = min(state.quiet_since_s, now_s - state.span_s(slots))
    turn = state.anchors[0].turn_now(recent)
    limit = SIGMAS * np.sqrt(variance + state.anchors[0].variance) + state.resolution
    wander = SIGMAS * np.sqrt(wander_after(state, now_s - state.anchors[0].at_s))
    if _is_bias(state, parameters, turn, np.maximum(limit[GYRO], wander), recent[ACCEL]):
        return np.zeros(3), Explained.PLAINLY
    if _turns_on(state, recent, limit):
        return turn, Explained.NO
    best = Explained.NO
    for anchor in state.anchors:
        found = _explained(state, parameters, anchor, recent, variance, since_s)
        if found is Explained.PLAINLY:
            return anchor.turn, found
        best = max(best, found, key=lambda one: one.value)
    return turn, best


def _explained(
    state: State,
    parameters: RestParameters,
    anchor: Anchor,
    recent: FloatArray,
    variance: FloatArray,
    since_s: float,
) -> Explained:
    """Tell whether the bias may have changed from an earlier rest to a mean that has been since a time."""
    change = np.abs(np.where(np.isfinite(recent), recent - anchor.mean, 0.0))
    noise = variance + anchor.variance
    moved_s = max(since_s - anchor.at_s, 0.0)
    force = float(np.linalg.norm(change[ACCEL]))
    still = state.windows.known[ACCEL].all() and force < SIGMAS * np.sqrt(noise[ACCEL].max()) + TILTED
    slope = CREEP if still else parameters.gyro_drift
    wander = np.sqrt(np.maximum(wander_after(state, moved_s), noise[GYRO]))
    plain = parameters.gyro_g_sensitivity * force + (0.0 if still else EARTH_TWICE) + state.resolution[GYRO]
    drift = min(slope * moved_s, parameters.gyro_walk)
    if not still:
        plain += drift
    usual, most = PLAIN_SIGMAS * wander, SIGMAS * wander
    if (change[GYRO] <= np.minimum(usual, parameters.gyro_walk) + plain).all():
        return Explained.PLAINLY
    if (change[GYRO] <= np.minimum(most, 2.0 * parameters.gyro_walk) + plain + drift).all():
        return Explained.PERHAPS if still else Explained.PLAINLY
    return Explained.NO


def is_back(state: State, parameters: RestParameters, now_s: float) -> Anchor | None:
    """Return the earlier rest of which all means are again what they were.

    For a quarter of a second after a knock, and for 4 s after what showed slowly.
    """
    slots = state.quiet_slots
    least_s = SLOW_BACK_S if state.slow else BACK_S
    if state.span_s(min(slots, KEPT)) < least_s:
        return None
    recent, variance = recent_mean(state, slots)
    for anchor in state.anchors:
        limit = BACK_SIGMAS * np.sqrt(variance + anchor.variance) + state.resolution
        limit[ACCEL] += min(parameters.accel_drift * (now_s - anchor.at_s), TILTED)
        change = np.abs(np.where(np.isfinite(recent), recent - anchor.mean, 0.0))
        refuted = not state.slow or _over(state.turn, change[GYRO])
        if refuted and (change <= limit).all():
            return anchor
    return None


def still_off(state: State) -> FloatArray:
    """Return the turn that it may be by the latest mean at rest, (3,).

    The most that it has been; zero when it is over.  It is about the vertical: another would have tilted the
    unit.
    """
    turn = upright(state, state.anchors[0].turn_now(recent_mean(state, state.quiet_slots)[0]))
    if _over(state.turn, turn):
        return np.zeros(3)
    return turn if turn @ turn > state.turn @ state.turn else state.turn


def upright(state: State, turn: FloatArray) -> FloatArray:
    """Return the part of a turn, (3,), that is about the vertical; all of it where gravity is not known."""
    force = state.windows.rest_mean[ACCEL]
    if not state.windows.known[ACCEL].all():
        return turn
    return np.asarray((turn @ force) * force / (force @ force))


def _over(turn: FloatArray, change: FloatArray) -> bool:
    """Tell whether what is left of a turn is so little that it has ended."""
    return bool(3.0 * np.abs(change).max() < np.abs(turn).max())


def recent_mean(state: State, slots: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the latest slots, of 8 s at most, and its variance at rest, (6,)."""
    slots = min(slots, steady_slots(state) // 2)
    mean, count = state.latest(slots)
    there = state.windows.known & (count > 0)
    return np.where(there, mean, np.nan), state.windows.variance[slots.bit_length() - 1]


def _turns_on(state: State, recent: FloatArray, limit: FloatArray) -> bool:
    """Tell whether something disturbed a turn, and the mean is what it was before: no turn ends like that."""
    if not np.isfinite(state.steady).any():
        return False
    between_s = max(state.quiet_since_s - state.steady_s, 0.0)
    near, far = (np.abs(recent - mean)[GYRO] for mean in (state.steady, state.anchors[0].mean))
    same = (near <= limit[GYRO] + CREEP * between_s) | ~np.isfinite(near)
    return bool(same.all() and np.nansum(near) < np.nansum(far))


def _is_bias(
    state: State, parameters: RestParameters, turn: FloatArray, noise: FloatArray, force: FloatArray
) -> bool:
    """Tell whether a turn like this would have tilted the unit, and gravity says that it has not."""
    size, gravity = float(np.linalg.norm(turn)), float(np.linalg.norm(force))
    window = steady_slots(state) // 4
    seen = state.windows.known[ACCEL].all() and gravity > 5.0 and state.quiet_slots >= 2 * window
    if not seen or size > parameters.largest_jump:
        return False
    across = turn - (turn @ force) * force / gravity**2
    tilt = float(np.linalg.norm(across))
    # What accelerometers show in two windows of 4 s, by the limits of `windows`, or their drift would hide.
    level, seconds = window.bit_length() - 1, state.span_s(window)
    shown = (
        np.sqrt(2.0 * CHI_SQUARE * state.windows.variance[level, ACCEL].max()) + state.resolution[ACCEL].max()
    )
    least = (shown + parameters.accel_drift * seconds) / (gravity * seconds)
    wander = float(np.linalg.norm(across * noise))
    return tilt > max(OBLIQUE * size, float(least)) and tilt * tilt > wander


def steady_slots(state: State) -> int:
    """Return how many slots take 16 s, as a power of two; a slot is a sample at low rates."""
    slot_s = state.span_s(min(MEMORY_SLOTS, state.length)) / MEMORY_SLOTS
    longer = round(float(np.log2(max(slot_s / SLOT_S, 1.0))))
    return int(SLOTS[max(LEVELS - 1 - longer, 3)])


def is_steady(state: State, parameters: RestParameters) -> bool:
    """Tell whether the means of the last 8 s are those of the 8 s before, but for noise and a creeping bias.

    Of 4 s after motion that was no turn about the vertical: it would tilt the unit, and gravity shows that.
    """
    half = steady_slots(state) // (2 if state.turning else 4)
    level = half.bit_length() - 1
    if state.quiet_slots < 2 * half:
        return False
    recent, before = state.means(state.length - half * np.arange(3))
    seconds = state.span_s(half)
    change, variance = recent - before, 2.0 * STEADY_SIGMAS**2 * state.windows.variance[level]
    limit = np.sqrt(variance) + state.resolution + parameters.accel_drift * seconds
    if (state.windows.known & (np.abs(change) > limit))[ACCEL].any():
        return False
    times = turned(
        state, change[np.newaxis, GYRO], variance[np.newaxis, GYRO] + TINY, np.array([CREEP * seconds])
    )
    return bool(times[0] <= 1.0)
