"""Turn-on offsets: what the bias of each run differs by from the mean over the runs."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from imumon.blocks import FloatArray, IntArray
from imumon.lab.calibration.cells import Channel
from imumon.models.curves.points import Points
from imumon.models.curves.spline import penalised_basis

_STIFFNESS = 1e-6
"""Penalty of the curve that the offsets are estimated beside: enough to make it unique."""


def turn_on_offsets(channel: Channel, points: Points, knots: FloatArray) -> FloatArray:
    """Return the offset of each run, (runs,) in the channel's unit; NaN where it cannot be told.

    A run is compared only where others were at the same temperatures: with no level in common, an offset and
    a bend of the curve are the same.  The mean over the runs that can be compared is 0.
    """
    runs = int(channel.run.max()) + 1
    together = _comparable(channel.run, channel.level, runs)
    offset = np.full(runs, np.nan)
    offset[together] = 0.0
    if len(together) < 2:
        return offset
    used = np.isin(channel.run, together)
    basis, penalty = penalised_basis(points.only(used), knots)
    which = (channel.run[used][:, np.newaxis] == together[1:]).astype(np.float64)
    root = np.sqrt(points.weight[used])[:, np.newaxis]
    design = np.hstack([basis, which]) * root
    normal = design.T @ design
    m = basis.shape[1]
    normal[:m, :m] += _STIFFNESS * penalty
    solved = np.linalg.solve(normal, design.T @ (points.value[used] * root[:, 0]))
    own = np.concatenate([[0.0], solved[m:]])
    offset[together] = own - own.mean()
    return offset


def _comparable(run: IntArray, level: IntArray, runs: int) -> IntArray:
    """Return the runs that levels in common join, directly or through others, to the one with most data."""
    visited = np.zeros((runs, int(level.max()) + 1), np.int64)
    visited[run, level] = 1
    _, group = connected_components(visited @ visited.T, directed=False)
    return np.flatnonzero(group == group[np.argmax(np.bincount(run, minlength=runs))])
