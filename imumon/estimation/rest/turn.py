"""Does it turn steadily, or has the bias changed?  Both make a gyro's mean differ from that of the last rest.

While nothing decides, the difference is the hypothesis of a turn: it is no rest, and the bias may be off by
as much.  What decides: a difference that a bias may have (drift and walk since, g-sensitivity, the earth rate
from the other side) is bias, and so is one that is not about the vertical although gravity stays where it is;
a magnetometer, or the device's own yaw, that turns along says turn, and one that stays says bias.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import ACCEL, GYRO, LEVELS, SLOT_S, State
from imumon.estimation.rest.windows import (
    BEND_SIGMAS,
    CHI_SQUARE,
    CREEP,
    MEMORY_SLOTS,
    OBLIQUE,
    SLOTS,
    TINY,
    turned,
)

EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0
STEADY_SIGMAS = 3.0


def hypothesis(
    state: State, parameters: RestParameters, recent: FloatArray, slots: FloatArray, now_s: float
) -> FloatArray:
    """Return the rate of the turn that the gyros show if their bias is still that of the last rest, (3,).

    Parameters
    ----------
    recent, slots : array, (6,)
        Recent means, and how many slots they are of; 0 for an axis that is missing.

    Returns
    -------
    array, (3,)
        rad/s; zero where the bias can have changed by as much.
    """
    if not state.anchored:
        return np.zeros(3)
    there = state.windows.known & (slots > 0)
    change = np.where(there, recent - state.anchor, 0.0)
    noise = SIGMAS * np.sqrt(
        state.windows.variance[0] / np.clip(slots, 1, MEMORY_SLOTS) + state.anchor_variance
    )
    noise += state.resolution
    force = float(np.linalg.norm(change[ACCEL]))
    allowed = EARTH_TWICE + parameters.gyro_g_sensitivity * force + _walk(state, parameters, now_s)
    turn, noise = change[GYRO], noise[GYRO]
    if (np.abs(turn) <= allowed + noise).all() or _is_bias(state, parameters, turn, noise, recent[ACCEL]):
        return np.zeros(3)
    return turn


def _walk(state: State, parameters: RestParameters, now_s: float) -> FloatArray:
    """Return by how much each bias may have changed since the last rest, (3,), whatever the temperature does.

    It drifts, but no farther than `gyro_walk`, or than the noise of its means of 16 s lets expect.
    """
    elapsed = max(now_s - state.anchor_s, 0.0)
    longest_s = SLOT_S * SLOTS[-1]
    learnt = SIGMAS * np.sqrt(state.windows.variance[-1][GYRO] * elapsed / longest_s)
    most = np.clip(learnt, parameters.gyro_walk, 2.0 * parameters.gyro_walk)
    return np.asarray(np.minimum(parameters.gyro_drift * elapsed, most))


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
    return tilt > max(OBLIQUE * size, float(least), float(noise.max()))


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
    small = variance[np.newaxis, GYRO] / BEND_SIGMAS**2 + TINY
    return not turned(state, change[np.newaxis, GYRO], small, np.array([CREEP * seconds]))[0]
