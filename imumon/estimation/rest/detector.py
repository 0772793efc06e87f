"""Slot by slot: is the unit at rest?

Rest is found by a trial of 32 slots (`trial`), kept while windows of all lengths agree (`windows`), and found
again after motion as soon as it is quiet by the noise of the rest before and no gyro has another mean.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import ACCEL, AXES, GYRO, LEVELS, Slot, State
from imumon.estimation.rest.trial import RING, Noise, adopt, look
from imumon.estimation.rest.windows import MOST_SURPRISE, TINY, Motion, seen

SLOT_S = 0.125
GAP_S = 2.5
SETTLE_S = 1.0
SETTLE_SLOTS = 8
TRIAL_EVERY = 4
"""Slots between two trials, while there is need of one."""
HOLD_WINDOWS = 4.0
"""What showed only in windows of some length is watched for so many of them before it is rest again."""
MEMORY_SLOTS = 32
BAND_EVERY = 4
SAMPLE_MEMORY = 1.0 / 64.0
SPIKE_SIGMAS = 7.0
EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0
KNOCK = Motion(0, 0.0)


def begin(state: State, now_s: float, other: bool) -> None:
    """Begin anew at a time: the noise survives; the mean of the last rest survives a gap, no restart."""
    if state.at_rest:
        _leave(state, KNOCK, now_s)
    if other:
        state.anchored, state.doubted_since_s = False, np.nan
    state.ring_from = state.history.length
    state.long_hold_s = now_s
    state.last = np.full(AXES, np.nan)
    _watch(state, now_s, 0.0)


def step(state: State, parameters: RestParameters, slot: Slot) -> None:
    """Take a slot and decide."""
    drift = parameters.drift
    state.add(slot)
    present = state.known & (slot.count > 0)
    if present.any():
        spike = state.at_rest and bool(((slot.smallest < state.low) | (slot.largest > state.high)).any())
        motion = seen(state, slot, drift, spike)
        if motion is not None:
            if state.at_rest:
                _leave(state, motion, slot.end_s)
            _watch(state, slot.end_s, HOLD_WINDOWS * motion.seconds)
        elif state.at_rest:
            _keep(state, slot, drift)
        elif slot.end_s >= state.hold_s and state.quiet_slots >= SETTLE_SLOTS:
            _return(state, parameters, slot.end_s)
    state.slots += 1
    ready = state.history.length - state.ring_from >= RING and slot.end_s >= state.long_hold_s
    if ready and state.slots % TRIAL_EVERY == 0:
        _try(state, parameters, slot.end_s)


def _watch(state: State, now_s: float, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    state.hold_s = now_s + max(seconds, SETTLE_S)
    if seconds > SETTLE_S:
        state.long_hold_s = state.hold_s
    state.windows_from = state.history.length


def _leave(state: State, motion: Motion, now_s: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    older = np.full(AXES, np.nan)
    if motion.level > 2:
        n, slots = state.history.length, 2**motion.level
        older = state.history.means(np.maximum(np.array([n - slots, n - 2 * slots]), state.windows_from))[0]
    state.anchor = np.where(np.isfinite(older), older, state.rest_mean)
    state.anchor_variance = state.variance[min(motion.level + 2, LEVELS - 1)].copy()
    state.anchored, state.anchor_s = True, now_s - HOLD_WINDOWS * motion.seconds
    state.low, state.high = np.full(AXES, -np.inf), np.full(AXES, np.inf)
    state.at_rest, state.doubted_since_s = False, np.nan
    state.ring_from = state.history.length


def _keep(state: State, slot: Slot, drift: FloatArray) -> None:
    """At rest still: follow the mean and the noise."""
    present = state.known & (slot.count > 0)
    share = 1.0 / min(max(state.quiet_slots, 1), MEMORY_SLOTS)
    mean = np.where(present, slot.mean, state.rest_mean)
    state.rest_mean = state.rest_mean + share * (mean - state.rest_mean)
    within = np.where(np.isfinite(slot.within), slot.within, state.variance[0])
    within = np.minimum(within, MOST_SURPRISE * state.sample_variance + TINY)
    change = np.where(present, within - state.sample_variance, 0.0)
    state.sample_variance = state.sample_variance + SAMPLE_MEMORY * change
    if state.slots % BAND_EVERY == 0:
        _set_band(state, drift)


def _set_band(state: State, drift: FloatArray) -> None:
    """Set the band outside which a single sample is motion."""
    sd = np.sqrt(state.sample_variance + state.variance[0])
    width = SPIKE_SIGMAS * sd + 1.5 * state.resolution + drift * (MEMORY_SLOTS * SLOT_S)
    width = np.where(state.known, width, np.inf)
    state.low, state.high = state.rest_mean - width, state.rest_mean + width


def _enter(state: State, means: FloatArray, drift: FloatArray) -> None:
    state.rest_mean = means
    state.at_rest, state.doubted_since_s = True, np.nan
    _set_band(state, drift)


def _return(state: State, parameters: RestParameters, now_s: float) -> None:
    """Quiet for long enough by the noise of the last rest: rest again, unless it still turns."""
    means, count = state.history.latest(state.quiet_slots)
    slots = np.where(count > 0, state.quiet_slots, 0)
    means = np.where(count > 0, means, state.rest_mean)
    if displacement(state, parameters, means, slots, now_s) <= 0.0:
        _enter(state, means, parameters.drift)


def displacement(
    state: State, parameters: RestParameters, means: FloatArray, slots: IntArray, now_s: float
) -> float:
    """Return how far a gyro's mean is from that of the last rest, beyond what its bias can have done.

    means and numbers of slots, (6,); rad/s.
    """
    if not state.anchored:
        return 0.0
    there = state.known & (slots > 0)
    change = np.where(there, means - state.anchor, 0.0)
    allowed = EARTH_TWICE + parameters.gyro_g_sensitivity * float(np.linalg.norm(change[ACCEL]))
    allowed += parameters.gyro_drift * max(now_s - state.anchor_s, 0.0)
    variance = state.variance[0] / np.clip(slots, 1, MEMORY_SLOTS) + state.anchor_variance
    beyond = np.abs(change) - allowed - SIGMAS * np.sqrt(variance) - state.resolution
    return float(np.where(there, beyond, 0.0)[GYRO].max(initial=0.0))


def _try(state: State, parameters: RestParameters, now_s: float) -> None:
    """Look for rest by another noise than that of the last, or of an axis of which nothing is known."""
    n = state.history.length
    unknown = ~state.known & np.isfinite(state.history.mean[n - RING : n]).all(0)
    if state.at_rest and not unknown.any():
        return
    noise = look(state, parameters.drift)
    if not noise.rests:
        state.doubted_since_s = np.nan
        if state.at_rest:
            _leave(state, KNOCK, now_s)
            _watch(state, now_s, 0.0)
        return
    means = np.where(noise.present, noise.mean, state.rest_mean)
    if state.at_rest:
        state.rest_mean = np.where(state.known, state.rest_mean, means)
        adopt(state, noise, ~state.known)
    elif not _doubtful(state, parameters, noise, means, now_s):
        adopt(state, noise, noise.present)
        _enter(state, means, parameters.drift)
        _watch(state, now_s, 0.0)


def _doubtful(
    state: State, parameters: RestParameters, noise: Noise, means: FloatArray, now_s: float
) -> bool:
    """Tell whether the means are too far from those of the last rest to be its bias, and for how long."""
    if np.isnan(state.doubted_since_s):
        state.doubted_since_s = now_s
    beyond = displacement(state, parameters, means, RING * noise.present.astype(np.int64), now_s)
    doubted = now_s - state.doubted_since_s >= parameters.doubt_s
    return beyond > 0.0 and not (doubted and beyond <= parameters.largest_jump)
