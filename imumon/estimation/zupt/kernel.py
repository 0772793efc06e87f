"""From samples to slots of half a second, from slots to the bank of filters: the compiled path of the stage.

A slot at rest counts when the next one is at rest as well: what moved the unit may have begun before it was
noticed.  All biases are less what the thermal model has added since the start: so the samples of a slot, and
the slots of the first minute, refer to one moment without further ado.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.zupt import bank as filters
from imumon.estimation.zupt.bank import Bank, Family
from imumon.estimation.zupt.earth import cross, earth_rate, north, turn
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL

SLOT_S = 0.5
GAP_S = 0.25
"""A pause between samples is a gap when it is longer than this and than three times the pause before."""
LARGEST_TILT = 0.03
"""rad by which a unit at rest may turn until the tilt is measured from a new reference."""
GATE = 25.0
"""A slot whose squared innovation over its variance is beyond this in every filter is taken for movement."""
PATIENCE_S = 300.0
"""After so long of nothing but such slots the bias is taken to have jumped, and all begins anew."""
STILLNESS = 2e-6
"""Velocity over g at the end of a slot at rest, rad s: 0.02 mm/s; what shakes more is in the noise."""
YAW_NOISE = 3e-8
"""How well the heading is known to stand still at rest, rad sqrt(s)."""
ACCEL_WALK = 1e-6
"""Random walk of the accelerometers' biases over g, rad/sqrt(s)."""
LEAST_NOISE, LEAST_TILT_NOISE = 3e-7, 1e-6
"""What no measured noise is believed to be below (rad/sqrt(s), rad sqrt(s)): readings that do not change."""
NOISE_MEMORY = 1200.0
"""Slots over which the noise is averaged."""
NOISE_NEEDED = 6
"""Second differences of slots before the noise is believed."""
EFFECTIVE = 1.94
"""Second differences that say as much as one independent value."""
CLIP = 16.0
"""A squared second difference counts as no more than this times its mean."""
TURN_SD = 0.01
"""Error of the heading after a turn, over the angle turned."""
MIX_S = 5.0
"""The filters of the bank share what they know this often."""
FORGETTING_S = 600.0
"""Memory of the evidence for a slope."""
TRAVEL_DEGC = 0.5
"""The temperature has travelled when it is this far from where it was last noted: noise does not count."""
SIGNIFICANCE, EVIDENCE = 9.0, 8.0
"""A slope is used when d^2 > 9 P_dd and the log-likelihoods differ by more than 8 in its favour."""
REFILTERED = (8, 30)
"""Slots of the first rest after which, besides its end, all of it is filtered anew with the noise known."""

# Rows of State.vector, (rows, 3); bias, sd, slope and temperature of the estimate; north and up in body axes.
BIAS, SD, DRIFT, AT_DEGC, NORTH, UP, EARTH = range(7)
# Sums of the slot; means of the slot that waits for the next; the last two that counted.
SUM_RATE, SUM_FORCE, SUM_DEGC, SUM_GROWTH = 7, 8, 9, 10
RATE, TILT, DEGC, GROWTH = 11, 12, 13, 14
RATE_1, RATE_2, TILT_1, TILT_2 = 15, 16, 17, 18
# Noise: sums of squared second differences and the result; evidence and verdict on the slope; last growth;
# what coming to rest in another attitude adds to the variance.
SQUARES, NOISE, EVIDENCE_SUM, CHOSEN, GROWTH_USED, ARRIVAL = 19, 20, 21, 22, 23, 24
# Temperature where travel was last noted.
NOTED = 25
VECTORS = 26
# State.number: times in s, and the angle turned since the unit left its last rest.
LAST, PAUSE, SLOT_START, WAIT_START, WAIT_STOP, USED, TURNED, LEFT, GRAVITY = range(9)
TILT_SQUARES, TILT_NOISE, NOISE_COUNT, OUTLIERS_S, UNMIXED = 9, 10, 11, 12, 13
NUMBERS = 14
# State.flag.
SEEN, AT_REST, FRESH, WAITING, WAIT_FRESH, STARTED, ZEROED, COUNT, FORCES, CONSECUTIVE, PLACED = range(11)
JUMPS, RESTED = 11, 12
FLAGS = 13
# Columns of a slot in State.first: rate, tilt, temperature, growth, and times.
SLOT_COLUMNS = 14


class State(NamedTuple):
    """All that is carried from sample to sample."""

    bank: Bank
    vector: FloatArray
    number: FloatArray
    flag: IntArray
    body: FloatArray
    first: FloatArray


class Settings(NamedTuple):
    """What does not change.

    Parameters
    ----------
    family : Family
        Filters of the bank.
    noise : array (3,)
        Angular random walk, rad/sqrt(s); NaN where it is to be measured.
    tilt_noise : float
        Velocity random walk, m/s/sqrt(s); NaN when it is to be measured.
    latitude, heading : float
        rad; NaN when they are not known.
    """

    family: Family
    noise: FloatArray
    tilt_noise: float
    latitude: float
    heading: float


def empty_state(settings: Settings, learns: bool, zeroing_s: float) -> State:
    """Return a state that has seen nothing."""
    return State(
        filters.empty_bank(6 if learns else 3, len(settings.family.prior)),
        np.zeros((VECTORS, 3)),
        np.zeros(NUMBERS),
        np.zeros(FLAGS, np.int64),
        np.eye(3),
        np.zeros((max(NOISE_NEEDED + 2, round(zeroing_s / SLOT_S)), SLOT_COLUMNS)),
    )


@njit(cache=True, nogil=True)
def restart(state: State) -> None:
    """Begin anew as after a restart of the device; what is known of the noise stays."""
    vector, flag = state.vector, state.flag
    for row in range(VECTORS):
        if row not in (SQUARES, NOISE):
            vector[row, :] = 0.0
    vector[BIAS, :] = vector[SD, :] = np.nan
    jumps = flag[JUMPS]
    flag[:] = 0
    flag[JUMPS] = jumps
    state.number[OUTLIERS_S] = 0.0


@njit(cache=True, nogil=True)
def process(
    seconds: FloatArray,
    gyro: FloatArray,
    accel: FloatArray,
    rest: npt.NDArray[np.bool_],
    thermal: FloatArray,
    growth: FloatArray,
    temperature: FloatArray,
    settings: Settings,
    state: State,
    bias: FloatArray,
    sd: FloatArray,
    innovation: FloatArray,
) -> None:
    """Follow the bias through samples of one segment; fill bias and sd, (n, 3), and the innovations seen.

    Parameters
    ----------
    seconds : array (n,)
        Time, s.
    gyro, accel : array (n, 3)
        rad/s, m/s^2; NaN where there is none.
    rest : array (n,) of bool
    thermal, growth : array (n, 3)
        What the thermal model has added to the bias so far (rad/s), and to its variance; without NaN.
    temperature : array (n, 3)
        °C of each gyro, for the learned mode; NaN before the first.
    """
    vector, number, flag = state.vector, state.number, state.flag
    for i in range(len(seconds)):
        if math.isfinite(gyro[i, 0] + gyro[i, 1] + gyro[i, 2]):
            t = seconds[i]
            pause = t - number[LAST]
            gap = not flag[SEEN] or pause > max(GAP_S, 3.0 * number[PAUSE])
            if gap or flag[AT_REST] != rest[i]:
                _change(t, gap, rest[i], settings, state)
            if not gap:
                if rest[i]:
                    _add(i, gyro, accel, thermal, temperature, vector, flag)
                else:
                    _move(i, pause, gyro, thermal, vector, number, state.body)
                if t - number[SLOT_START] >= SLOT_S - 1e-6:
                    _end(i, t, rest[i], growth, temperature, settings, state, innovation)
            number[LAST], number[PAUSE] = t, pause
        for j in range(3):
            bias[i, j] = vector[BIAS, j] + thermal[i, j]
            if vector[DRIFT, j] != 0.0 and math.isfinite(temperature[i, j]):
                bias[i, j] += vector[DRIFT, j] * (temperature[i, j] - vector[AT_DEGC, j])
            sd[i, j] = vector[SD, j]


@njit(cache=True, nogil=True)
def _change(t: float, gap: bool, rest: bool, settings: Settings, state: State) -> None:
    """Begin, leave a rest, come to one, or note a gap in the data before time t."""
    number, flag = state.number, state.flag
    if not flag[SEEN]:
        flag[SEEN], number[PAUSE] = 1, 0.0
        number[LAST] = number[USED] = number[LEFT] = t
    elif flag[AT_REST]:
        _leave(settings, state, number[LAST])
    if rest:
        flag[AT_REST], flag[FRESH], flag[WAITING] = 1, 1, 0
    _open(state, t if gap else number[LAST])


@njit(cache=True, nogil=True)
def _add(
    i: int,
    gyro: FloatArray,
    accel: FloatArray,
    thermal: FloatArray,
    temperature: FloatArray,
    vector: FloatArray,
    flag: IntArray,
) -> None:
    """Add a sample at rest to its slot."""
    for j in range(3):
        vector[SUM_RATE, j] += gyro[i, j] - thermal[i, j]
        vector[SUM_DEGC, j] += temperature[i, j]
    flag[COUNT] += 1
    if math.isfinite(accel[i, 0] + accel[i, 1] + accel[i, 2]):
        flag[FORCES] += 1
        for j in range(3):
            vector[SUM_FORCE, j] += accel[i, j]


@njit(cache=True, nogil=True)
def _move(
    i: int,
    pause: float,
    gyro: FloatArray,
    thermal: FloatArray,
    vector: FloatArray,
    number: FloatArray,
    body: FloatArray,
) -> None:
    """Follow a turn, sample by sample."""
    known = math.isfinite(vector[BIAS, 0])
    x, y, z = gyro[i, 0] * pause, gyro[i, 1] * pause, gyro[i, 2] * pause
    if known:
        x -= (vector[BIAS, 0] + thermal[i, 0]) * pause
        y -= (vector[BIAS, 1] + thermal[i, 1]) * pause
        z -= (vector[BIAS, 2] + thermal[i, 2]) * pause
    number[TURNED] += math.sqrt(x * x + y * y + z * z)
    turn(body, x, y, z)


@njit(cache=True, nogil=True)
def _end(
    i: int,
    t: float,
    rest: bool,
    growth: FloatArray,
    temperature: FloatArray,
    settings: Settings,
    state: State,
    innovation: FloatArray,
) -> None:
    """End the slot at time t."""
    if rest:
        state.vector[SUM_GROWTH, :] = growth[i]
        _close(i, t, settings, state, innovation)
    else:
        if state.flag[STARTED]:
            _coast(t, growth[i], temperature[i], settings, state)
            _show(state)
        _open(state, t)


@njit(cache=True, nogil=True)
def _open(state: State, t: float) -> None:
    """Begin a slot after time t."""
    state.number[SLOT_START] = t
    state.flag[COUNT] = state.flag[FORCES] = 0
    for row in (SUM_RATE, SUM_FORCE, SUM_DEGC):
        state.vector[row, :] = 0.0


@njit(cache=True, nogil=True)
def _leave(settings: Settings, state: State, t: float) -> None:
    """Note that the unit is at rest no more; what the last slot was like nobody knows."""
    flag = state.flag
    if not flag[ZEROED]:
        _refilter(settings, state)
        flag[ZEROED] = flag[STARTED]
        flag[RESTED] = 0
    flag[AT_REST] = flag[WAITING] = flag[CONSECUTIVE] = 0
    state.number[TURNED] = 0.0
    state.number[LEFT] = t
    state.body[:] = np.eye(3)
    _open(state, t)


@njit(cache=True, nogil=True)
def _close(i: int, t: float, settings: Settings, state: State, innovation: FloatArray) -> None:
    """End a slot at rest: let the one before count, and keep this one until the next."""
    number, flag, vector = state.number, state.flag, state.vector
    if flag[FRESH]:
        _arrive(t, settings, state)
    tilt = np.zeros(3)
    usable = (flag[FORCES] > 0) == (number[GRAVITY] > 0.0)
    if usable and flag[FORCES]:
        tilt = cross(vector[SUM_FORCE] / (flag[FORCES] * number[GRAVITY]) - vector[UP], vector[UP])
        usable = (tilt * tilt).sum() < LARGEST_TILT**2
    if not usable:
        # It has turned, or the accelerometers have come or gone: as if it came to rest here.
        _leave(settings, state, t)
        flag[AT_REST] = flag[FRESH] = 1
        return
    if flag[WAITING]:
        _count(i, settings, state, innovation)
    flag[WAITING], flag[WAIT_FRESH], flag[FRESH] = 1, flag[FRESH], 0
    number[WAIT_START], number[WAIT_STOP] = number[SLOT_START], t
    for j in range(3):
        vector[RATE, j] = vector[SUM_RATE, j] / flag[COUNT] - vector[EARTH, j]
        vector[TILT, j] = tilt[j]
        vector[DEGC, j] = vector[SUM_DEGC, j] / flag[COUNT]
        vector[GROWTH, j] = vector[SUM_GROWTH, j]
    _open(state, t)


@njit(cache=True, nogil=True)
def _arrive(t: float, settings: Settings, state: State) -> None:
    """Take the attitude of a new rest from its first slot, and the earth rate in body axes with it."""
    number, flag, vector = state.number, state.flag, state.vector
    up, before = vector[UP], vector[UP].copy()
    number[GRAVITY] = 0.0
    if flag[FORCES]:
        up[:] = vector[SUM_FORCE] / flag[FORCES]
        number[GRAVITY] = math.sqrt((up * up).sum())
        if number[GRAVITY] > 0.0:
            up /= number[GRAVITY]
    placed = flag[PLACED] and number[GRAVITY] > 0.0
    horizontal = EARTH_RATE * (math.cos(settings.latitude) if math.isfinite(settings.latitude) else 1.0)
    oriented = math.isfinite(settings.heading) and math.isfinite(settings.latitude)
    if placed and oriented:
        northward = state.body @ vector[NORTH]
        northward -= (northward * up).sum() * up
        length = math.sqrt((northward * northward).sum())
        heading_sd = min(1.0, TURN_SD * number[TURNED] + (t - number[LEFT]) * vector[SD].max())
        if length > LEAST_HORIZONTAL:
            vector[NORTH] = northward / length
        else:
            vector[NORTH], heading_sd = north(up, settings.heading), 1.0
        for j in range(3):
            if math.isfinite(heading_sd):
                vector[ARRIVAL, j] += (horizontal * heading_sd) ** 2 * (1.0 - up[j] ** 2)
    elif oriented and number[GRAVITY] > 0.0:
        vector[NORTH] = north(up, settings.heading)
    elif placed:
        _turned_earth(before, horizontal, settings, state)
    if number[GRAVITY] > 0.0:
        flag[PLACED] = 1
        if math.isfinite(settings.latitude):
            vector[EARTH] = earth_rate(up, vector[NORTH], settings.latitude)


@njit(cache=True, nogil=True)
def _turned_earth(up: FloatArray, horizontal: float, settings: Settings, state: State) -> None:
    """Cover what a turn does to the part of the earth rate that is taken for bias, its direction unknown."""
    change = state.body - np.eye(3)
    shape = np.eye(3) * horizontal**2 / 3.0
    if math.isfinite(settings.latitude):
        for a in range(3):
            for b in range(3):
                shape[a, b] = 0.5 * horizontal**2 * ((1.0 if a == b else 0.0) - up[a] * up[b])
    cover = change @ shape @ change.T
    for j in range(3):
        state.vector[ARRIVAL, j] += cover[j, j]


@njit(cache=True, nogil=True)
def _count(i: int, settings: Settings, state: State, innovation: FloatArray) -> None:
    """Let the slot that waits count: for the noise, and for the bias."""
    number, flag, vector = state.number, state.flag, state.vector
    _learn_noise(state)
    if not flag[ZEROED]:
        first, k = state.first, flag[RESTED]
        for j in range(3):
            first[k, j], first[k, 3 + j] = vector[RATE, j], vector[TILT, j]
            first[k, 6 + j] = vector[DEGC, j]
            first[k, 9 + j] = vector[GROWTH, j]
        first[k, 12], first[k, 13] = number[WAIT_START], number[WAIT_STOP]
        flag[RESTED] += 1
        if flag[STARTED]:
            _take(i, settings, state, innovation)
        if flag[RESTED] in REFILTERED or flag[RESTED] == len(first) or not flag[STARTED]:
            _refilter(settings, state)
        if flag[RESTED] == len(first):
            flag[ZEROED], flag[RESTED] = flag[STARTED], 0
    else:
        _take(i, settings, state, innovation)
    if flag[STARTED]:
        _show(state)


@njit(cache=True, nogil=True)
def _learn_noise(state: State) -> None:
    """Take the slot that waits into the noise, by second differences: neither offset nor ramp is in them."""
    number, flag, vector = state.number, state.flag, state.vector
    dt = number[WAIT_STOP] - number[WAIT_START]
    if flag[WAIT_FRESH]:
        flag[CONSECUTIVE] = 0
    if flag[CONSECUTIVE] >= 2:
        keep = 1.0 - 1.0 / NOISE_MEMORY
        believed = number[NOISE_COUNT] >= NOISE_NEEDED
        tilt = 0.0
        for j in range(3):
            off = vector[RATE, j] - 2.0 * vector[RATE_1, j] + vector[RATE_2, j]
            square = off * off * dt / 6.0
            if believed:
                square = min(square, CLIP * vector[SQUARES, j] / number[NOISE_COUNT])
            vector[SQUARES, j] = keep * vector[SQUARES, j] + square
            off = vector[TILT, j] - 2.0 * vector[TILT_1, j] + vector[TILT_2, j]
            tilt += off * off * dt / 12.0
        if believed:
            tilt = min(tilt, CLIP * number[TILT_SQUARES] / number[NOISE_COUNT])
        number[TILT_SQUARES] = keep * number[TILT_SQUARES] + tilt
        number[NOISE_COUNT] = keep * number[NOISE_COUNT] + 1.0
    for j in range(3):
        vector[RATE_2, j], vector[RATE_1, j] = vector[RATE_1, j], vector[RATE, j]
        vector[TILT_2, j], vector[TILT_1, j] = vector[TILT_1, j], vector[TILT, j]
    flag[CONSECUTIVE] += 1


@njit(cache=True, nogil=True)
def _set_noise(settings: Settings, state: State) -> bool:
    """Set the noise to use and return whether it is known; of few values it is widened as Student's is."""
    number, vector = state.number, state.vector
    count = number[NOISE_COUNT]
    known, degrees = count >= NOISE_NEEDED, count / EFFECTIVE
    widening = degrees / (degrees - 2.0) if known else 1.0
    for j in range(3):
        if math.isfinite(settings.noise[j]):
            vector[NOISE, j] = settings.noise[j]
        elif known:
            vector[NOISE, j] = max(LEAST_NOISE, math.sqrt(widening * vector[SQUARES, j] / count))
        else:
            return False
    if math.isfinite(settings.tilt_noise):
        number[TILT_NOISE] = settings.tilt_noise / max(number[GRAVITY], 1.0)
    elif known:
        number[TILT_NOISE] = max(LEAST_TILT_NOISE, math.sqrt(number[TILT_SQUARES] / count))
    else:
        return False
    return True


@njit(cache=True, nogil=True)
def _refilter(settings: Settings, state: State) -> None:
    """Filter all slots since the start anew, with the noise as it is known now."""
    number, flag, vector = state.number, state.flag, state.vector
    if flag[RESTED] == 0 or not _set_noise(settings, state):
        return
    kept = vector[RATE : GROWTH + 1].copy()
    start, stop = number[WAIT_START], number[WAIT_STOP]
    filters.start(state.bank, settings.family, vector[NOISE])
    filters.come_to_rest(state.bank, _flat(state))
    vector[EVIDENCE_SUM, :] = number[UNMIXED] = 0.0
    unused = np.empty((1, 3))
    for k in range(flag[RESTED]):
        slot = state.first[k]
        for j in range(3):
            vector[RATE, j], vector[TILT, j], vector[DEGC, j] = slot[j], slot[3 + j], slot[6 + j]
            vector[GROWTH, j] = slot[9 + j]
        number[WAIT_START], number[WAIT_STOP] = slot[12], slot[13]
        if k == 0:
            number[USED] = slot[12]
            vector[AT_DEGC, :] = vector[NOTED, :] = vector[DEGC]
            vector[GROWTH_USED, :] = vector[GROWTH]
        flag[WAIT_FRESH] = 0
        _take(0, settings, state, unused)
    flag[STARTED] = 1
    vector[RATE : GROWTH + 1] = kept
    number[WAIT_START], number[WAIT_STOP] = start, stop
    _show(state)


@njit(cache=True, nogil=True)
def _coast(t: float, growth: FloatArray, temperature: FloatArray, settings: Settings, state: State) -> None:
    """Bring the biases to time t and temperature, without a measurement."""
    vector, bank = state.vector, state.bank
    dt = t - state.number[USED]
    for row in range(bank.x.shape[0]):
        axis = row % 3
        warming, travel = temperature[axis] - vector[AT_DEGC, axis], 0.0
        more = growth[axis] - vector[GROWTH_USED, axis]
        if not math.isfinite(warming):
            warming = 0.0
        elif row >= 3:
            travel = abs(temperature[axis] - vector[NOTED, axis])
            travel = travel if travel >= TRAVEL_DEGC else 0.0
        filters.wander(bank, row, settings.family, dt, vector[NOISE, axis], warming, travel, more)
    for axis in range(3):
        vector[GROWTH_USED, axis] = growth[axis]
        if math.isfinite(temperature[axis]):
            vector[AT_DEGC, axis] = temperature[axis]
            if abs(temperature[axis] - vector[NOTED, axis]) >= TRAVEL_DEGC:
                vector[NOTED, axis] = temperature[axis]
    state.number[USED] = t


@njit(cache=True, nogil=True)
def _flat(state: State) -> FloatArray:
    """Return the share of the rotation about each axis that gravity shows, (3,)."""
    known = 1.0 if state.number[GRAVITY] > 0.0 else 0.0
    flat: FloatArray = known * (1.0 - state.vector[UP] ** 2)
    return flat


@njit(cache=True, nogil=True)
def _take(i: int, settings: Settings, state: State, innovation: FloatArray) -> None:
    """Take the slot that waits into the bank."""
    number, flag, vector, bank = state.number, state.flag, state.vector, state.bank
    _set_noise(settings, state)
    dt = number[WAIT_STOP] - number[WAIT_START]
    _coast(number[WAIT_STOP], vector[GROWTH], vector[DEGC], settings, state)
    # Only at rest: nothing is learned of the bias while it moves, and doubts that only add up help nobody.
    number[UNMIXED] += dt
    if number[UNMIXED] >= MIX_S:
        for row in range(bank.x.shape[0]):
            filters.mix(bank, row, settings.family, number[UNMIXED])
        number[UNMIXED] = 0.0
    flat = _flat(state)
    if flag[WAIT_FRESH]:
        filters.come_to_rest(bank, flat)
        for row in range(bank.x.shape[0]):
            bank.p[row, :, filters.WALK, filters.WALK] += vector[ARRIVAL, row % 3]
        vector[ARRIVAL, :] = 0.0
    unexpected = 0.0
    for row in range(bank.x.shape[0]):
        axis = row % 3
        # Of the rotation about this axis gravity shows the horizontal part, the heading held shows the rest.
        tilt2 = flat[axis] * number[TILT_NOISE] ** 2 + (1.0 - flat[axis]) * YAW_NOISE**2
        noise2 = vector[NOISE, axis] ** 2 + flat[axis] * ACCEL_WALK**2
        sway2 = flat[axis] * STILLNESS**2
        rate, tilt = vector[RATE, axis], vector[TILT, axis]
        filters.rotate(bank, row, dt, rate, tilt, noise2, tilt2, sway2)
        if row < 3:
            innovation[i, axis] = filters.innovation(bank, row)
            unexpected = max(unexpected, filters.surprise(bank, row))
        elif vector[CHOSEN, axis]:
            innovation[i, axis] = filters.innovation(bank, row)
    if unexpected > GATE:
        _refuse(dt, state)
        return
    number[OUTLIERS_S] = 0.0
    fade = math.exp(-dt / FORGETTING_S)
    for axis in range(3):
        plain = filters.correct(bank, axis)
        if bank.x.shape[0] > 3:
            learned = filters.correct(bank, 3 + axis)
            vector[EVIDENCE_SUM, axis] = fade * vector[EVIDENCE_SUM, axis] + learned - plain
            d, variance = filters.slope(bank, 3 + axis)
            found = d * d > SIGNIFICANCE * variance and vector[EVIDENCE_SUM, axis] > EVIDENCE
            vector[CHOSEN, axis] = 1.0 if found else 0.0


@njit(cache=True, nogil=True)
def _refuse(dt: float, state: State) -> None:
    """Take a slot for movement: what is known of the rotation is forgotten; if it goes on, all is."""
    state.number[OUTLIERS_S] += dt
    filters.come_to_rest(state.bank, _flat(state))
    if state.number[OUTLIERS_S] > PATIENCE_S:
        state.number[OUTLIERS_S] = 0.0
        state.flag[STARTED] = state.flag[ZEROED] = state.flag[RESTED] = 0
        state.flag[JUMPS] += 1
        state.vector[BIAS, :] = state.vector[SD, :] = np.nan


@njit(cache=True, nogil=True)
def _show(state: State) -> None:
    """Make the estimate of the bank the one that is shown.

    The standard deviation is that of both estimates, with and without slope, each by its likelihood: a slope
    that is not proven may be there all the same.
    """
    vector, bank = state.vector, state.bank
    for axis in range(3):
        value, variance = filters.bias(bank, axis)
        vector[DRIFT, axis] = 0.0
        if bank.x.shape[0] > 3:
            other, spread = filters.bias(bank, 3 + axis)
            share = 1.0 / (1.0 + math.exp(-vector[EVIDENCE_SUM, axis]))
            if vector[CHOSEN, axis]:
                value, variance, other, spread, share = other, spread, value, variance, 1.0 - share
                vector[DRIFT, axis] = filters.slope(bank, 3 + axis)[0]
            variance += share * (spread - variance + (other - value) ** 2)
        vector[BIAS, axis], vector[SD, axis] = value, math.sqrt(variance)
