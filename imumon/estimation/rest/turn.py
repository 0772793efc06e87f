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
from imumon.estimation.rest.compass import Verdict
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import ACCEL, EVERY, GYRO, KEPT, LEVELS, SLOT_S, Anchor, State
from imumon.estimation.rest.thermometer import warmed
from imumon.estimation.rest.wander import CREEP, OBLIQUE, TURN_EVERY_S, grown, wander_after
from imumon.estimation.rest.windows import CHI_SQUARE, MEMORY_SLOTS, SLOTS, TINY

EARTH_TWICE = 1.46e-4
"""rad/s: a gyro that is turned round sees the earth's rate the other way."""
SIGMAS = 6.0
STEADY_SIGMAS, TURN_STEADY_SIGMAS = 3.0, 1.5
"""Of how the mean has grown, where it is to be constant: by 1.5 a true rest is found at once in 87 of 100
and a turn that slows down, and shows with three sigmas in 20 s, is taken for one in 7 of 100 looks."""
PLAIN_SIGMAS = 2.0
"""Sigmas of a change of which nobody would ask whether it is a turn."""
BACK_SIGMAS = 3.0
BACK_S, SLOW_BACK_S = 0.25, 4.0
ALL_CREEP = 10.0
"""What makes a bias creep, temperature, has all axes creep: one by more than ten times what both others do,
in one unit of a hundred where each of them may have any part of the slope of the first."""
UNLIKELY = 0.01
"""What is less likely is not told: errors of more than five sigmas may be so frequent."""
BEGINS_TURNING = 0.05
"""Share of recordings that begin in a turn, of those with two steady means: who starts one on a turntable?
Assumed, as `TURN_EVERY_S` is."""
AT_FIRST = np.radians(np.geomspace(0.01, 300.0, 120))
AT_FIRST = np.concatenate([-AT_FIRST[::-1], AT_FIRST])
"""Turns that are tried, rad/s: as likely on a logarithmic scale, as `RATES` has it."""
LEANING = 0.04
"""rad: by so much (sd) accelerometers with a bias of 40 mg (`gyro_bias.motion`) miss the vertical."""
EARTH = 7.3e-5
"""rad/s: a gyro without any bias reads up to the earth's rate."""
SMALL_ANGLE = 1.0
"""rad: by more a turn may bring gravity back to where it was."""
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
    limit = SIGMAS * np.sqrt(variance + state.anchors[0].variance) + state.windows.resolution
    across = turn - upright(state, turn, recent[ACCEL])
    wander = SIGMAS * np.sqrt(wander_after(state, now_s - state.anchors[0].at_s))
    wander += SIGMAS * warmed(state.degc, state.anchors[0].degc)
    tilt = float(np.linalg.norm(across))
    noisy, wanders = (
        np.linalg.norm(across * sd) >= tilt * tilt for sd in (limit[GYRO], np.maximum(limit[GYRO], wander))
    )
    said = gravity_says(state, turn, parameters.accel_drift, slots)
    if not noisy and tilt > OBLIQUE * float(np.linalg.norm(turn)) and said is not None:
        if said is not Verdict.RESTS:  # it turns, or will have been seen to be still in seconds
            return state.turn, Explained.NO
        if not wanders and may_jump(state, parameters, turn - across):
            return np.zeros(3), Explained.PLAINLY
    if _turns_on(state, turn, recent, limit):
        return turn, Explained.NO
    best = Explained.NO
    for anchor in state.anchors:
        change = recent - anchor.mean
        change[GYRO] = _possible(state, parameters, np.nan_to_num(change[GYRO]), recent[ACCEL], slots)
        found = _explained(state, parameters, anchor, change, variance, since_s)
        if found is Explained.PLAINLY:
            return anchor.turn, found
        best = max(best, found, key=lambda one: one.value)
    return turn, best


def may_jump(state: State, parameters: RestParameters, turn: FloatArray) -> bool:
    """Tell whether a bias may have changed so, (3,), since the latest rest, by itself or by warming."""
    warm = SIGMAS * float(warmed(state.degc, state.anchors[0].degc))
    return float(np.linalg.norm(turn)) <= parameters.largest_jump + warm


def _explained(
    state: State,
    parameters: RestParameters,
    anchor: Anchor,
    change: FloatArray,
    variance: FloatArray,
    since_s: float,
) -> Explained:
    """Tell whether the bias may have changed so from an earlier rest to a mean that has been since a time."""
    change = np.abs(np.nan_to_num(change))
    noise = variance + anchor.variance
    moved_s = max(since_s - anchor.at_s, 0.0)
    force = float(np.linalg.norm(change[ACCEL]))
    still = state.windows.known[ACCEL].all() and force < SIGMAS * np.sqrt(noise[ACCEL].max()) + TILTED
    slope = CREEP if still else parameters.gyro_drift
    wander = np.sqrt(np.maximum(wander_after(state, moved_s), noise[GYRO]))
    turned = parameters.gyro_g_sensitivity * force + (0.0 if still else EARTH_TWICE)
    plain = turned + state.windows.resolution[GYRO]
    # What creeps does so by its temperature: without a thermometer, for as long as it has had.
    drift = min(slope * moved_s, parameters.gyro_walk) if np.isnan(state.degc) or not still else 0.0
    warm = warmed(state.degc, anchor.degc)
    if not still:
        plain += drift
    # A turn that was seen to begin goes on until the old mean is back: wander does not end it.
    usual = PLAIN_SIGMAS * (np.sqrt(noise[GYRO]) if state.turning and still else wander)
    usual = np.minimum(usual, parameters.gyro_walk)
    if not (state.turning and still):
        usual = np.hypot(usual, PLAIN_SIGMAS * warm)
    most = np.hypot(np.minimum(SIGMAS * wander, 2.0 * parameters.gyro_walk), SIGMAS * warm) + drift
    if (change[GYRO] <= usual + plain).all():
        return Explained.PLAINLY
    if (change[GYRO] <= most + plain).all():
        return Explained.PERHAPS if still else Explained.PLAINLY
    return Explained.NO


def is_back(state: State, parameters: RestParameters, now_s: float) -> Anchor | None:
    """Return the earlier rest of which all means are again what they were.

    For a quarter of a second after a knock, for 4 s after what showed slowly, and so that two means of 8 s
    are those of the rest after what only the mean shows.
    """
    slots = state.quiet_slots
    least_s = BACK_S if state.shaken and not state.slow else SLOW_BACK_S
    if state.span_s(min(slots, KEPT)) < least_s:
        return None
    recent, variance = recent_mean(state, slots)
    means = [recent]
    if state.turning:  # a turn that ends slowly is slow for longer than its mean is near
        means.append(state.means(state.length - steady_slots(state) // 2 * np.array([1, 2]))[0])
    for anchor in state.anchors:
        noise = variance + anchor.variance
        limit = BACK_SIGMAS * np.sqrt(noise) + state.windows.resolution
        limit[ACCEL] += min(parameters.accel_drift * (now_s - anchor.at_s), TILTED)
        changes = np.where(np.isfinite(recent), np.array(means) - anchor.mean, 0.0)
        # A mean so uncertain that it fits a steady turn as well says nothing yet.
        off = np.abs(anchor.turn_now(recent) - state.turn)
        refuted = bool(state.shaken or (off > limit[GYRO]).any())
        refuted &= not state.slow or is_over(state.turn, changes[:, GYRO])
        if state.turning and state.turn.any():
            axis = state.turn / np.sqrt(state.turn @ state.turn)
            along = changes[:, GYRO] @ axis
            refuted &= bool((np.abs(along) <= limit[GYRO] @ np.abs(axis)).all())
            # Across the axis of the turn the bias has wandered, for gravity would show it if it turned.
            changes[:, GYRO] -= np.outer(along, axis)
            limit[GYRO] = np.hypot(
                limit[GYRO], BACK_SIGMAS * np.sqrt(wander_after(state, now_s - anchor.at_s))
            )
        if refuted and (np.abs(changes) <= limit).all():
            return anchor
    return None


def still_on(state: State, now_s: float) -> tuple[FloatArray, float]:
    """Return the turn that it may be by the latest mean at rest, (3,), and how probably it goes on.

    The turn is the most that it has been.  If it goes on, the mean has wandered from there since; if it is
    over, from the mean before it.  That it has ended is as likely as it has had time to: durations are
    as likely on a logarithmic scale.
    """
    anchor, since_s = state.anchors[0], now_s - state.undecided_since_s
    recent = recent_mean(state, state.quiet_slots)[0]
    now = upright(state, anchor.turn_now(recent), recent[ACCEL])
    size = float(np.linalg.norm(state.turn))
    along = float(now @ state.turn) / size
    if along >= size:
        return now, 1.0
    warm2 = float(warmed(state.degc, anchor.degc)) ** 2
    to_old, to_turn = (
        float(wander_after(state, seconds) @ (state.turn / size) ** 2) + warm2
        for seconds in (now_s - anchor.at_s, since_s)
    )
    over = (size - along) ** 2 / to_turn - along**2 / to_old + np.log(to_turn / to_old)
    return state.turn, float(1.0 / (1.0 + np.exp(min(0.5 * over, 100.0)) * since_s / TURN_EVERY_S))


def has_changed(
    state: State, parameters: RestParameters, turn: FloatArray, slots: int, now_s: float
) -> float:
    """Return the probability that a mean that is steady in motion is a bias that has changed, and note it.

    None of the earlier spells of this motion was: so it is one in so many (Laplace), times how improbable it
    is that another spell of the kind lasts as long (exponential, of a mean that only those tell).
    """
    spells, began_s = state.spells, now_s - state.span_s(min(slots, KEPT))
    if spells.since_s is not None:
        noise = 2.0 * recent_mean(state, slots)[1][GYRO]
        limit = SIGMAS * np.sqrt(noise) + parameters.gyro_drift * (now_s - spells.since_s)
        if (np.abs(turn - state.turn) > limit + state.windows.resolution[GYRO]).any():
            spells.end(now_s)
    spells.since_s = began_s if spells.since_s is None else spells.since_s
    lasted_s = now_s - spells.since_s
    longer = (spells.seconds / (spells.seconds + lasted_s)) ** spells.count
    return 1.0 / (1.0 + spells.count * longer)


def may_have_begun(state: State, mean: FloatArray, share: float) -> FloatArray:
    """Return the rms of the turn that may be in the first steady mean, (6,), of a recording, rad/s, (3,).

    About the vertical, or, where gravity is not known, about any axis.  What the other axes read is bias, for
    there it turns about none of them.  It says how large a bias of this unit may be: of biases of one scale,
    which is as likely on a logarithmic scale, two of size L say of a third that it has Student's density with
    two degrees of freedom.  The share of recordings begins in a turn.
    """
    gyro, up = np.nan_to_num(mean[GYRO]), vertical(state, mean[ACCEL])
    axes = np.eye(3) if up is None else up[np.newaxis]
    along = axes @ gyro
    others2 = (gyro @ gyro - along**2 + EARTH**2)[:, np.newaxis]

    def density(bias: FloatArray) -> FloatArray:
        return np.asarray(0.5 * others2 / (others2 + bias**2) ** 1.5)

    turn = share * density(along[:, np.newaxis] - AT_FIRST) / len(AT_FIRST)
    none = (1.0 - share) * density(along[:, np.newaxis])[:, 0]
    rms = np.sqrt((turn @ AT_FIRST**2) / (none + turn.sum(1)))
    return np.asarray(np.hypot(rms @ axes, LEANING * np.linalg.norm(rms)))


def turned_at_first(state: State, slots: int) -> float:
    """Return the probability that the first rest was a turn and is over, if one of the two means is a turn.

    Two steady means look alike.  Of the biases of a gyro nobody knows the scale s: with a density of 1/s, a
    mean of size m is the bias with a density of 1/m³, the more so the smaller it is by the measure of the
    axes that do not turn.
    """
    if len(state.anchors) != 1:
        return 0.0
    now = recent_mean(state, slots)[0]
    first2, now2 = (float(np.nansum(mean[GYRO] ** 2)) + EARTH**2 for mean in (state.anchors[0].mean, now))
    odds = BEGINS_TURNING / (1.0 - BEGINS_TURNING) * (first2 / now2) ** 1.5
    return float(odds / (1.0 + odds)) if odds > UNLIKELY else 0.0


def was_handled(state: State) -> bool:
    """Tell whether the unit was tilted, since its last rest, by more than what carries it would do.

    A turntable that is knocked, slows down or stops does not tilt it; who picks it up does.
    """
    slots = state.length - state.ring_from
    up = vertical(state, state.anchors[0].mean[ACCEL])
    if up is None or not slots:
        return False
    rate = state.windows.average[state.ring_from : state.length, GYRO] - state.anchors[0].mean[GYRO]
    angle = np.cumsum(np.nan_to_num(rate), 0) * state.slot_s
    across = angle - (angle @ up)[:, np.newaxis] * up
    return float(np.square(across).sum(1).max()) > OBLIQUE**2


def vertical(state: State, force: FloatArray) -> FloatArray | None:
    """Return the direction of the specific force, (3,); None where gravity is not known."""
    gravity2 = float(force @ force)
    if not (state.windows.known[ACCEL].all() and gravity2 > 25.0):
        return None
    return np.asarray(force / np.sqrt(gravity2))


def upright(state: State, turn: FloatArray, force: FloatArray) -> FloatArray:
    """Return the part of a turn, (3,), that is about the vertical; all of it where gravity is not known."""
    up = vertical(state, force)
    return turn if up is None else np.asarray((turn @ up) * up)


def is_upright(state: State, turn: FloatArray, slots: int) -> bool:
    """Tell whether a turn, (3,), is about the vertical of the latest slots, or gravity is not known."""
    across = turn - upright(state, turn, recent_mean(state, slots)[0][ACCEL])
    return not across @ across > OBLIQUE**2 * (turn @ turn)


def is_over(turn: FloatArray, change: FloatArray) -> bool:
    """Tell whether what is left of a turn is so little that it has ended."""
    return bool(3.0 * np.abs(change).max() < np.abs(turn).max())


def recent_mean(state: State, slots: int) -> tuple[FloatArray, FloatArray]:
    """Return the mean of the latest slots, of 8 s at most, and its variance at rest, (6,)."""
    slots = min(slots, steady_slots(state) // 2)
    mean, count = state.latest(slots)
    there = state.windows.known & (count > 0)
    return np.where(there, mean, np.nan), state.windows.variance[slots.bit_length() - 1]


def _turns_on(state: State, turn: FloatArray, recent: FloatArray, limit: FloatArray) -> bool:
    """Tell whether something disturbed a turn, and the mean is what it was before: no turn ends like that."""
    if not np.isfinite(state.steady).any():
        return False
    across = turn - upright(state, turn, recent[ACCEL])
    if state.quiet_slots > steady_slots(state) and across @ across > OBLIQUE**2 * (turn @ turn):
        return False  # gravity would have shown it by now
    between_s = max(state.quiet_since_s - state.steady_s, 0.0)
    near, far = (np.abs(recent - mean)[GYRO] for mean in (state.steady, state.anchors[0].mean))
    same = (near <= limit[GYRO] + CREEP * between_s) | ~np.isfinite(near)
    return bool(same.all() and np.nansum(near) < np.nansum(far))


def gravity_says(state: State, turn: FloatArray, drift: float, slots: int) -> Verdict | None:
    """Tell whether the specific force turned in the latest slots as a turn, (3,), would have it turn.

    None where it would not in any time: the turn is about the vertical, or so slow that the accelerometers'
    drift, m/s³, or noise hides it in 8 s.
    """
    longest = steady_slots(state) // 4
    window = min(slots // 2, longest)
    while window and float(np.linalg.norm(turn)) * state.span_s(window) > SMALL_ANGLE:
        window //= 2
    if not state.windows.known[ACCEL].all() or window == 0:
        return None
    now, before = state.means(state.length - window * np.arange(3))[:, ACCEL]
    expected = np.cross(now, turn)
    rate = float(np.sqrt(expected @ expected))
    if not rate > _shown(state, drift, longest):
        return None
    if not rate > _shown(state, drift, window):
        return Verdict.UNDECIDED
    along = float((now - before) @ expected) / (rate * state.span_s(window))
    return Verdict.TURNS if along > 0.5 * rate else Verdict.RESTS


def _possible(
    state: State, parameters: RestParameters, change: FloatArray, force: FloatArray, slots: int
) -> FloatArray:
    """Return the part of a change, (3,), that may be a turn by what gravity says."""
    if gravity_says(state, change, parameters.accel_drift, slots) is Verdict.RESTS:
        return upright(state, change, force)
    return change


def _shown(state: State, drift: float, window: int) -> float:
    """Return how fast the specific force must turn to be seen in two windows of so many slots, m/s³."""
    windows = state.windows
    noise = 2.0 * CHI_SQUARE * windows.variance[window.bit_length() - 1, ACCEL].max()
    return float(np.sqrt(noise) + windows.resolution[ACCEL].max()) / state.span_s(window) + drift


def steady_slots(state: State) -> int:
    """Return how many slots take 16 s, as a power of two; a slot is a sample at low rates."""
    slot_s = state.span_s(min(MEMORY_SLOTS, state.length)) / MEMORY_SLOTS
    longer = round(float(np.log2(max(slot_s / SLOT_S, 1.0))))
    return int(SLOTS[max(LEVELS - 1 - longer, 3)])


def is_steady(state: State, parameters: RestParameters) -> bool:
    """Tell whether the means of 4 s do not grow, but for noise, wander and a creeping bias.

    For 8 s after motion that was no turn about the vertical: it would tilt the unit, and gravity shows that;
    else for 20 s.
    """
    width = steady_slots(state) // 4
    windows = 5 if state.turning else 2
    if state.quiet_slots < windows * width:
        return False
    means = state.means(state.length - width * np.arange(windows + 1))
    seconds = state.span_s(width) * np.arange(1, windows)
    change = np.abs(means[0] - means[1:])[:, ACCEL]
    limit = STEADY_SIGMAS * np.sqrt(2.0 * state.windows.variance[width.bit_length() - 1] + TINY)
    limit = (limit + state.windows.resolution)[ACCEL] + parameters.accel_drift * seconds[:, np.newaxis]
    if (state.windows.known[ACCEL] & (change > limit)).any():
        return False
    off, variance = grown(state, means[:, GYRO], width)
    variance += warmed(state.degc, float(state.windows.degc[state.length - 1 - width * (windows - 1)])) ** 2
    sigmas = TURN_STEADY_SIGMAS if state.turning else STEADY_SIGMAS
    return not _turned(
        state, off, variance, sigmas, CREEP * float(seconds[-1]) if np.isnan(state.degc) else 0.0
    )


def has_settled(state: State, slots: int, variance: FloatArray) -> bool:
    """Tell whether both halves of the latest slots have one rate about the vertical, but for noise and creep.

    The windows permit a drift that temperature makes on all axes; a turntable that coasts down drifts as much
    about the vertical alone, when it is slow already.  variance, (6,), is that of the mean of a half.
    """
    halves = state.length - slots // 2 * np.arange(3)
    means = state.means(halves)[:, GYRO]
    seconds = state.span_s(slots // 2)
    wander = 2.0 * variance[GYRO] + wander_after(state, seconds)
    return not _turned(state, means[0] - means[1], wander, STEADY_SIGMAS, CREEP * seconds)


def _turned(state: State, off: FloatArray, variance: FloatArray, sigmas: float, creep: float) -> bool:
    """Tell whether a difference of gyros, (3,), is beyond so many sigmas and a creeping bias, rad/s.

    Where gravity is known, about the vertical: what is plainly oblique is drift, for gravity would move.
    variance, (3,), is that by noise and wander.
    """
    known, resolution = state.windows.known, state.windows.resolution[GYRO]
    off, limit2 = np.where(known[GYRO] & np.isfinite(off), off, 0.0), sigmas**2 * variance
    if not known.all():
        excess = np.maximum(np.abs(off) - creep - resolution, 0.0)
        return bool((excess**2 / limit2).sum() * 25.0 > CHI_SQUARE)
    force = state.latest(EVERY)[0][ACCEL]
    up = force / np.sqrt(force @ force)
    along = abs(float(off @ up))
    across = np.sqrt(max(float(off @ off) - along * along, 0.0))
    # Level axes that only wander do not say that anything drifts, or creeps.
    beyond = across - SIGMAS * np.sqrt(variance.max())
    if beyond > 0.0 and across > OBLIQUE * along:
        return False
    crept = min(creep, ALL_CREEP * max(beyond, 0.0))
    return bool(along - crept - np.abs(up) @ resolution > np.sqrt(limit2 @ up**2))
