"""What the alignment remembers: a few small arrays, the same size for ever."""

from __future__ import annotations

from typing import Any, Protocol, cast

import numpy as np

from imumon.blocks import FloatArray, IntArray

OUTER: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""How numba compiles what Python calls."""
INNER = {**OUTER, "no_cpython_wrapper": True}
"""How numba compiles what only compiled code calls: without an entry for Python, which takes time to make."""

ESTIMATORS = 5
"""Total average, curve fit, line and exponential, tilt-corrected, known warm-up."""
LEARNED = 12
"""Slots from which the noise is learnt before anything is judged."""
CHANNELS = 6
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
MOMENTS = 7
CONSTANTS = np.geomspace(20.0, 2000.0, 26)
"""Time constants of the warm-up that are tried, s."""

# Settings, floats.
(COARSE_S, CORNER, DAMPING, LATITUDE, OBSERVABLE, BIAS_SD, LEVEL_SD, LARGEST_DRIFT, SETTLED, DOWN,
 WARM_X, _WARM_Y, _WARM_Z, WARM_TAU, _WARM_TAU_Y, _WARM_TAU_Z, WARM_SD, WARM_TAU_SD) = range(18)  # fmt: skip
SETTINGS = 18

# State, floats.
(LAST, INTERVAL, DECAY, GAIN, GAIN_INTERVAL, GRAVITY, SLOT_S, HOLD_UNTIL, EVENT_AT, VERTICAL,
 COARSE_TIME, TIME, TICK_S, TICK_FROM, ARW2, TILT2, BIAS_VARIANCE, BETTER_FOR, ROLL_0, PITCH_0, AZIMUTH_0,
 SETTLED_AT, EVENT_END, FINE_AT, REAL_TILT, UP_0, _UP_1, _UP_2) = range(28)  # fmt: skip
FLOATS = 28

# State, integers.
(PHASE, SLOTS, REST, COUNT, PENDING, TICKS, CHOSEN, BETTER, OBSERVED, STRIKES, PAIRS, PREVIOUS_TICK,
 EVENT_CAUSE, CONTRADICTED, DISTURBED, LOGGED, RESTARTS, SHAKEN) = range(18)  # fmt: skip
INTEGERS = 18

WAITING, COARSE, FINE = range(3)

# Rows of `watch`, one value per channel.
REFERENCE, SUM, SQUARES, BASE, PREVIOUS, MEAN_VAR, SAMPLE_VAR = range(7)

# Rows of `log`: begin and end by the clock, what disturbed, and whether the alignment began anew.
LOG_ROWS = 16

# Values of a slot on its way to the sums: s, gyro angle (3), control angle (2), known tilt (2), its time.
SLOT_VALUES = 9


class State(Protocol):
    """Arrays of one alignment, side by side in one record of `RECORD`.

    number (FLOATS,), flag (INTEGERS,), attitude (3, 3), velocity (2,), reference (3,) rate of the frame,
    turned (5,) of one sample, watch (7, 6), learning (12, 12), coarse (6,) sums, slot (8,), pending (2, 9),
    total (8,) and tick (8,) as slots without their time, last_tick (4,), path (4,) control angle and level at
    the end of the last tick, line (9,) sums of straight lines and of noise, moments (2, 7) of rate and path,
    rate_sums (3, 2), path_sums (4, 2), and for each time constant exponent (G, 2), normal (G, 4, 4),
    spread (G, 4, 4), weighted (G, 4), right (G, 4, 2), squares (2,); mag (4,) sums of the field,
    log (LOG_ROWS, 4) of the last disturbances, result (ESTIMATORS, 2) heading and sigma.
    """

    number: FloatArray
    flag: IntArray
    attitude: FloatArray
    velocity: FloatArray
    reference: FloatArray
    turned: FloatArray
    watch: FloatArray
    learning: FloatArray
    coarse: FloatArray
    slot: FloatArray
    pending: FloatArray
    total: FloatArray
    tick: FloatArray
    last_tick: FloatArray
    path: FloatArray
    line: FloatArray
    moments: FloatArray
    rate_sums: FloatArray
    path_sums: FloatArray
    exponent: FloatArray
    normal: FloatArray
    spread: FloatArray
    weighted: FloatArray
    right: FloatArray
    squares: FloatArray
    mag: FloatArray
    log: FloatArray
    result: FloatArray


_G = len(CONSTANTS)
RECORD = np.dtype(
    [
        ("number", np.float64, FLOATS),
        ("flag", np.int64, INTEGERS),
        ("attitude", np.float64, (3, 3)),
        ("velocity", np.float64, 2),
        ("reference", np.float64, 3),
        ("turned", np.float64, 5),
        ("watch", np.float64, (7, CHANNELS)),
        ("learning", np.float64, (LEARNED, 2 * CHANNELS)),
        ("coarse", np.float64, CHANNELS),
        ("slot", np.float64, SLOT_VALUES - 1),
        ("pending", np.float64, (2, SLOT_VALUES)),
        ("total", np.float64, SLOT_VALUES - 1),
        ("tick", np.float64, SLOT_VALUES - 1),
        ("last_tick", np.float64, 4),
        ("path", np.float64, 4),
        ("line", np.float64, 9),
        ("moments", np.float64, (2, MOMENTS)),
        ("rate_sums", np.float64, (3, 2)),
        ("path_sums", np.float64, (4, 2)),
        ("exponent", np.float64, (_G, 2)),
        ("normal", np.float64, (_G, 4, 4)),
        ("spread", np.float64, (_G, 4, 4)),
        ("weighted", np.float64, (_G, 4)),
        ("right", np.float64, (_G, 4, 2)),
        ("squares", np.float64, 2),
        ("mag", np.float64, 4),
        ("log", np.float64, (LOG_ROWS, 4)),
        ("result", np.float64, (ESTIMATORS, 2)),
    ]
)
"""One record, not a tuple of arrays: compiled functions then pass a single pointer to each other, and numba
compiles them in a fraction of the time."""


def new_state() -> State:
    """Return the state of an alignment that has seen nothing."""
    record = np.zeros(1, np.dtype((np.record, RECORD)))[0]
    state = cast(State, record)
    state.attitude[:] = np.eye(3)
    state.result[:] = np.nan
    return state
