"""ZUPT and TCZUPT as printed over a record at rest, of which all is known beforehand."""

from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.papers.dense_zupt import DenseSettings, begin, step


@dataclass(frozen=True, slots=True, eq=False)
class DenseRun:
    """Bias and its sd at each sample, (n, 3), rad/s, body axes; and the zero-velocity innovations north,
    east, down over their standard deviations, (n, 3)."""

    bias: FloatArray
    bias_sd: FloatArray
    innovation: FloatArray


def dense_filter(
    settings: DenseSettings,
    gyro: FloatArray,
    accel: FloatArray,
    bias: FloatArray,
    drift: FloatArray | None = None,
    up: FloatArray | None = None,
    every: int = 1,
) -> DenseRun:
    """Filter a record at rest, so many samples to a step, between which the bias moves by the drift alone.

    Parameters
    ----------
    gyro, accel : array (n, 3)
        rad/s and m/s^2, body axes.
    bias : array (3,)
        Bias at the start, as from the initial zeroing, rad/s.
    drift : array (n, 3), optional
        What the thermal model adds to the bias at each sample, rad/s: T_s slope x rate in the published form,
        b(T_k) - b(T_k-1) in the better one.  None for the standard filter.
    up : array (3,), optional
        Direction of the specific force at the start; by default that of the first second.
    """
    n = len(gyro)
    drift = np.zeros((n, 3)) if drift is None else drift
    state = begin(settings, accel[: max(1, round(1.0 / settings.interval_s))].mean(0), up)
    state.bias = bias
    long = replace(settings, interval_s=settings.interval_s * every)
    run = DenseRun(np.empty((n, 3)), np.empty((n, 3)), np.full((n, 3), np.nan))
    for start in range(0, n - every + 1, every):
        part, last = slice(start, start + every), start + every - 1
        moved = np.cumsum(drift[part], axis=0)
        run.bias[part], run.bias_sd[part] = state.bias + moved, state.bias_sd
        # The bias of a step is that at its end.
        rate = gyro[part].mean(0) - moved.mean(0) + moved[-1]
        run.innovation[last] = step(state, long, rate, accel[part].mean(0), moved[-1])
        run.bias[last], run.bias_sd[last] = state.bias, state.bias_sd
    run.bias[n - n % every :], run.bias_sd[n - n % every :] = state.bias, state.bias_sd
    return run
