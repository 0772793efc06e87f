"""At rest or not, where no rest detector has judged: only blocks as quiet as the quiet ones count."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from imumon.blocks import FloatArray
from imumon.calibration.reduction import NO_VERDICT, BlockMeans

Mask = npt.NDArray[np.bool_]

QUIET_QUANTILE = 0.25
LOUDER = 3.0
"""A block counts when its scatter on every axis is at most this much above that of the quietest quarter."""
JERK = 0.02
"""And when its mean specific force is within this of a neighbour's, m/s² (0.1°), beyond its own noise."""


def at_rest(means: BlockMeans, gyro: list[int], accel: list[int]) -> Mask:
    """Return which blocks are at rest: as judged by the detector, else by `_quiet`.

    Never by the size of the rate, which is what is to be found.
    """
    judged = means.at_rest != NO_VERDICT
    return np.where(judged, means.at_rest == 1, _quiet(means, gyro, accel))


def _quiet(means: BlockMeans, gyro: list[int], accel: list[int]) -> Mask:
    quiet = np.ones(len(means), np.bool_)
    for j in gyro + accel:
        sd = means.sd[:, j]
        known = sd[np.isfinite(sd)]
        if len(known):
            quiet &= ~(sd > LOUDER * np.quantile(known, QUIET_QUANTILE))
    for j in accel:
        quiet &= _steady(means.mean[:, j], means.sd[:, j] / np.sqrt(np.maximum(means.count[:, j], 1)))
    return quiet


def _steady(mean: FloatArray, sd: FloatArray) -> Mask:
    """Tell which means do not differ from both neighbours; a block without a value is no evidence."""
    near = np.abs(np.diff(mean)) <= JERK + 5.0 * np.hypot(sd[1:], sd[:-1])
    near |= ~np.isfinite(np.diff(mean))
    steady = np.ones(len(mean), np.bool_)
    steady[1:] &= near
    steady[:-1] &= near
    return steady
