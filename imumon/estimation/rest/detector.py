"""Slot by slot: is the unit at rest?

Rest is found by a trial of 32 slots (`trial`), kept while windows of all lengths agree (`windows`), and found
again after motion as soon as it is quiet by the noise of the rest before and no gyro has another mean.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.compass import Verdict, verdict
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import AXES, GYRO, LEVELS, SLOT_S, Slot, State
from imumon.estimation.rest.trial import RING, Noise, adopt, look
from imumon.estimation.rest.turn import MEMORY_SLOTS, hypothesis, is_steady, steady_slots
from imumon.estimation.rest.windows import BEFORE, MOST_SURPRISE, TINY, Motion, bends, creeps, seen

GAP_S = 2.5
SETTLE_S = 1.0
SETTLE_SLOTS = 8
TRIAL_EVERY = 4
"""Slots between two trials, while there is need of one."""
HOLD_WINDOWS = 4.0
"""What showed only in windows of some length is watched for so many of them before it is rest again."""
BAND_EVERY = 4
SAMPLE_MEMORY = 1.0 / 64.0
SPIKE_SIGMAS = 7.0
BEND_EVERY = 8
SHORT_REST_S, MOST_CAUTION = 20.0, 8.0
"""A rest shorter than this that ends slowly was none, perhaps: the next is watched for twice as long."""
LONGEST_HOLD_S = 8.0
"""A turn that was steady is watched for no longer: its mean says when it ends."""
KNOCK = Motion(0, 0.0, sudden=True)


def begin(state: State, now_s: float, other: bool) -> None:
    """Begin anew at a time: the noise survives; the mean of the last rest survives a gap, no restart."""
    if state.at_rest:
        _leave(state, KNOCK, now_s)
    if other:
        state.anchored, state.doubted_since_s = False, np.nan
        state.turn = np.zeros(3)
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
        if motion is None and state.at_rest and state.slots % BEND_EVERY == 0:
            motion = bends(state, drift) or creeps(state)
        if motion is not None:
            if state.at_rest:
                _leave(state, motion, slot.end_s)
            _watch(state, slot.end_s, HOLD_WINDOWS * motion.seconds)
        elif state.at_rest:
            _keep(state, slot, drift)
        elif slot.end_s >= state.hold_s and _may_return(state):
            _return(state, parameters, slot.end_s)
    state.slots += 1
    ready = state.history.length - state.ring_from >= RING and slot.end_s >= state.long_hold_s
    seldom = 4 if state.turning and state.quiet_slots > RING else 1
    if ready and state.slots % (seldom * TRIAL_EVERY) == 0:
        _try(state, parameters, slot.end_s)


def _may_return(state: State) -> bool:
    """Tell whether it has been quiet for long enough; what is in doubt for long is not asked every time."""
    quiet = state.quiet_slots
    return SETTLE_SLOTS <= quiet < RING or (quiet >= RING and state.slots % TRIAL_EVERY == 0)


def _watch(state: State, now_s: float, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    hold_s = state.caution * max(seconds, SETTLE_S)
    state.hold_s = now_s + (min(hold_s, LONGEST_HOLD_S) if state.turning else hold_s)
    if seconds > SETTLE_S:
        state.long_hold_s = state.hold_s
    state.windows_from = state.history.length


def _leave(state: State, motion: Motion, now_s: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    n, slots = state.history.length, 2**motion.level
    older = np.full(AXES, np.nan)
    if motion.level > 2:
        cuts = n - slots * np.array(motion.before)
        older = state.history.means(np.maximum(cuts, state.windows_from))[0]
    state.anchor = np.where(np.isfinite(older), older, state.rest_mean)
    state.anchor_variance = state.variance[min(motion.level + 2, LEVELS - 1)].copy()
    state.anchored, state.anchor_s = True, now_s - HOLD_WINDOWS * motion.seconds
    if not motion.sudden:  # the bias may have followed what moved slowly
        recent = state.history.latest(slots)[0]
        state.turn = np.where(state.known & np.isfinite(recent), recent - state.anchor, 0.0)[GYRO]
    long = now_s - state.rest_since_s > SHORT_REST_S
    state.caution = 1.0 if long else min((1.0 if motion.sudden else 2.0) * state.caution, MOST_CAUTION)
    state.turning = motion.before != BEFORE
    state.slow = state.turning or state.caution > 1.0
    state.low, state.high = np.full(AXES, -np.inf), np.full(AXES, np.inf)
    state.at_rest, state.doubted_since_s = False, np.nan
    state.ring_from = n


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


def _enter(state: State, means: FloatArray, drift: FloatArray, now_s: float) -> None:
    state.rest_mean, state.rest_since_s = means, now_s
    state.at_rest, state.doubted_since_s, state.turn = True, np.nan, np.zeros(3)
    _set_band(state, drift)


def _return(state: State, parameters: RestParameters, now_s: float) -> None:
    """Quiet for long enough by the noise of the last rest: rest again, unless it still turns."""
    slots = min(state.quiet_slots, MEMORY_SLOTS)
    means, count = state.history.latest(slots)
    means = np.where(count > 0, means, state.rest_mean)
    if not _turns(state, parameters, means, np.where(count > 0, float(slots), 0.0), now_s):
        # What was before the mean became constant is no rest to compare with.
        state.windows_from = max(state.windows_from, state.history.length - steady_slots(state))
        _enter(state, means, parameters.drift, now_s)


def _turns(
    state: State,
    parameters: RestParameters,
    means: FloatArray,
    slots: FloatArray,
    now_s: float,
    fits: bool = True,
) -> bool:
    """Tell whether a unit that is quiet may be turning still; its rate is the hypothesis from now on.

    Motion that begins or ends so slowly that only the mean shows it has ended when the mean is constant; by a
    noise that no longer fits nothing is, and the trial has judged that.
    """
    turn = hypothesis(state, parameters, means, slots, now_s)
    if turn.any():
        said = verdict(state, turn)
        state.turn = turn if said is Verdict.UNDECIDED else np.zeros(3)
        state.turning = said is not Verdict.RESTS
        return state.turning
    slow = state.slow or state.quiet_slots >= steady_slots(state) // 2
    return state.anchored and slow and fits and not is_steady(state, parameters)


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
        _enter(state, means, parameters.drift, now_s)
        _watch(state, now_s, 0.0)


def _doubtful(
    state: State, parameters: RestParameters, noise: Noise, means: FloatArray, now_s: float
) -> bool:
    """Tell whether the means are too far from those of the last rest to be its bias, and for how long."""
    if np.isnan(state.doubted_since_s):
        state.doubted_since_s = now_s
    slots = np.where(noise.present, float(RING), 0.0)
    if not _turns(state, parameters, means, slots, now_s, state.quiet_slots >= RING):
        return False
    doubted = now_s - state.doubted_since_s >= parameters.doubt_s
    return not (doubted and np.abs(state.turn).max() <= parameters.largest_jump)
