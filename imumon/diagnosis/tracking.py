"""Estimate during the test what training cannot predict: size of a jump, turn-on offset, state at power-on.

Each block is predicted from the blocks before it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from imumon.blocks import BoolArray, FloatArray

JUMP_SIGMAS = 5.0
LONGEST_TEST = 16
"""Blocks over which a jump is looked for."""
GRACE_S = 120.0
"""After a jump, or after power-on where the level or an amplitude is another in each run, nobody can know its
size at once: the score leaves out this long."""
VAGUE = 1e4
"""Prior standard deviation of a level after a jump, in standard deviations of the noise."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Columns (n, k) to estimate, and what training says of their coefficients: mean and sd (k,)."""

    columns: FloatArray
    mean: FloatArray
    sd: FloatArray

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return several as one."""
        return cls(
            np.column_stack([part.columns for part in parts]),
            np.concatenate([part.mean for part in parts]),
            np.concatenate([part.sd for part in parts]),
        )


@dataclass(slots=True, eq=False)
class Coefficients:
    """Estimated coefficients (k,) and their covariance (k, k); the first is the level."""

    mean: FloatArray
    covariance: FloatArray

    def update(self, row: FloatArray, value: float, noise: float) -> None:
        """Take one block: recursive least squares."""
        cross = self.covariance @ row
        total = float(row @ cross) + noise**2
        if total > 0:
            gain = cross / total
            self.mean = self.mean + gain * (value - float(row @ self.mean))
            self.covariance = self.covariance - np.outer(gain, cross)

    def forget_level(self, sd: float) -> None:
        """Begin the level anew."""
        self.covariance[0, :] = self.covariance[:, 0] = 0.0
        self.covariance[0, 0] = sd**2


def track(
    time_s: FloatArray, residual: FloatArray, prior: Prior, noise: FloatArray, jumps: bool
) -> tuple[FloatArray, BoolArray]:
    """Estimate coefficients recursively; return the residual expected from them, and which blocks are near a
    jump.

    Parameters
    ----------
    time_s, residual : array of shape (n,)
        Blocks of the test, and what the carried-over model leaves of them.
    prior : Prior
        Its first column is that of the level, ones.
    noise : array of shape (n,)
        Standard deviation of each residual.
    jumps : bool
        Whether the level may jump.
    """
    n, columns = len(residual), prior.columns
    expected, grace = np.zeros(n), np.zeros(n, bool)
    known = Coefficients(prior.mean.astype(float), np.diag(prior.sd.astype(float) ** 2))
    since = 0
    if prior.sd.any() and n:
        grace |= time_s < time_s[0] + GRACE_S
    for k in range(n):
        expected[k] = columns[k] @ known.mean
        rows = np.arange(max(since, k + 1 - LONGEST_TEST), k + 1)
        surprise = residual[rows] - columns[rows] @ known.mean
        if jumps and (at := _jump(surprise, noise[rows], known.covariance[0, 0])) is not None:
            first = int(rows[at])
            known.forget_level(VAGUE * noise[k])
            grace |= (time_s >= time_s[first]) & (time_s < time_s[first] + GRACE_S)
            for j in range(first, k):
                known.update(columns[j], residual[j], noise[j])
            since = k + 1
        known.update(columns[k], residual[k], noise[k])
    return expected, grace


def _jump(surprise: FloatArray, noise: FloatArray, level_variance: float) -> int | None:
    """Return from which of the last blocks on the level differs by five standard deviations, or None."""
    count = np.arange(len(surprise), 0, -1)
    means = np.cumsum(surprise[::-1])[::-1] / count
    variance = np.cumsum(noise[::-1] ** 2)[::-1] / count**2 + level_variance
    size = np.abs(means) / np.sqrt(variance)
    at = len(size) - 1 - int(np.argmax(size[::-1]))
    return at if size[at] > JUMP_SIGMAS else None
