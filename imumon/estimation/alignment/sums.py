"""Sums over the undisturbed time, from which all estimators are computed: constant memory over hours.

Undisturbed slots are gathered to ticks of a second.  Time in the sums is observed time, without what was left
out; the exponentials of the warm-up go by the clock.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.estimation.alignment.state import (
    CONSTANTS,
    FINE_AT,
    INNER,
    MOMENTS,
    OUTER,
    PAIRS,
    PREVIOUS_TICK,
    TICK_FROM,
    TICK_S,
    TICKS,
    TIME,
    State,
)

TICK = 0.99
"""Length of a tick, s; a little less than four slots."""


@njit(**INNER)
def clear_sums(state: State) -> None:
    """Forget everything that was summed."""
    state.total[:] = 0.0
    state.tick[:] = 0.0
    state.last_tick[:] = 0.0
    state.path[:] = 0.0
    state.line[:] = 0.0
    state.squares[:] = 0.0
    state.moments[:] = 0.0
    state.rate_sums[:] = 0.0
    state.path_sums[:] = 0.0
    state.exponent[:] = 0.0
    state.weighted[:] = 0.0
    state.normal[:] = 0.0
    state.spread[:] = 0.0
    state.right[:] = 0.0
    for name in (TIME, TICK_S, TICK_FROM):
        state.number[name] = 0.0
    for flag in (TICKS, PAIRS, PREVIOUS_TICK):
        state.flag[flag] = 0


@njit(**INNER)
def break_ticks(state: State) -> None:
    """Say that something was left out: the next tick does not follow the last one."""
    if state.tick[0] > 0.0:
        end_tick(state, state.number[TICK_FROM])
    state.flag[PREVIOUS_TICK] = 0


@njit(**INNER)
def add_slot(state: State, values: FloatArray) -> bool:
    """Add a slot, `values` (9,) as in `imumon.estimation.alignment.state`; return whether it ended a tick."""
    if state.tick[0] == 0.0:
        state.number[TICK_FROM] = values[8] - values[0]
    for i in range(8):
        state.tick[i] += values[i]
    if state.tick[0] < TICK:
        return False
    end_tick(state, values[8])
    return True


@njit(**INNER)
def end_tick(state: State, now: float) -> None:
    """Add the gathered tick, which ends `now` (s by the clock), to all sums."""
    tick, number = state.tick, state.number
    _add_noise(state)
    before = number[TIME]
    number[TIME] = before + tick[0]
    for i in range(8):
        state.total[i] += tick[i]
    for axis in range(2):
        state.path[axis] += tick[4 + axis]
        state.path[2 + axis] += tick[4 + axis] - tick[1 + axis]
    _add_line(state)
    _add_polynomials(state, before)
    _add_exponentials(state, number[TICK_FROM] - number[FINE_AT], now - number[FINE_AT])
    state.flag[TICKS] += 1
    tick[:] = 0.0
    number[TICK_FROM] = now


@njit(**INNER)
def _add_noise(state: State) -> None:
    """Sum squared differences of successive ticks: of the rate, and of the steps of the level."""
    tick, last = state.tick, state.last_tick
    if state.flag[PREVIOUS_TICK] and tick[0] > 0.5 * TICK:
        for axis in range(2):
            rate = tick[1 + axis] / tick[0]
            # Each rate has the variance ARW² / s, so their difference twice that.
            change, step = rate - last[axis], tick[4 + axis] - tick[1 + axis] - last[2 + axis]
            state.line[7] += 0.5 * tick[0] * change * change
            state.line[8] += step * step
        state.flag[PAIRS] += 2
    for axis in range(2):
        last[axis] = tick[1 + axis] / tick[0]
        last[2 + axis] = tick[4 + axis] - tick[1 + axis]
    state.flag[PREVIOUS_TICK] = 1


@njit(**INNER)
def _add_line(state: State) -> None:
    """Sums of straight lines through control angle and level: n, t, t², then a and t a of each."""
    t, line = state.number[TIME], state.line
    line[0] += 1.0
    line[1] += t
    line[2] += t * t
    for axis in range(2):
        line[3 + axis] += state.path[axis]
        line[5 + axis] += t * state.path[axis]
        # The level needs Σ φ and Σ t φ: these are the first two of path_sums.


@njit(**INNER)
def _add_polynomials(state: State, before: float) -> None:
    """Moments of time at rates (row 0) and on the path (row 1), and what is regressed on them."""
    tick, t = state.tick, state.number[TIME]
    middle = 0.5 * (before + t)
    rate_power, path_power = 1.0, 1.0
    for k in range(MOMENTS):
        state.moments[0, k] += rate_power * tick[0]
        state.moments[1, k] += path_power
        for axis in range(2):
            if k < 3:
                state.rate_sums[k, axis] += rate_power * tick[1 + axis]
            if k < 4:
                state.path_sums[k, axis] += path_power * state.path[2 + axis]
        rate_power *= middle
        path_power *= t


@njit(**OUTER)
def decay_terms(x: float) -> tuple[float, float]:
    """Return exp(-x) - 1 + x, and x (exp(-x) - 1) + 2 (exp(-x) - 1 + x): about x²/2 and x³/6 for small x."""
    if x < 0.02:
        x2 = x * x
        return x2 * (0.5 - x / 6.0 + x2 / 24.0), x2 * x * (1.0 / 6.0 - x / 12.0 + x2 / 40.0)
    fallen = math.expm1(-x)
    first = fallen + x
    return first, x * fallen + 2.0 * first


@njit(**INNER)
def _add_exponentials(state: State, begin: float, end: float) -> None:
    """Add a point of the control angle to the normal equations of line and exponential.

    Regressors are t, 1 and the two of `decay_terms`; the last stands for an error of the time constant.  The
    noise of the angle is a random walk, with covariance min(t_i, t_j): `spread` is Σ h_i h_j' min(t_i, t_j).
    """
    t = state.number[TIME]
    h = np.empty(4)
    for axis in range(2):
        state.squares[axis] += state.path[axis] * state.path[axis]
    for g in range(len(CONSTANTS)):
        tau = CONSTANTS[g]
        at_begin, at_end = decay_terms(begin / tau), decay_terms(end / tau)
        state.exponent[g, 0] += at_end[0] - at_begin[0]
        state.exponent[g, 1] += at_end[1] - at_begin[1]
        h[0], h[1], h[2], h[3] = 1.0, t / tau, state.exponent[g, 0], state.exponent[g, 1]
        normal, spread, weighted = state.normal[g], state.spread[g], state.weighted[g]
        for i in range(4):
            for j in range(4):
                normal[i, j] += h[i] * h[j]
                spread[i, j] += h[i] * weighted[j] + weighted[i] * h[j] + h[i] * h[j] * t
            for axis in range(2):
                state.right[g, i, axis] += h[i] * state.path[axis]
        for i in range(4):
            weighted[i] += h[i] * t
