"""Following in the test what no training can foretell: size of a jump, turn-on offset, amplitude, state at
power-on.

At each block only the blocks before it are used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BoolArray

JUMP_SIGMAS = 5.0
LONGEST_TEST = 16
"""Blocks over which a jump is looked for."""
GRACE_S = 120.0
"""After a jump, or after power-on where the level or an amplitude is another in each run, nobody can know its
size at once: the score leaves out this long."""
VAGUE = 1e4
"""Prior standard deviation of a level after a jump, in standard deviations of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Tracked:
    """What was expected at each block from those before it, and which blocks are too near a jump to count."""

    expected: FloatArray
    grace: BoolArray
    jumps: int


def track(
    time_s: FloatArray,
    residual: FloatArray,
    columns: FloatArray,
    mean: FloatArray,
    sd: FloatArray,
    noise: FloatArray,
    jumps: bool,
) -> Tracked:
    """Estimate the coefficients of columns recursively, and with them what the next residual will be.

    Parameters
    ----------
    time_s, residual : array of shape (n,)
        Blocks of the test, and what the carried-over model leaves of them.
    columns : array of shape (n, k)
        The first is that of the level, ones.
    mean, sd : array of shape (k,)
        What training says of the coefficients.
    noise : array of shape (n,)
        Standard deviation of each residual.
    jumps : bool
        Whether the level may jump.
    """
    n = len(residual)
    expected, grace = np.zeros(n), np.zeros(n, bool)
    state, covariance = mean.astype(float).copy(), np.diag(sd.astype(float) ** 2)
    recent: list[int] = []
    found = 0
    if sd.any() and n:
        grace |= time_s < time_s[0] + GRACE_S
    for k in range(n):
        expected[k] = columns[k] @ state
        recent.append(k)
        if jumps and (at := _jump(residual, columns, state, covariance, noise, recent)) is not None:
            found += 1
            covariance[0, :] = covariance[:, 0] = 0.0
            covariance[0, 0] = (VAGUE * noise[k]) ** 2
            grace |= (time_s >= time_s[at]) & (time_s < time_s[at] + GRACE_S)
            for j in range(at, k):
                state, covariance = _update(state, covariance, columns[j], residual[j], noise[j])
            recent = []
        state, covariance = _update(state, covariance, columns[k], residual[k], noise[k])
    return Tracked(expected, grace, found)


def _jump(
    residual: FloatArray,
    columns: FloatArray,
    state: FloatArray,
    covariance: FloatArray,
    noise: FloatArray,
    recent: list[int],
) -> int | None:
    """Return the block from which on the level differs by five standard deviations, or None."""
    best, at = JUMP_SIGMAS, None
    window = recent[-LONGEST_TEST:]
    surprise = residual[window] - columns[window] @ state
    for count in range(1, len(window) + 1):
        variance = float(np.mean(noise[window[-count:]] ** 2)) / count + float(covariance[0, 0])
        size = abs(float(surprise[-count:].mean())) / np.sqrt(variance)
        if size > best:
            best, at = size, window[-count]
    return at


def _update(
    state: FloatArray, covariance: FloatArray, row: FloatArray, value: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return state and covariance after one block."""
    cross = covariance @ row
    total = float(row @ cross) + noise**2
    if not total > 0:
        return state, covariance
    gain = cross / total
    return state + gain * (value - float(row @ state)), covariance - np.outer(gain, cross)
