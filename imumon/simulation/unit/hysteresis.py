"""Thermal hysteresis: what of the way to a temperature stays in the bias."""

from __future__ import annotations

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit
from imumon.simulation.unit.parameters import Hysteresis


@njit
def smooth_loop(temperature: FloatArray, state: FloatArray, width: float, out: FloatArray) -> None:
    """Write y of y' = (T' - |T'| y) / w, exact for a temperature that is monotone between samples.

    `temperature` and `out` have shape (n, 3); `state` (2, 3) holds the last T and y of each axis.
    """
    for i in range(temperature.shape[0]):
        for axis in range(temperature.shape[1]):
            change = temperature[i, axis] - state[0, axis]
            if change != 0.0:
                goal = 1.0 if change > 0.0 else -1.0
                state[1, axis] = goal + (state[1, axis] - goal) * np.exp(-abs(change) / width)
                state[0, axis] = temperature[i, axis]
            out[i, axis] = state[1, axis]


@njit
def play_loop(temperature: FloatArray, state: FloatArray, width: float, out: FloatArray) -> None:
    """Write y = (T - p) / w of the play p = max(T - w, min(T + w, p)); arguments as of `smooth_loop`."""
    for i in range(temperature.shape[0]):
        for axis in range(temperature.shape[1]):
            position = state[0, axis] - width * state[1, axis]
            position = max(temperature[i, axis] - width, min(temperature[i, axis] + width, position))
            state[0, axis] = temperature[i, axis]
            state[1, axis] = (temperature[i, axis] - position) / width
            out[i, axis] = state[1, axis]


_LOOPS = {"smooth": smooth_loop, "play": play_loop}


class HysteresisLoop:
    """The loop of each axis, from y = 0 at the first temperature on.

    Parameters
    ----------
    parameters : Hysteresis
    start_degc : array of shape (3,)
        Temperature at power-on.
    """

    def __init__(self, parameters: Hysteresis, start_degc: FloatArray) -> None:
        self._loop = _LOOPS[parameters.kind]
        self._width = float(parameters.width_degc)
        self._state = np.vstack([start_degc, np.zeros(3)])

    def process(self, temperature_degc: FloatArray) -> FloatArray:
        """Return y, between -1 and 1, at the next temperatures; both of shape (n, 3)."""
        out = np.empty_like(temperature_degc)
        self._loop(temperature_degc, self._state, self._width, out)
        return out
