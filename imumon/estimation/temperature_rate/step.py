"""The quantization step of a sensor, found from its readings."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.compiled import njit

TINY = 1e-6
"""°C; two readings closer than this are the same, and no step is smaller."""
SUPPORT_NEEDED, CHANGES_NEEDED = 8, 100
"""Changes after which a step is known; and after which it is known that there is none."""
MISFIT_ALLOWED = 0.2
FAR_STEPS = 8.5
"""Changes of more steps than this tell nothing: rounding of the step would make any of them a multiple."""
MEMORY = 1.0 / 32.0

# State: the step, the share of changes that are no multiples of it, those that are, and all.
STEP, MISFIT, SUPPORT, SEEN = range(4)
_LAST = 4


@njit
def learn_step(change: float, state: FloatArray) -> None:
    """Learn from a change of the reading, > 0: the step is the least, of which the others are multiples."""
    state[SEEN] += 1.0
    ratio = change / state[STEP]
    if state[SUPPORT] == 0.0 or ratio < 0.75:
        # A declared or assumed step gives way to the first change; a larger one to a smaller.
        state[STEP], state[MISFIT], state[SUPPORT] = change, 0.0, 1.0
        return
    if ratio > FAR_STEPS:
        return
    whole = round(ratio)
    if abs(ratio - whole) < 0.15:
        state[SUPPORT] += 1.0
        state[MISFIT] -= MEMORY * state[MISFIT]
        if whole == 1.0:
            state[STEP] += (change - state[STEP]) / min(state[SUPPORT], 64.0)
    else:
        state[MISFIT] += MEMORY * (1.0 - state[MISFIT])


@njit
def _scan(readings: FloatArray, state: FloatArray) -> None:
    for reading in readings:
        if math.isfinite(reading):
            change = abs(reading - state[_LAST])
            if change > TINY:
                learn_step(change, state)
            state[_LAST] = reading


class StepFinder:
    """Finds the step of one channel and says when it is not the declared one.

    Parameters
    ----------
    declared : float
        The step in °C that the sensor is said to have.
    """

    def __init__(self, declared: float) -> None:
        self._declared = declared
        self._state = np.array([declared, 0.0, 0.0, 0.0, np.nan])

    @property
    def step(self) -> float | None:
        """The step in °C, None as long as the readings show none."""
        known = self._state[SUPPORT] >= SUPPORT_NEEDED and self._state[MISFIT] < MISFIT_ALLOWED
        return float(self._state[STEP]) if known else None

    def process(self, reading: FloatArray) -> None:
        """Learn from readings, (n,), °C."""
        _scan(reading, self._state)

    def contradiction(self) -> str | None:
        """Return what the readings show instead of the declared step, or None."""
        step = self.step
        if step is not None and abs(step / self._declared - 1.0) > MISFIT_ALLOWED:
            return f"the readings change in steps of {step:.4g} °C, not of {self._declared:.4g} °C"
        if step is None and self._state[SEEN] >= CHANGES_NEEDED:
            return f"the readings do not change in steps of {self._declared:.4g} °C, nor in any other"
        return None
