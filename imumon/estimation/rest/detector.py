"""Slot by slot: is the unit at rest?

Rest is found by a trial of 32 slots (`trial`), kept while windows of all lengths agree (`windows`), and found
again after motion as soon as it is quiet by the noise of the rest before and no gyro has another mean.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest.compass import ANY, NEAR, Verdict, verdict
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import ACCEL, AXES, EVERY, GYRO, LEVELS, Anchor, Slot, Spells, State
from imumon.estimation.rest.trial import RING, Noise, adopt, look
from imumon.estimation.rest.turn import (
    BEGINS_TURNING,
    Explained,
    has_changed,
    has_settled,
    hypothesis,
    is_back,
    is_over,
    is_steady,
    is_upright,
    may_have_begun,
    may_jump,
    recent_mean,
    steady_slots,
    still_on,
    turned_at_first,
    upright,
    was_handled,
)
from imumon.estimation.rest.wander import OBLIQUE, SURPRISE, forget, look_for_turn
from imumon.estimation.rest.windows import Motion, seen, set_band
from imumon.geodesy import STANDARD_GRAVITY

GAP_S = 2.5
SETTLE_S = 1.0
SETTLE_SLOTS = 8
UNDISTURBED = 8
"""Slots before motion is seen that are left out of the mean before it."""
TRIAL_EVERY = 4
"""Slots between two trials, while there is need of one."""
HOLD_WINDOWS, LONGEST_HOLD_S = 4.0, 16.0
"""What showed only in windows of some length is watched for so many of them, 16 s at most, before it is rest
again."""
SHORT_REST_S, MOST_CAUTION = 20.0, 8.0
"""A rest shorter than this that ends slowly was none, perhaps: the next is watched for twice as long, and its
mean is none to come back to."""
LEAST_REST_S = 4.0
"""One that a knock ends may be as short."""
MOST_ANCHORS, SAME_SIGMAS = 3, 6.0
"""Means of earlier rests that are remembered, and by how much they differ."""
DECIDES_EVERY = 32
LOOKS_EVERY = 2
"""Units of the history between two looks for a turn."""
LIKELY, SHORT = 0.75, 4
"""Probability from which on it is no rest, and level of the windows that say how fast it turns by then."""
SLOWLY = Motion(LEVELS - 1, 0.0, sudden=False, before=(2, 3), turning=True)
KNOCK = Motion(0, 0.0, sudden=True, before=(2, 3))


def begin(state: State, now_s: float, other: bool) -> None:
    """Begin anew at a time: the noise survives; the mean of the last rest survives a gap, no restart."""
    if state.at_rest:
        _leave(state, KNOCK, now_s)
    if other:
        state.undecided_since_s = np.nan
        state.anchors.clear()
        state.turn = state.begun = np.zeros(3)
    state.ring_from = state.length
    state.long_hold_s = now_s
    state.windows.last[:] = np.nan
    _watch(state, now_s, 0.0)
    state.show()


def step(
    state: State,
    parameters: RestParameters,
    slots: Sequence[Slot],
    end_s: Sequence[float],
    first: int,
    stop: int,
) -> int:
    """Take slots from the first on, until there is something to decide; return how many.

    At rest those are `EVERY` at most, and else one.  end_s are the ends of the slots.
    """
    settled = state.at_rest and _fits(state)
    run = 1 + (-state.slots % EVERY if settled else 0)
    taken, motion = seen(state, slots, first, min(first + run, stop), parameters.drift)
    state.slots += taken - 1
    _decide_on(state, parameters, motion, end_s[first + taken - 1])
    if not settled or motion is not None or state.slots % EVERY == 1:  # not where a block happens to end
        state.show()
    return taken


def _decide_on(state: State, parameters: RestParameters, motion: Motion | None, end_s: float) -> None:
    """Decide after a slot that ended at end_s."""
    if motion is None and state.at_rest and state.slots % EVERY == 0:
        motion = _wanders(state, parameters.accel_drift)
    if motion is not None:
        state.shaken = motion.sudden or (state.shaken and not state.at_rest)
        if state.at_rest:
            _leave(state, motion, end_s)
        else:
            _disturb(state, motion, end_s)
        _watch(state, end_s, HOLD_WINDOWS * motion.seconds)
    elif state.at_rest:
        if state.slots % DECIDES_EVERY == 0 and (state.turn.any() or state.begun.any() or not state.anchors):
            _decide(state, parameters, end_s)
    elif state.anchors and _may_be_back(state) and (anchor := is_back(state, parameters, end_s)):
        _rest_again(state, parameters, anchor.turn, end_s)
    elif end_s >= state.hold_s and state.windows.known.any() and _may_return(state):
        turn, rests = _judge(state, parameters, state.quiet_slots, end_s)
        if rests:
            _rest_again(state, parameters, turn, end_s)
    state.slots += 1
    ready = state.length - state.ring_from >= RING and end_s >= state.long_hold_s
    if ready and state.slots % TRIAL_EVERY == 0 and not _fits(state):
        _try(state, parameters, end_s)


def _disturb(state: State, motion: Motion, now_s: float) -> None:
    """Motion goes on: what was steady, and gives way to it slowly, was no rest; a knock may disturb one."""
    if state.turn.any() and state.quiet_slots >= 2 * RING:
        before = state.means(state.length - np.array([UNDISTURBED, UNDISTURBED + RING]))[0]
        state.steady, state.steady_s = np.where(state.windows.known, before, np.nan), now_s
    if not motion.sudden and state.quiet_slots >= SETTLE_SLOTS:
        state.spells.end(now_s)


def _fits(state: State) -> bool:
    """Tell whether it has been quiet by the noise that is known of all axes."""
    return state.quiet_slots >= RING and bool(state.windows.known.all())


def _wanders(state: State, drift: float) -> Motion | None:
    """Tell whether a slow turn is more likely than the bias, and note how much it may be if not."""
    if state.quiet_slots < EVERY:
        return None
    state.past.add(state.windows, state.length)
    found = None if state.past.units % LOOKS_EVERY else look_for_turn(state, drift)
    if found is None:
        return None
    # Older bins are too long to show that it began suddenly: what was seen then is kept for as long as the
    # temperature, gravity and the means since leave room for a turn as fast that began then.
    seen, kept = (float(np.sqrt(rms @ rms)) for rms in (found.turn, state.unseen))
    left = min(kept, found.possible)
    if seen >= left:
        state.unseen, state.unseen_age = found.turn, found.age
    else:
        state.unseen = state.unseen * (left / kept)
    state.unseen_age += LOOKS_EVERY
    seconds = state.span_s(1 << SHORT)
    if found.tilts >= LIKELY:
        return Motion(SHORT, seconds, False, (0, 0), False, found.before, found.age_s, found.degc)
    if found.probability < LIKELY:
        return None
    if is_over(state.turn, state.turn + found.turn):
        forget(state)
        return None
    return Motion(SHORT, seconds, False, (0, 0), True, found.before, found.age_s, found.degc)


def _may_be_back(state: State) -> bool:
    """Tell whether to look for the old means: with each slot after a knock, each second after a while."""
    quiet = state.quiet_slots
    return quiet >= 2 and (state.slots % EVERY == 0 or (quiet < RING and not state.slow))


def _may_return(state: State) -> bool:
    """Tell whether it has been quiet for long enough."""
    quiet = state.quiet_slots
    seldom = 2 * TRIAL_EVERY if state.turning else TRIAL_EVERY  # a steady turn changes slowly
    return SETTLE_SLOTS <= quiet < RING or (quiet >= RING and state.slots % seldom == 0)


def _watch(state: State, now_s: float, seconds: float) -> None:
    """Forget all windows; the next rest is so many seconds away at least."""
    state.hold_s = now_s + min(state.caution * max(seconds, SETTLE_S), LONGEST_HOLD_S)
    if seconds > SETTLE_S:
        state.long_hold_s = state.hold_s
    state.quiet_from, state.quiet_since_s = state.length, now_s


def _leave(state: State, motion: Motion, now_s: float) -> None:
    """Rest ends: keep the mean from before what moved, and let no sample be a spike."""
    _note(state, motion, now_s)
    long = now_s - state.rest_since_s > SHORT_REST_S
    state.caution = 1.0 if long else min((1.0 if motion.sudden else 2.0) * state.caution, MOST_CAUTION)
    state.turning = motion.turning
    state.slow = state.turning or state.caution > 1.0
    state.chance = 1.0
    state.at_rest, state.undecided_since_s, state.steady = False, np.nan, np.full(AXES, np.nan)
    state.ring_from = state.length
    forget(state)


def _note(state: State, motion: Motion, now_s: float) -> None:
    """Keep the mean from before what moved, and by how much it differs: the bias may have followed."""
    windows, n, slots = state.windows, state.length, 2**motion.level
    older = np.full(AXES, np.nan)
    if motion.mean is not None:
        older = motion.mean
    elif motion.level > 2:
        cuts = np.maximum(n - np.array(motion.before), state.quiet_from)
        older = state.means(cuts)[0]
    anchor = Anchor(
        np.where(np.isfinite(older), older, windows.rest_mean),
        windows.variance[min(motion.level + 2, LEVELS - 1)].copy(),
        now_s - max(HOLD_WINDOWS * motion.seconds, motion.age_s),
        np.zeros(3) if motion.turning else state.turn,
        state.degc if np.isnan(motion.degc) else motion.degc,
    )
    recent = np.where(windows.known, state.latest(slots)[0], np.nan)
    turn = anchor.turn_now(recent)
    if motion.turning and state.turn.any() and state.anchors:  # it has been seen before, and grows, or ends
        turn = state.anchors[0].turn_now(recent)
    elif not state.anchors or now_s - state.rest_since_s > (LEAST_REST_S if motion.sudden else SHORT_REST_S):
        _remember(state, anchor)
    if not motion.sudden:
        state.turn = upright(state, turn, windows.rest_mean[ACCEL]) if motion.turning else turn


def _remember(state: State, anchor: Anchor) -> None:
    """Keep the mean of a rest, in place of those that are the same."""
    others = []
    for other in state.anchors:
        same = SAME_SIGMAS * np.sqrt(other.variance + anchor.variance)
        if (np.abs(other.mean - anchor.mean) > same)[GYRO].any():
            others.append(other)
    state.anchors = [anchor, *others[: MOST_ANCHORS - 1]]


def _enter(
    state: State, parameters: RestParameters, mean: FloatArray, turn: FloatArray, now_s: float
) -> None:
    state.windows.rest_mean[:], state.rest_since_s = mean, now_s
    if not state.anchors:
        state.begun = may_have_begun(state, mean, parameters.begins_turning)
    elif state.begun.any():
        tilted = np.linalg.norm((mean - state.anchors[0].mean)[ACCEL]) > OBLIQUE * STANDARD_GRAVITY
        if tilted or (was_handled(state) and not turn.any()):
            state.begun = np.zeros(3)  # it would be about another axis now, and did not go on in a hand
    state.at_rest, state.turn, state.chance = True, turn, 1.0
    state.spells = Spells()
    since_s = now_s if np.isnan(state.undecided_since_s) else state.undecided_since_s
    state.undecided_since_s = since_s if turn.any() else np.nan
    set_band(state.windows, parameters.drift)


def _rest_again(state: State, parameters: RestParameters, turn: FloatArray, now_s: float) -> None:
    """Rest by the noise of the last one; turn is what it may be instead."""
    mean = recent_mean(state, state.quiet_slots)[0]
    # What was before the mean became constant is no rest to compare with.
    state.quiet_from = max(state.quiet_from, state.length - steady_slots(state))
    mean = np.where(np.isfinite(mean), mean, state.windows.rest_mean)
    _enter(state, parameters, mean, turn, now_s)


def _judge(
    state: State, parameters: RestParameters, slots: int, now_s: float, fits: bool = True
) -> tuple[FloatArray, bool]:
    """Return the turn that quiet slots may be, and whether they may be rest.

    Motion that begins or ends so slowly that only the mean shows it has ended when the mean is constant; by a
    noise that no longer fits nothing is, and the trial has judged that.
    """
    if not state.anchors and _begins_turning(state, slots):
        return np.zeros(3), False
    turn, explained = hypothesis(state, parameters, slots, now_s)
    first = 0.0
    if turn.any():
        said = verdict(state, turn, slots)
        if said is not Verdict.UNDECIDED:
            turn = np.zeros(3)
            explained = Explained.PLAINLY if said is Verdict.RESTS else Explained.NO
            state.turning &= said is not Verdict.RESTS
        if np.isnan(state.undecided_since_s):
            state.undecided_since_s = now_s
        late = now_s - state.undecided_since_s >= parameters.undecided_s
        if late and may_jump(state, parameters, turn):
            return np.zeros(3), True
        unknown = explained is Explained.NO and bool(turn.any()) and is_upright(state, turn, slots)
        first = turned_at_first(state, slots) if unknown else 0.0
        if first > 0.0 and is_steady(state, parameters):
            state.begun = np.sqrt(first) * turn
            if first > (BEGINS_TURNING if late else 0.5):
                state.anchors.clear()  # what was taken for a rest is none to come back to
                surely = late or np.log(1.0 - first) < -SURPRISE
                return np.zeros(3) if surely else np.sqrt(1.0 - first) * turn, True
    if explained is Explained.NO:
        # About another axis it would tilt the unit: gravity says soon whether it does.
        state.turning |= bool(turn.any() and is_upright(state, turn, slots))
        state.chance = has_changed(state, parameters, turn, slots, now_s)
        state.chance *= 1.0 if may_jump(state, parameters, turn) else first
        state.turn = turn
        return turn, False
    if not (state.anchors and fits):
        return turn, True
    if state.slow or state.quiet_slots >= steady_slots(state) // 2:
        return turn, is_steady(state, parameters)
    half = state.quiet_slots // 2
    return turn, has_settled(state, 2 * half, state.windows.variance[half.bit_length() - 1])


def _begins_turning(state: State, slots: int) -> bool:
    """Tell whether the compass says that what is the first rest, or would be, is a turn, and note it."""
    mean = np.nan_to_num(state.latest(slots)[0])
    gravity2 = float(mean[ACCEL] @ mean[ACCEL])
    turn = mean[GYRO] if gravity2 == 0.0 else (mean[GYRO] @ mean[ACCEL]) * mean[ACCEL] / gravity2
    said = verdict(state, turn, slots, ANY)
    # While it cannot tell, a turn goes on that it has seen, if the mean is that of the turn.
    same = float(np.linalg.norm(turn - state.turn)) < NEAR * float(np.linalg.norm(state.turn))
    turns = said is Verdict.TURNS or (said is Verdict.UNDECIDED and same)
    if turns:
        state.turn, state.chance = turn, 1.0
    return turns


def _decide(state: State, parameters: RestParameters, now_s: float) -> None:
    """At rest, though it may be a turn: ask the compass, the old mean, and the time it has taken."""
    said = verdict(state, state.begun, state.quiet_slots)
    if said is Verdict.RESTS or now_s - state.rest_since_s >= parameters.undecided_s:
        state.begun = np.zeros(3)
    if not state.turn.any():
        if not state.anchors and _begins_turning(state, state.quiet_slots):
            turn = state.turn
            _leave(state, SLOWLY, now_s)
            state.anchors.clear()
            state.turn = turn
            _watch(state, now_s, 0.0)
        return
    said = verdict(state, state.turn, state.quiet_slots)
    if said is Verdict.TURNS:
        _leave(state, SLOWLY, now_s)
        _watch(state, now_s, 0.0)
        return
    late = now_s - state.undecided_since_s >= parameters.undecided_s
    if state.anchors:
        state.turn, state.chance = still_on(state, now_s)
    if said is Verdict.RESTS or late or np.log(state.chance) < -SURPRISE:
        state.turn, state.undecided_since_s = np.zeros(3), np.nan


def _coasts(state: State, noise: Noise) -> bool:
    """Tell whether it still slows down, by a trial's noise of half seconds: longer means have the motion."""
    return not has_settled(state, RING, np.maximum(noise.of_1 / 4.0, noise.of_4) / (RING / 8))


def _try(state: State, parameters: RestParameters, now_s: float) -> None:
    """Look for rest by another noise than that of the last, or of an axis of which nothing is known."""
    windows, n = state.windows, state.length
    unknown = ~windows.known & np.isfinite(windows.average[n - RING : n]).all(0)
    if state.at_rest and not unknown.any():
        return
    noise = look(state, parameters.drift)
    if noise is None:
        state.undecided_since_s = np.nan
        if state.at_rest:
            _leave(state, KNOCK, now_s)
            _watch(state, now_s, 0.0)
        return
    mean = np.where(noise.present, noise.mean, windows.rest_mean)
    if state.at_rest:
        windows.rest_mean[unknown] = mean[unknown]
        adopt(state, noise, unknown)
        return
    turn, rests = _judge(state, parameters, RING, now_s, state.quiet_slots >= RING)
    if rests and not (state.anchors and _coasts(state, noise)):
        adopt(state, noise, noise.present)
        _enter(state, parameters, mean, turn, now_s)
        _watch(state, now_s, 0.0)
