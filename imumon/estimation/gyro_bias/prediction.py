"""The predicted bias: its mean and variance at a time, a temperature and a specific force.

All modes have one F, so the moments of their mixture propagate as those of each of them.  They are evaluated
at each sample: a unit in the hand is in another pose a quarter of a second later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.gyro_bias.modes import FLICKER, SENSITIVITY, STATES, measurement_row, propagated


class LinearBias(NamedTuple):
    """A bias as a linear function of the specific force f, t (1, f); NaN where nothing is known."""

    terms: FloatArray
    """t: bias without specific force, rad/s, and sensitivity, rad/s per m/s², (3, 4)."""
    covariance: FloatArray
    """C of t, (3, 4, 4)."""
    force: FloatArray
    """Mean f of the slot, m/s², (3,)."""
    turn: FloatArray
    """Turn hypothesis, rad/s, (3,); its square is not in C."""


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Mean and covariance of the states of three axes, absolute."""

    mean: FloatArray
    covariance: FloatArray
    process: FloatArray
    """(3, 8), (3, 8, 8), and the process noise as `Modes.process` has it, (3, 8)."""
    fast: FloatArray
    white: FloatArray
    """Variance of the flicker of single samples, and of the white noise of a second, (rad/s)², (3,)."""
    time_s: float
    degc: FloatArray
    """°C, (3,)."""

    def at(self, time_s: float, degc: FloatArray) -> Prediction:
        """Return the prediction at a later time and temperatures, (3,); NaN is no change."""
        dt, warming = time_s - self.time_s, degc - self.degc
        if dt <= 0.0:
            return self
        mean, covariance = propagated(self.mean, self.covariance, self.process, dt, warming)
        known = np.where(np.isfinite(degc), degc, self.degc)
        return replace(self, mean=mean, covariance=covariance, time_s=time_s, degc=known)

    def bias(self, force: FloatArray, of_mean: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return bias and variance at a specific force, (3,) each; `of_mean` without the fastest flicker."""
        h = measurement_row(force)
        mean = self.mean @ h
        if of_mean:
            h[FLICKER.start] = 0.0
        return mean, np.maximum(self.covariance @ h @ h, 0.0)

    def output(self, added: FloatArray, force: FloatArray, turn: FloatArray) -> LinearBias:
        """Return the bias with more variance, (rad/s)², at the mean force of a slot, m/s², (3,) each."""
        select = np.vstack([measurement_row(np.zeros(3)), np.eye(STATES)[SENSITIVITY]])
        covariance = select @ self.covariance @ select.T
        covariance[:, 0, 0] += self.fast + added
        return LinearBias(self.mean @ select.T, covariance, force, turn)


def at_samples(
    rows: IntArray, every: list[LinearBias], force: FloatArray, moving: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return bias t (1, f), variance (1, f) C (1, f) and turn hypothesis of samples, (n, 3) each.

    `every` bias but the first holds from its row on, (m,).  f is the specific force of the sample, (n, 3); at
    rest, where its noise is no change of pose, and without accelerometers, that of the slot.  The sums are of
    few terms each, so they are the same whatever the division into blocks.
    """
    which = np.searchsorted(rows, np.arange(len(moving)), side="right")
    terms, covariance, of_slot, turn = (np.array(one)[which] for one in zip(*every, strict=True))
    row = np.ones((len(force), 1, 4))
    row[:, 0, 1:] = np.where((moving & np.isfinite(force).all(1))[:, np.newaxis], force, of_slot)
    variance = ((covariance * row[:, np.newaxis]).sum(3) * row).sum(2)
    return (terms * row).sum(2), np.maximum(variance, 0.0), turn
