"""When a unit that rests was turned: each pose is a stretch in which gravity has one direction."""

from __future__ import annotations

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray

BESIDE = 4
"""Slots on either side of a turn that are compared."""
TURNED = 0.1
"""m/s², a tilt of 0.6°: accelerometers repeat better than that from one power-on to the next."""
SIGMAS = 8.0


def poses(force: FloatArray, resting: BoolArray) -> IntArray:
    """Return the number of the pose in each slot, (n,): one more after each turn.

    Parameters
    ----------
    force : array of shape (n, 3)
        Specific force in m/s².
    resting : array of shape (n,)
        Slots that count; the others have the pose before them.
    """
    at = np.flatnonzero(resting)
    found = np.zeros(len(force), np.int64)
    if len(at) <= 2 * BESIDE:
        return found
    total = np.cumsum(np.vstack([np.zeros(3), force[at]]), axis=0)
    means = (total[BESIDE:] - total[:-BESIDE]) / BESIDE
    change = np.abs(means[BESIDE:] - means[:-BESIDE]).max(axis=1)
    limit = max(TURNED, SIGMAS * float(np.median(change)))
    turned = change > limit
    edges = np.flatnonzero(np.diff(np.concatenate([[False], turned, [False]])))
    for start, stop in edges.reshape(-1, 2).tolist():
        found[at[start + int(np.argmax(change[start:stop])) + BESIDE]] = 1
    return np.cumsum(found)


def in_one_pose(valid: BoolArray, pose: IntArray, slots: int) -> BoolArray:
    """Return the valid slots without those of a block that are of another pose than most of it, (n,)."""
    kept = valid.copy()
    for turn in np.flatnonzero(np.diff(pose)) + 1:
        block = slice(turn // slots * slots, (turn // slots + 1) * slots)
        counts = np.bincount(pose[block][valid[block]], minlength=1)
        kept[block] &= pose[block] == np.argmax(counts)
    return kept
