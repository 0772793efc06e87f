"""Operators with memory: first-order lag, play, and the smooth rate-independent loop, one sample after
another.

Each carries its state in an array; NaN there means that nothing was seen yet, and the operator begins in
equilibrium with the first temperature.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit


@njit
def first_order(
    state: FloatArray, time_s: FloatArray, value: FloatArray, time_constant_s: float
) -> FloatArray:
    """Return the value behind a first-order lag, exact for a value that is linear between its times.

    `state` is (3,): lagged value, last time, last value.
    """
    out = np.empty(len(value))
    lagged, last_time, last_value = state[0], state[1], state[2]
    for i in range(len(value)):
        if np.isnan(lagged):
            lagged = value[i]
        else:
            dt = time_s[i] - last_time
            if dt > 0.0:
                x = dt / time_constant_s
                decay = np.exp(-x)
                slope = (value[i] - last_value) / dt
                # The response to a ramp: it follows at distance slope * tau.
                lagged = (
                    value[i]
                    - slope * time_constant_s
                    + (lagged - last_value + slope * time_constant_s) * decay
                )
        last_time = time_s[i]
        last_value = value[i]
        out[i] = lagged
    state[0], state[1], state[2] = lagged, last_time, last_value
    return out


@njit
def play(state: FloatArray, value: FloatArray, half_width: float) -> FloatArray:
    """Return the value behind a backlash of this half width; `state` is (1,): where it stands."""
    out = np.empty(len(value))
    at = state[0]
    for i in range(len(value)):
        if np.isnan(at):
            at = value[i]
        at = min(max(at, value[i] - half_width), value[i] + half_width)
        out[i] = at
    state[0] = at
    return out


@njit
def smooth_loop(state: FloatArray, value: FloatArray, width: float, slack: float) -> FloatArray:
    """Return z of Dahl's loop dz/dT = 1 - z sign(dT)/width, exact for each step of T.

    `slack` is the half width of a backlash before it, so that the noise of a thermometer is no travel.
    `state` is (2,): z, and where the backlash stands.
    """
    out = np.empty(len(value))
    z, at = state[0], state[1]
    for i in range(len(value)):
        if np.isnan(at):
            at, z = value[i], 0.0
        new = min(max(at, value[i] - slack), value[i] + slack)
        travel = new - at
        limit = width if travel > 0.0 else -width
        z = limit + (z - limit) * np.exp(-abs(travel) / width)
        at = new
        out[i] = z
    state[0], state[1] = z, at
    return out
