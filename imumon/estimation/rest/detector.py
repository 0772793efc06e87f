"""Slot by slot: is the unit at rest?

Rest is found by a trial of 32 slots (`trial`), kept while windows of all lengths agree (`windows`), and found
again after motion as soon as it is quiet by the noise of the rest before and no gyro has another mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.compass import Verdict, verdict
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import AXES, GYRO, LEVELS, Slot, State
from imumon.estimation.rest.trial import RING, adopt, look
from imumon.estimation.rest.turn import hypothesis, is_steady, steady_slots
from imumon.estimation.rest.windows import BEFORE, MEMORY_SLOTS, Motion, bends, creeps, seen, set_band

GAP_S = 2.5
SETTLE_S = 1.0
SETTLE_SLOTS = 8
TRIAL_EVERY = 4
"""Slots between two trials, while there is need of one."""
HOLD_WINDOWS = 4.0
"""What showed only in windows of some length is watched for so many of them before it is rest again."""
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
    state.ring_from = state.length
    state.long_hold_s = now_s
    state.windows.last[:] = np.nan
    _watch(state, now_s, 0.0)


def step(state: State, parameters: RestParameters, slots: Sequence[Slot], k: int, end_s: float) -> None:
    """Take slot k, which ends at end_s, and decide."""
    drift = parameters.drift
    motion = seen(state, slots, k, drift)
    if motion is None and state.at_rest and state.slots % BEND_EVERY == 0:
        motion = bends(state, drift) or creeps(state)
    if motion is not None:
        if state.at_rest:
            _leave(state, motion, end_s)
        _watch(state, end_s, HOLD_WINDOWS * motion.seconds)
    elif not state.at_rest and end_s >= state.hold_s and state.windows.known.any() and _may_return(state):
        _return(state, parameters, end_s)
    state.slots += 1
    ready = state.length - state.ring_from >= RING and end_s >= state.long_hold_s
    fits = state.quiet_slots >= RING and state.windows.known.all()
    if ready and not fits and state.slots % TRIAL_EVERY == 0:
        _try(state, parameters, end_s)


def _may_return(state: State) -> bool:
    """Tell whether it has been quiet for long enough."""
    quiet = state.quiet_slots
    seldom = 2 * TRIAL_EVERY if state.turning else TRIAL_EVERY  # a steady turn changes slowly
    return SETTLE_SLOTS <= quiet < RING or (quiet >= RING and state.slots % seldom == 0)


def _watch(state: State, now_s: float, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    hold_s = state.caution * max(seconds, SETTLE_S)
    state.hold_s = now_s + (min(hold_s, LONGEST_HOLD_S) if state.turning else hold_s)
    if seconds > SETTLE_S:
        state.long_hold_s = state.hold_s
    state.quiet_from = state.length


def _leave(state: State, motion: Motion, now_s: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    windows, n, slots = state.windows, state.length, 2**motion.level
    older = np.full(AXES, np.nan)
    if motion.level > 2:
        cuts = n - slots * np.array(motion.before)
        older = state.means(np.maximum(cuts, state.quiet_from))[0]
    state.anchor = np.where(np.isfinite(older), older, windows.rest_mean)
    state.anchor_variance = windows.variance[min(motion.level + 2, LEVELS - 1)].copy()
    state.anchored, state.anchor_s = True, now_s - HOLD_WINDOWS * motion.seconds
    if not motion.sudden:  # the bias may have followed what moved slowly
        recent = state.latest(slots)[0]
        state.turn = np.where(state.windows.known & np.isfinite(recent), recent - state.anchor, 0.0)[GYRO]
    long = now_s - state.rest_since_s > SHORT_REST_S
    state.caution = 1.0 if long else min((1.0 if motion.sudden else 2.0) * state.caution, MOST_CAUTION)
    state.turning = motion.before != BEFORE
    state.slow = state.turning or state.caution > 1.0
    state.at_rest, state.doubted_since_s = False, np.nan
    state.ring_from = n


def _enter(state: State, mean: FloatArray, drift: FloatArray, now_s: float) -> None:
    state.windows.rest_mean[:], state.rest_since_s = mean, now_s
    state.at_rest, state.doubted_since_s, state.turn = True, np.nan, np.zeros(3)
    set_band(state.windows, drift)


def _return(state: State, parameters: RestParameters, now_s: float) -> None:
    """Quiet for long enough by the noise of the last rest: rest again, unless it still turns."""
    slots = min(state.quiet_slots, MEMORY_SLOTS)
    mean, count = state.latest(slots)
    mean = np.where(count > 0, mean, state.windows.rest_mean)
    if not _turns(state, parameters, mean, np.where(count > 0, float(slots), 0.0), now_s):
        # What was before the mean became constant is no rest to compare with.
        steady_from = state.length - steady_slots(state)
        state.quiet_from = max(state.quiet_from, steady_from)
        _enter(state, mean, parameters.drift, now_s)


def _turns(
    state: State,
    parameters: RestParameters,
    mean: FloatArray,
    slots: FloatArray,
    now_s: float,
    fits: bool = True,
) -> bool:
    """Tell whether a unit that is quiet may be turning still; its rate is the hypothesis from now on.

    Motion that begins or ends so slowly that only the mean shows it has ended when the mean is constant; by a
    noise that no longer fits nothing is, and the trial has judged that.
    """
    turn = hypothesis(state, parameters, mean, slots, now_s)
    if turn.any():
        said = verdict(state, turn)
        state.turn = turn if said is Verdict.UNDECIDED else np.zeros(3)
        state.turning = said is not Verdict.RESTS
        if np.isnan(state.doubted_since_s):
            state.doubted_since_s = now_s
        long = now_s - state.doubted_since_s >= parameters.doubt_s
        return state.turning and not (long and np.abs(turn).max() <= parameters.largest_jump)
    slow = state.slow or state.quiet_slots >= steady_slots(state) // 2
    return state.anchored and slow and fits and not is_steady(state, parameters)


def _try(state: State, parameters: RestParameters, now_s: float) -> None:
    """Look for rest by another noise than that of the last, or of an axis of which nothing is known."""
    windows, n = state.windows, state.length
    unknown = ~windows.known & np.isfinite(windows.average[n - RING : n]).all(0)
    if state.at_rest and not unknown.any():
        return
    noise = look(state, parameters.drift)
    if noise is None:
        state.doubted_since_s = np.nan
        if state.at_rest:
            _leave(state, KNOCK, now_s)
            _watch(state, now_s, 0.0)
        return
    mean = np.where(noise.present, noise.mean, windows.rest_mean)
    if state.at_rest:
        windows.rest_mean[unknown] = mean[unknown]
        adopt(state, noise, unknown)
        return
    slots = np.where(noise.present, float(RING), 0.0)
    if not _turns(state, parameters, mean, slots, now_s, state.quiet_slots >= RING):
        adopt(state, noise, noise.present)
        _enter(state, mean, parameters.drift, now_s)
        _watch(state, now_s, 0.0)
