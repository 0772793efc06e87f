"""Faults of the data, found before any physics is asked: values that stand still while time goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S
from imumon.diagnosis.recording import Run

ROUNDED = 0.5
"""With more of its seconds in which nothing changes a channel is not stuck: its digits are too coarse."""


def without_faults(run: Run, channels: Sequence[str]) -> tuple[Run, list[str]]:
    """Return a run without the seconds in which a channel stands still, and what has to be said of them.

    Noise never gives the same value for as long as a block (30 s), but a stuck sensor does, one at its limit,
    and one whose digits are coarser than its noise.  The last is said and kept.
    """
    mean, variance, said = dict(run.mean), dict(run.variance), []
    for name in channels:
        if name not in mean:
            continue
        still = _standing(mean[name], run.variance[name])
        known = np.isfinite(mean[name])
        if not still.any():
            continue
        seconds, share = int(still.sum()), still.sum() / known.sum()
        if share > ROUNDED:
            said.append(f"{run.name}: {name} does not change in {share:.0%} of its seconds: too few digits")
            continue
        values = mean[name][still]
        limits = np.nanmin(mean[name]), np.nanmax(mean[name])
        what = "saturated" if np.isin(values, limits).all() else "stuck"
        said.append(f"{run.name}: {name} is {what} for {seconds} s; they are left out")
        mean[name] = np.where(still, np.nan, mean[name])
        variance[name] = np.where(still, np.nan, variance[name])
    return replace(run, mean=mean, variance=variance), said


def _standing(mean: FloatArray, variance: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Tell in which seconds a channel has one value for as long as a block or longer, (n,)."""
    same = (np.diff(mean, prepend=np.nan) == 0.0) & ~(variance > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    still = np.zeros(len(mean), np.bool_)
    for start, stop in edges.reshape(-1, 2).tolist():
        # The second before the first that repeats has the value as well.
        still[start - 1 : stop] = stop - start + 1 >= BLOCK_S
    return still
