"""Operators with memory, one sample after another: first-order lag, play, smooth rate-independent loop.

The last values before a block come in as numbers; NaN means that there were none, and the operator
begins in equilibrium with the first value.
"""

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit


@njit
def first_order(
    time_s: FloatArray,
    value: FloatArray,
    time_constant_s: float,
    last_time_s: float,
    last_value: float,
    lagged: float,
) -> FloatArray:
    """Return the value behind a first-order lag, exact for a value that is linear between its times.

    The response to a ramp: it follows at distance slope times time constant.
    """
    out = np.empty(len(value))
    for i in range(len(value)):
        if np.isnan(lagged):
            lagged = value[i]
        else:
            dt = time_s[i] - last_time_s
            if dt > 0.0:
                behind = (value[i] - last_value) / dt * time_constant_s
                decay = np.exp(-dt / time_constant_s)
                lagged = value[i] - behind + (lagged - last_value + behind) * decay
        last_time_s, last_value = time_s[i], value[i]
        out[i] = lagged
    return out


@njit
def play(value: FloatArray, half_width: float, at: float) -> FloatArray:
    """Return the value behind a backlash of this half width; `at` is where it stood."""
    out = np.empty(len(value))
    for i in range(len(value)):
        if np.isnan(at):
            at = value[i]
        at = min(max(at, value[i] - half_width), value[i] + half_width)
        out[i] = at
    return out


@njit
def smooth_loop(value: FloatArray, width: float, last_value: float, ahead: float) -> FloatArray:
    """Return z of Dahl's loop dz/dT = 1 - z sign(dT)/width, exact for each step; `ahead` is the last z."""
    out = np.empty(len(value))
    for i in range(len(value)):
        if np.isnan(last_value):
            last_value, ahead = value[i], 0.0
        change = value[i] - last_value
        if change != 0.0:
            limit = width if change > 0.0 else -width
            ahead = limit + (ahead - limit) * np.exp(-abs(change) / width)
        last_value = value[i]
        out[i] = ahead
    return out
