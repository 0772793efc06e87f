"""One estimate of two: what the past says, and what the future says (Fraser and Potter 1969).

Were their errors independent, their difference would have the variance P_f + P_b, and the weights were the
inverse variances.  A disagreement over that of r, rms over a recording, tells how it is::

    r < 1    the errors have a part in common, c = (1 - r²) (P_f + P_b) / 2, which no weighing takes away
    r > 1    there is an effect that the model lacks: all standard deviations are larger by r, or by what is
             usual (the median) when that is less; those of a moment at which both sides are further apart
             than twice their standard deviation by as much as they are (the rule of the Particle Data Group)
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imumon.blocks import BoolArray, FloatArray

SUSPECT = 2.0
"""χ² with one degree of freedom is beyond the square of this in 5 %."""
LEAST_OWN = 0.1
"""Part of a standard deviation that is never a turn's: so two sides that have it can be weighed."""
MEDIAN = 0.6745
"""Of the magnitude of a standard normal value."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Estimate and standard deviation, (n,) each, and the disagreement of both sides in units of theirs."""

    value: FloatArray
    sd: FloatArray
    disagreement: float


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """What one side says of a bias, its standard deviation, and the part of it that may be a turn, (n,)."""

    value: FloatArray
    sd: FloatArray
    turn: FloatArray

    @property
    def turn_sd(self) -> FloatArray:
        """The part of the standard deviation that may be a turn; 0 where nothing is known."""
        return np.asarray(
            np.nan_to_num(np.minimum(np.abs(self.turn), math.sqrt(1.0 - LEAST_OWN**2) * self.sd))
        )


def decided(past: Side, future: Side, at_rest: BoolArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the standard deviations of both sides, (n,), and that of an error that both have.

    At rest both took the turn for bias, or neither did: it is one error.  In motion each keeps what it knew
    before; had the bias changed there, both sides would differ by as much, and where they do not, it has not:
    a change of the size of the turn and none were as likely before.
    """
    turns2 = past.turn_sd**2, future.turn_sd**2
    own = past.sd**2 + future.sd**2 - turns2[0] - turns2[1]
    changed = own + turns2[0] + turns2[1]
    apart = (past.value - future.value) ** 2
    odds = np.sqrt(own / changed) * np.exp(np.minimum(0.5 * apart * (1.0 / own - 1.0 / changed), 100.0))
    kept = np.where(at_rest | ~np.isfinite(odds), 1.0, odds / (1.0 + odds))
    past_sd, future_sd = (
        np.asarray(np.sqrt(side.sd**2 - (1.0 - kept) * turn2))
        for side, turn2 in zip((past, future), turns2, strict=True)
    )
    return past_sd, future_sd, np.where(at_rest, np.sqrt(np.minimum(*turns2)), 0.0)


def combine(
    forward: FloatArray,
    forward_sd: FloatArray,
    backward: FloatArray,
    backward_sd: FloatArray,
    shared: FloatArray | float = 0.0,
) -> Smoothed:
    """Return the estimate by both sides, (n,); where there is one side only, that one; NaN where none.

    Parameters
    ----------
    forward, forward_sd, backward, backward_sd : array (n,)
        NaN where nothing is known.
    shared : array (n,), optional
        An error (sd) that both have where there are two, and that is part of both deviations: no weighing
        takes it away, and it does not set them apart.
    """
    both = np.isfinite(forward + forward_sd + backward + backward_sd)
    same = np.where(both, np.square(shared), 0.0)
    past, future = forward_sd**2 - same, backward_sd**2 - same
    ratio = (forward - backward)[both] / np.sqrt((past + future)[both])
    r = float(np.sqrt(np.mean(ratio**2))) if both.any() else math.nan
    value, variance = np.where(np.isfinite(forward_sd), forward, backward), np.fmin(past, future)
    only_past, only_future = np.isfinite(past) & ~both, np.isfinite(future) & ~both
    variance[only_past], variance[only_future] = past[only_past], future[only_future]
    f, b = past[both], future[both]
    # No more in common than the better of the two has: with all of it the better alone is taken.
    common = np.minimum(max(1.0 - r * r, 0.0) * 0.5 * (f + b), np.minimum(f, b)) if both.any() else f
    difference = f + b - 2.0 * common
    weight = np.where(difference > 0.0, (b - common) / np.where(difference > 0.0, difference, 1.0), 0.5)
    value[both] = weight * forward[both] + (1.0 - weight) * backward[both]
    variance[both] = weight**2 * f + (1.0 - weight) ** 2 * b + 2.0 * weight * (1.0 - weight) * common
    if both.any():
        apart = np.abs(ratio)
        usual = max(min(r, float(np.median(apart)) / MEDIAN), 1.0)
        variance[both] *= np.maximum(usual, np.where(apart > SUSPECT, apart, 1.0)) ** 2
    return Smoothed(value, np.sqrt(variance + same), r)
