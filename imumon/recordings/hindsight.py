"""Rest told again where the future is known: a short pause between two rests that agree was rest as well.

A detector that runs live needs some seconds at the start to believe in rest, and lets go when a bias drifts
as a slow turn would look.  In a recording the means on both sides tell: what lies on the line between them
and scatters as they do has not moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray

LONGEST = 64
"""Slots that such a pause may have: four times the longest window of the detector, in slots of a second."""
BESIDE = 16
"""Slots of rest on either side that the line is laid through."""
SIGMAS = 5.0
"""Of the scatter of neighbouring slots at rest, beside what a bias may drift in the pause."""


def rest_in_hindsight(
    rest: BoolArray, run: IntArray, mean: FloatArray, variance: FloatArray, drift: FloatArray
) -> BoolArray:
    """Return which slots were at rest.

    Parameters
    ----------
    rest : array of bool, (n,)
        As the detector judged.
    run : array of int64, (n,)
        Runs are told apart: nobody knows what was between them.
    mean, variance : array, (n, m)
        Of gyros and accelerometers; NaN where there is no value.
    drift : array, (m,)
        What a bias at rest may drift in a slot.
    """
    found = rest.copy()
    for start, stop in _pauses(rest, run):
        near = np.r_[max(start - BESIDE, 0) : start, stop : min(stop + BESIDE, len(rest))]
        beside = near[(run[near] == run[start]) & rest[near]]
        if stop - start > LONGEST or len(beside) < BESIDE // 2:
            continue
        pause, others = np.arange(start, stop), rest & (run == run[start])
        allowed = SIGMAS * scatter_of_steps(mean[others]) + drift * len(pause)
        on_line = np.abs(mean[pause] - _between(pause, beside, mean)) <= allowed
        loud = variance[pause] > np.nanmax(variance[others], axis=0, initial=0.0)
        found[pause] = (on_line | ~np.isfinite(mean[pause])).all() and not loud.any()
    return found


def _pauses(rest: BoolArray, run: IntArray) -> Sequence[tuple[int, int]]:
    """Return where each stretch without rest begins and ends, within a run."""
    edges = np.flatnonzero((np.diff(rest) != 0) | (np.diff(run) != 0)) + 1
    bounds = [0, *edges.tolist(), len(rest)]
    return [(a, b) for a, b in pairwise(bounds) if a < b and not rest[a]]


def scatter_of_steps(mean: FloatArray) -> FloatArray:
    """Return the standard deviation of a slot's mean, (m,), from neighbours: slow drift is not in it."""
    steps = np.abs(np.diff(mean, axis=0))
    known = [column[np.isfinite(column)] for column in steps.T]
    medians = np.array([np.median(column) if len(column) else 0.0 for column in known], np.float64)
    return np.asarray(medians / (0.6745 * 2.0**0.5))


def _between(pause: IntArray, beside: IntArray, mean: FloatArray) -> FloatArray:
    """Return what the rests beside a pause let expect in it, (k, m).

    That is the line through them; at the start or the end of a run, where that would be extrapolated, their
    mean.
    """
    degree = 1 if beside[0] < pause[0] < beside[-1] else 0
    expected = np.full((len(pause), mean.shape[1]), np.nan)
    for j in range(mean.shape[1]):
        known = np.isfinite(mean[beside, j])
        if known.sum() > degree:
            line = np.polynomial.Polynomial.fit(beside[known], mean[beside, j][known], degree)
            expected[:, j] = line(pause)
    return expected
