"""The predicted bias: its mean and variance at a time, a temperature and a specific force.

All modes have one F, so the moments of their mixture propagate as those of each of them.  They are evaluated
at each sample: a unit in the hand is in another pose a quarter of a second later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.gyro_bias.modes import FLICKER, SENSITIVITY, STATES, WALK, measurement_row, propagated


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
        if time_s <= self.time_s:
            return self
        mean, covariance = propagated(
            self.mean, self.covariance, self.process, time_s - self.time_s, degc - self.degc
        )
        known = np.where(np.isfinite(degc), degc, self.degc)
        return replace(self, mean=mean, covariance=covariance, time_s=time_s, degc=known)

    def wider(self, variance: FloatArray) -> Prediction:
        """Return a prediction whose bias may have changed by an unknown amount of this variance, (3,)."""
        covariance = self.covariance.copy()
        covariance[:, WALK, WALK] += variance
        return replace(self, covariance=covariance)

    def bias(self, force: FloatArray, of_mean: bool = False) -> tuple[FloatArray, FloatArray]:
        """Return bias and variance at a specific force, (3,) each.

        Parameters
        ----------
        of_mean : bool
            Of a mean over some seconds, which has none of the fastest flicker.
        """
        h = measurement_row(force)
        mean = self.mean @ h
        if of_mean:
            h[FLICKER.start] = 0.0
        return mean, np.maximum(self.covariance @ h @ h, 0.0)

    def shown(self, added: FloatArray, force: FloatArray) -> Shown:
        """Return what holds with so much more variance, (3,), at the specific force of a slot, (3,)."""
        select = np.zeros((4, STATES))
        select[0], select[1:, SENSITIVITY] = measurement_row(np.zeros(3)), np.eye(3)
        covariance = select @ self.covariance @ select.T
        covariance[:, 0, 0] += self.fast + added
        return Shown(self.mean @ select.T, covariance, force)


class Shown(NamedTuple):
    """A prediction from the end of a slot on; NaN where nothing is known."""

    terms: FloatArray
    """Bias without specific force, and its sensitivity, t, (3, 4)."""
    covariance: FloatArray
    """Theirs, C, (3, 4, 4)."""
    force: FloatArray
    """Of the slot, (3,)."""

    @classmethod
    def constant(cls, bias: FloatArray, variance: FloatArray) -> Shown:
        """Return a bias of any pose, (3,), with its variance."""
        terms, covariance = np.zeros((3, 4)), np.zeros((3, 4, 4))
        terms[:, 0], covariance[:, 0, 0] = bias, variance
        return cls(terms, covariance, np.zeros(3))


NOTHING = Shown.constant(np.full(3, np.nan), np.full(3, np.nan))


def at_samples(
    rows: IntArray, every: list[Shown], force: FloatArray, moving: BoolArray
) -> tuple[FloatArray, FloatArray]:
    """Return bias t (1, f) and variance (1, f) C (1, f) of samples, (n, 3) each.

    f is the specific force of the sample; at rest, where its noise is no change of pose, and without
    accelerometers, that of the slot.  The sums are of few terms each, so they are the same whatever the
    division into blocks.

    Parameters
    ----------
    rows : array (m,)
        From where on each but the first holds.
    every : list of Shown, m + 1
    force : array (n, 3)
    moving : array of bool (n,)
    """
    which = np.searchsorted(rows, np.arange(len(moving)), side="right")
    terms, covariance, of_slot = (np.array(one)[which] for one in zip(*every, strict=True))
    row = np.ones((len(force), 1, 4))
    row[:, 0, 1:] = np.where((moving & np.isfinite(force).all(1))[:, np.newaxis], force, of_slot)
    return (terms * row).sum(2), np.maximum(((covariance * row[:, np.newaxis]).sum(3) * row).sum(2), 0.0)
