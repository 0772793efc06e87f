"""The alignment sample by sample: coarse, then fine, with what is disturbed left out."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.estimation.alignment.estimators import evaluate
from imumon.estimation.alignment.state import (
    AZIMUTH_0,
    CHANNELS,
    CHOSEN,
    COARSE,
    COARSE_S,
    COARSE_TIME,
    CORNER,
    COUNT,
    DAMPING,
    DECAY,
    DISTURBED,
    DOWN,
    ESTIMATORS,
    EVENT_AT,
    EVENT_CAUSE,
    EVENT_END,
    FINE,
    FINE_AT,
    GAIN,
    GAIN_INTERVAL,
    GRAVITY,
    HOLD_UNTIL,
    INNER,
    INTERVAL,
    LAST,
    LATITUDE,
    LOG_ROWS,
    LOGGED,
    OBSERVABLE,
    OBSERVED,
    OUTER,
    PENDING,
    PHASE,
    PITCH_0,
    PREVIOUS,
    REFERENCE,
    REST,
    RESTARTS,
    ROLL_0,
    SETTLED,
    SETTLED_AT,
    SHAKEN,
    SLOT_S,
    SLOT_VALUES,
    SLOTS,
    SQUARES,
    STRIKES,
    SUM,
    UP_0,
    VERTICAL,
    WAITING,
    WARM_TAU,
    WARM_X,
    State,
)
from imumon.estimation.alignment.sums import add_slot, break_ticks, clear_sums
from imumon.estimation.alignment.watch import GAP, UNREST, begin_slot, forget_noise, judge_slot
from imumon.geodesy import EARTH_RATE
from imumon.published.fixed_gain_loop import (
    azimuth,
    dot,
    level_attitude,
    loop_gains,
    loop_step,
    orthonormal,
    roll_pitch,
)

SLOT = 0.249
"""Length of a slot, s."""
QUIET_S = 2.0
"""After a disturbance so long must be quiet before anything counts again."""
SETTLING = 10.0
"""The loop has settled after so many of its time constants."""
LONGEST_S = 30.0
"""After a longer disturbance the alignment starts anew."""
LARGEST_TURN = 0.0175
"""So does it when the unit stands otherwise than before, rad."""
VERTICAL_S = 60.0
"""Time constant with which the vertical rate of the frame follows the gyros."""
STILL_SETTLED = 1.25
"""A settled heading remains settled until its sigma is larger by this factor."""

# Columns of the output, in rad and s: heading and sigma of each estimator follow.
(HEADING, HEADING_SD, ROLL, PITCH, ROLL_DRIFT, PITCH_DRIFT, RATE_EAST, RATE_NORTH, ANGLE_EAST, ANGLE_NORTH,
 MAGNETIC_HEADING) = range(11)  # fmt: skip
OUTPUTS = 11 + 2 * ESTIMATORS


@njit(**INNER)
def restart(state: State) -> None:
    """Begin again with the coarse alignment, because of `EVENT_CAUSE`; the noise is learnt anew, too."""
    number, flag = state.number, state.flag
    if flag[PHASE] == FINE:
        begin = number[EVENT_AT] if flag[DISTURBED] else number[LAST]
        _log(state, begin, number[LAST], 1.0)
    flag[PHASE], flag[CHOSEN], flag[OBSERVED] = WAITING, -1, 0
    number[HOLD_UNTIL], number[SETTLED_AT] = -math.inf, math.nan
    number[EVENT_AT] = math.nan
    flag[DISTURBED] = flag[PENDING] = 0
    state.result[:] = np.nan
    _clear_coarse(state)
    clear_sums(state)
    forget_noise(state)
    _new_slot(state)


@njit(**OUTER)
def new_segment(state: State) -> None:
    """Forget everything that a restart of the device invalidates."""
    state.flag[EVENT_CAUSE] = GAP
    restart(state)
    state.number[LAST] = math.nan
    state.number[INTERVAL] = 0.0


@njit(**INNER)
def _clear_coarse(state: State) -> None:
    state.coarse[:] = 0.0
    state.mag[:] = 0.0
    state.number[COARSE_TIME] = 0.0


@njit(**INNER)
def _new_slot(state: State) -> None:
    begin_slot(state)
    state.slot[:] = 0.0
    state.number[SLOT_S] = 0.0
    state.flag[REST] = 1


@njit(**OUTER)
def process(
    seconds: FloatArray,
    readings: FloatArray,
    field: FloatArray,
    at_rest: IntArray,
    settings: FloatArray,
    state: State,
    out: FloatArray,
) -> None:
    """Go on by n samples.

    Parameters
    ----------
    seconds : array (n,)
        Since the beginning of the segment.
    readings : array (n, 6)
        Angular rate in rad/s and specific force in m/s²; a row with a NaN is passed over.
    field : array (n, 3)
        Magnetic field in any unit, or NaN.
    at_rest : array (n,)
        0 where the unit is known to move.
    settings : array (SETTINGS,)
    state : State
    out : array (n, OUTPUTS)
        Filled.
    """
    for k in range(len(seconds)):
        whole = True
        for i in range(CHANNELS):
            whole = whole and math.isfinite(readings[k, i])
        if whole:
            _sample(seconds[k], readings[k], field[k], at_rest[k], settings, state)
        _show(state, settings, out[k])


@njit(**INNER)
def _sample(
    now: float, reading: FloatArray, field: FloatArray, at_rest: int, settings: FloatArray, state: State
) -> None:
    number, flag = state.number, state.flag
    if math.isnan(number[LAST]):
        number[LAST] = now
        return
    elapsed = now - number[LAST]
    if elapsed <= 0.0:
        return
    number[LAST] = now
    interval = _interval(state, elapsed)
    if interval < 0.0:
        return
    if flag[PHASE] == WAITING:
        flag[PHASE] = COARSE
    if flag[COUNT] == 0 and flag[SLOTS] == 0:
        for i in range(CHANNELS):
            state.watch[REFERENCE, i] = reading[i]
    for i in range(CHANNELS):
        step = reading[i] - state.watch[REFERENCE, i]
        state.watch[SUM, i] += step
        state.watch[SQUARES, i] += step * step
    flag[COUNT] += 1
    if at_rest == 0:
        flag[REST] = 0
    if flag[PHASE] == FINE:
        _fine(reading, interval, state)
    for i in range(3):
        if math.isfinite(field[i]):
            state.mag[i] += interval * field[i]
            if i == 2:
                state.mag[3] += interval
    number[SLOT_S] += interval
    if number[SLOT_S] >= SLOT:
        _end_slot(now, settings, state)


@njit(**INNER)
def _interval(state: State, elapsed: float) -> float:
    """Return the time that a sample stands for; negative when the slot was given up, after a gap."""
    number, flag = state.number, state.flag
    usual = number[INTERVAL]
    if usual == 0.0:
        number[INTERVAL] = elapsed
        return elapsed
    if 0.5 * usual < elapsed < 2.0 * usual:
        number[INTERVAL] += 0.02 * (elapsed - usual)
        flag[STRIKES] = 0
        return elapsed
    flag[STRIKES] += 1
    if flag[STRIKES] >= 10:  # another rate
        number[INTERVAL], flag[STRIKES] = elapsed, 0
    if elapsed <= max(SLOT, 3.5 * usual):
        return elapsed
    if elapsed > LONGEST_S:
        flag[EVENT_CAUSE] = GAP
        restart(state)
    else:
        _drop(state)
    _new_slot(state)
    return -1.0


@njit(**INNER)
def _fine(reading: FloatArray, interval: float, state: State) -> None:
    turned, slot, reference = state.turned, state.slot, state.reference
    reference[2] = state.number[VERTICAL]
    loop_step(
        state.attitude,
        state.velocity,
        reading[:3],
        reading[3:],
        reference,
        state.number[DECAY],
        state.number[GAIN],
        interval,
        turned,
    )
    slot[0] += interval
    slot[1] += turned[0] - interval * reference[0]
    slot[2] += turned[1] - interval * reference[1]
    slot[3] += turned[2]
    slot[4] += turned[3]
    slot[5] += turned[4]


@njit(**INNER)
def _drop(state: State) -> None:
    """Leave out the slots that wait, and say that the next one does not follow the last."""
    state.flag[PENDING] = 0
    break_ticks(state)


@njit(**INNER)
def _end_slot(now: float, settings: FloatArray, state: State) -> None:
    number, flag = state.number, state.flag
    learning = -1
    cause = UNREST if flag[REST] == 0 else judge_slot(state)
    if cause > 0:
        flag[SHAKEN] += 1
    if cause == UNREST and flag[PHASE] == COARSE:
        if number[COARSE_TIME] > 0.0:
            flag[EVENT_CAUSE] = UNREST
            _log(state, now, now, 1.0)
        _clear_coarse(state)
        forget_noise(state)
    elif cause > 0:
        _disturbed(now, cause, state)
    elif cause != learning and now >= number[HOLD_UNTIL]:
        if flag[DISTURBED]:
            _calm(state)
        if flag[PHASE] == COARSE:
            _coarse(now, settings, state)
        elif flag[PHASE] == FINE:
            _queue(now, settings, state)
    _new_slot(state)


@njit(**INNER)
def _disturbed(now: float, cause: int, state: State) -> None:
    number, flag = state.number, state.flag
    if not flag[DISTURBED]:
        number[EVENT_AT], flag[EVENT_CAUSE], flag[DISTURBED] = now, cause, 1
        if flag[PHASE] == FINE:
            number[AZIMUTH_0] = azimuth(state.attitude)
            for i in range(3):
                number[UP_0 + i] = state.attitude[2, i]
    number[HOLD_UNTIL] = now + QUIET_S
    number[EVENT_END] = now
    _drop(state)
    if flag[PHASE] == COARSE:
        _clear_coarse(state)
    if now - number[EVENT_AT] > LONGEST_S:
        restart(state)


@njit(**INNER)
def _calm(state: State) -> None:
    """Go on after a disturbance, or start anew when the unit stands otherwise."""
    number, flag = state.number, state.flag
    if flag[PHASE] != FINE:
        flag[DISTURBED] = 0
        _log(state, number[EVENT_AT], number[EVENT_END], 1.0)
        return
    level = 0.0
    for i in range(3):
        level += (state.attitude[2, i] - number[UP_0 + i]) ** 2
    turn = azimuth(state.attitude) - number[AZIMUTH_0]
    turn -= 2.0 * math.pi * round(turn / (2.0 * math.pi))
    if math.sqrt(level) + abs(turn) > LARGEST_TURN:
        restart(state)
        return
    flag[DISTURBED] = 0
    _log(state, number[EVENT_AT], number[EVENT_END], 0.0)


@njit(**INNER)
def _log(state: State, begin: float, end: float, anew: float) -> None:
    log, row = state.log, state.flag[LOGGED] % LOG_ROWS
    log[row, 0], log[row, 1], log[row, 2], log[row, 3] = begin, end, state.flag[EVENT_CAUSE], anew
    state.flag[LOGGED] += 1
    if anew > 0.0:
        state.flag[RESTARTS] += 1


@njit(**INNER)
def _coarse(now: float, settings: FloatArray, state: State) -> None:
    """Add a slot to the averages; begin the fine alignment when there are enough."""
    number, watch = state.number, state.watch
    for i in range(CHANNELS):
        state.coarse[i] += number[SLOT_S] * watch[PREVIOUS, i]
    number[COARSE_TIME] += number[SLOT_S]
    if number[COARSE_TIME] < settings[COARSE_S]:
        return
    up, rate = np.empty(3), np.empty(3)
    for i in range(3):
        rate[i] = state.coarse[i] / number[COARSE_TIME]
        up[i] = state.coarse[3 + i] / number[COARSE_TIME]
    number[GRAVITY] = math.sqrt(dot(up, up))
    if number[GRAVITY] <= 0.0:
        _clear_coarse(state)
        return
    level_attitude(up, rate, state.attitude)
    number[DECAY], number[GAIN] = loop_gains(
        settings[CORNER], settings[DAMPING], number[INTERVAL], number[GRAVITY]
    )
    number[GAIN_INTERVAL] = number[INTERVAL]
    state.reference[0], state.reference[1] = 0.0, EARTH_RATE * math.cos(settings[LATITUDE])
    number[VERTICAL] = dot(state.attitude[2], rate)
    state.velocity[0] = (dot(state.attitude[1], rate) - state.reference[1]) / number[GAIN]
    state.velocity[1] = -dot(state.attitude[0], rate) / number[GAIN]
    number[ROLL_0], number[PITCH_0] = roll_pitch(state.attitude, settings[DOWN])
    number[FINE_AT] = now
    # The level of the coarse alignment is that of its middle: the loop first goes to that of now.
    number[HOLD_UNTIL] = now + max(QUIET_S, SETTLING / (settings[DAMPING] * settings[CORNER]))
    state.flag[PHASE] = FINE
    clear_sums(state)


@njit(**INNER)
def _queue(now: float, settings: FloatArray, state: State) -> None:
    """Keep a slot until the two after it are quiet, too; then add it."""
    flag, number, slot = state.flag, state.number, state.slot
    if slot[0] <= 0.0:
        return
    _known_tilt(now, settings, state)
    number[VERTICAL] += (slot[3] / slot[0] - number[VERTICAL]) * slot[0] / VERTICAL_S
    if flag[PENDING] == 2:
        if add_slot(state, state.pending[0]):
            orthonormal(state.attitude)
            evaluate(state, settings)
            _settle(now, settings, state)
        for i in range(SLOT_VALUES):
            state.pending[0, i] = state.pending[1, i]
        flag[PENDING] = 1
    for i in range(SLOT_VALUES - 1):
        state.pending[flag[PENDING], i] = slot[i]
    state.pending[flag[PENDING], SLOT_VALUES - 1] = now
    flag[PENDING] += 1
    interval = number[INTERVAL]
    if abs(interval - number[GAIN_INTERVAL]) > 0.02 * interval:
        gain = number[GAIN]
        number[DECAY], number[GAIN] = loop_gains(
            settings[CORNER], settings[DAMPING], interval, number[GRAVITY]
        )
        for i in range(2):
            state.velocity[i] *= gain / number[GAIN]
        number[GAIN_INTERVAL] = interval


@njit(**INNER)
def _known_tilt(now: float, settings: FloatArray, state: State) -> None:
    """Put into a slot the change of the level that the known warm-up makes: Φ_E = -a_N / g, Φ_N = a_E / g."""
    for i in range(3):
        tau = settings[WARM_TAU + i]
        if tau <= 0.0:
            return
        grown = math.exp(-(now - state.slot[0]) / tau) - math.exp(-now / tau)
        change = grown * settings[WARM_X + i] / state.number[GRAVITY]
        state.slot[6] -= state.attitude[1, i] * change
        state.slot[7] += state.attitude[0, i] * change


@njit(**INNER)
def _settle(now: float, settings: FloatArray, state: State) -> None:
    number, flag = state.number, state.flag
    if flag[CHOSEN] < 0:
        return
    sd = state.result[flag[CHOSEN], 1]
    if math.isnan(number[SETTLED_AT]):
        if flag[OBSERVED] and sd <= settings[SETTLED]:
            number[SETTLED_AT] = now
    elif not flag[OBSERVED] or sd > STILL_SETTLED * settings[SETTLED]:
        number[SETTLED_AT] = math.nan


@njit(**INNER)
def _show(state: State, settings: FloatArray, out: FloatArray) -> None:
    """Fill a row of the output."""
    number, flag, result = state.number, state.flag, state.result
    out[:] = np.nan
    if flag[PHASE] != FINE:
        return
    chosen = flag[CHOSEN]
    for k in range(ESTIMATORS):
        if flag[OBSERVED] and result[k, 1] < settings[OBSERVABLE]:
            out[MAGNETIC_HEADING + 1 + 2 * k] = result[k, 0]
        out[MAGNETIC_HEADING + 2 + 2 * k] = result[k, 1]
    if chosen >= 0:
        out[HEADING] = out[MAGNETIC_HEADING + 1 + 2 * chosen]
        out[HEADING_SD] = result[chosen, 1]
    out[ROLL], out[PITCH] = roll_pitch(state.attitude, settings[DOWN])
    roll = out[ROLL] - number[ROLL_0]
    out[ROLL_DRIFT] = roll - 2.0 * math.pi * round(roll / (2.0 * math.pi))
    out[PITCH_DRIFT] = out[PITCH] - number[PITCH_0]
    out[RATE_EAST], out[RATE_NORTH] = -number[GAIN] * state.velocity[1], number[GAIN] * state.velocity[0]
    out[ANGLE_EAST], out[ANGLE_NORTH] = state.path[0] + state.tick[4], state.path[1] + state.tick[5]
    out[MAGNETIC_HEADING] = magnetic_heading(state)


@njit(**OUTER)
def level_angles(state: State, settings: FloatArray) -> tuple[float, float]:
    """Return roll and pitch in rad."""
    roll, pitch = roll_pitch(state.attitude, settings[DOWN])
    return float(roll), float(pitch)


@njit(**OUTER)
def magnetic_heading(state: State) -> float:
    """Return the direction of x (or -z) clockwise from magnetic north, rad; NaN when it is not known."""
    if state.mag[3] <= 0.0 or state.flag[PHASE] != FINE:
        return math.nan
    east, north = 0.0, 0.0
    for i in range(3):
        east += state.attitude[0, i] * state.mag[i]
        north += state.attitude[1, i] * state.mag[i]
    return float((azimuth(state.attitude) - math.atan2(east, north)) % (2.0 * math.pi))
