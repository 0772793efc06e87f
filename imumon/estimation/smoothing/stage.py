"""The smoothed estimates beside the samples, in a second run over the same recording.

Each is one estimate from a forward and a backward filter (Fraser and Potter 1969).  If their errors are
independent, their difference has the variance P_f + P_b, and the weights are the inverse variances.  Let r be
the rms over a recording of the normalised residual |f - b| / sqrt(P_f + P_b)::

    r < 1    the errors have a common covariance c = (1 - r²) (P_f + P_b) / 2, which averaging cannot reduce
    r > 1    the model lacks an effect: all standard deviations are multiplied by r, or by the median
             residual over that of a normal one if that is smaller (scale factor of the Particle Data
             Group); where a single residual exceeds two, the standard deviation is multiplied by it
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.alignment.report import PositionHeading
from imumon.estimation.smoothing.record import QUANTITIES, Record, value_and_sd

SUSPECT = 2.0
"""A standard normal value exceeds this in magnitude with a probability of 5 %."""
MEDIAN = 0.6745
"""Median of the magnitude of a standard normal value."""
UNITS = {"temperature_estimate": "degC", "temperature_rate": "degC/s", "gyro_bias": "rad/s", "heading": "rad"}


class Smoothed(NamedTuple):
    """Estimate and standard deviation, (n,) each, and r as above."""

    value: FloatArray
    sd: FloatArray
    residual: float


def combine(
    forward: FloatArray, forward_sd: FloatArray, backward: FloatArray, backward_sd: FloatArray
) -> Smoothed:
    """Return the estimate from both directions, (n,); the only one where there is one; NaN where none."""
    both = np.isfinite(forward + forward_sd + backward + backward_sd)
    has_forward = np.isfinite(forward_sd)
    value, sd = np.where(has_forward, forward, backward), np.where(has_forward, forward_sd, backward_sd)
    if not both.any():
        return Smoothed(value, sd, math.nan)
    p_f, p_b = forward_sd[both] ** 2, backward_sd[both] ** 2
    residual = np.abs(forward - backward)[both] / np.sqrt(p_f + p_b)
    r = float(np.sqrt(np.mean(residual**2)))
    # At most the smaller variance: then the direction that has it is taken alone.
    common = np.minimum(max(1.0 - r * r, 0.0) * 0.5 * (p_f + p_b), np.minimum(p_f, p_b))
    own_f, own_b = p_f - common, p_b - common
    weight = np.divide(own_b, own_f + own_b, out=np.full(len(p_f), 0.5), where=own_f + own_b > 0.0)
    value[both] = weight * forward[both] + (1.0 - weight) * backward[both]
    variance = weight**2 * own_f + (1.0 - weight) ** 2 * own_b + common
    usual = max(min(r, float(np.median(residual)) / MEDIAN), 1.0)
    sd *= usual  # also where there is one direction
    sd[both] = np.sqrt(variance) * np.where(residual > SUSPECT, np.maximum(residual, usual), usual)
    return Smoothed(value, sd, r)


def still_heading(record: Record, positions: Sequence[PositionHeading]) -> Smoothed:
    """Return the heading of each slot in which the unit stood still, rad, (n,); NaN elsewhere.

    It is a constant, so it is the result of one fit to all samples of the interval, as the alignment of the
    whole recording left it.  Warm-up and a settling tripod are models that only run forward.
    """
    value, sd = np.full((2, len(record.run)), np.nan)
    for position in positions:
        run = np.flatnonzero(record.run == position.run)
        since_s = 1e-9 * (record.middle_ns[run] - record.middle_ns[run[:1]])
        rows = run[(since_s >= position.begun_s) & (since_s <= position.ended_s)]
        value[rows], sd[rows] = position.heading, position.sd
    return Smoothed(value, sd, math.nan)


class SmoothedEstimates:
    """Estimates from forward and backward filters; ``gyro_bias_sd_x`` becomes ``gyro_bias_smoothed_sd_x``.

    `record` is of the first run, `backward` (n,) each what `record.backward` returns, and `heading` what
    `still_heading` returns.
    """

    def __init__(
        self, record: Record, backward: Mapping[str, FloatArray], heading: Smoothed | None = None
    ) -> None:
        self._stop = record.stop
        self._rows = 0
        found = {}
        for quantity, suffix in QUANTITIES:
            names = value_and_sd(quantity, suffix)
            if names[0] in backward:
                directions = [of[name] for of in (record.columns, backward) for name in names]
                found[quantity, suffix] = combine(*directions)
        if heading is not None:
            found["heading", ""] = heading
        self.residuals = {
            f"{quantity}{suffix}": each.residual
            for (quantity, suffix), each in found.items()
            if math.isfinite(each.residual)
        }
        """r of `combine`, by quantity."""
        self._values: dict[str, FloatArray] = {}
        self.columns: tuple[Column, ...] = ()
        """The columns that `process` adds."""
        for (quantity, suffix), each in found.items():
            if np.isfinite(each.sd).any():
                value, sd = value_and_sd(f"{quantity}_smoothed", suffix)
                self._values |= {value: each.value, sd: each.sd}
                text, unit = "with what came later", UNITS[quantity]
                self.columns += (Column(value, unit, description=text),)
                self.columns += (Column(sd, unit, description=f"standard deviation {text}"),)
        self._reported = False

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; the blocks must be the rows of the first run, in their order."""
        rows = np.arange(self._rows, self._rows + len(block))
        self._rows += len(block)
        slot = np.minimum(np.searchsorted(self._stop, rows, side="right"), max(len(self._stop) - 1, 0))
        return {name: values[slot] for name, values in self._values.items()}

    def notices(self) -> list[str]:
        """Return, once, the quantities in which forward and backward contradict each other."""
        suspect = [f"{name} ({r:.1f} σ)" for name, r in self.residuals.items() if r > SUSPECT]
        if self._reported or not suspect:
            return []
        self._reported = True
        return [
            f"forward and backward contradict each other in {', '.join(suspect)}: something changed abruptly "
            "that the filter takes for smooth, or its model lacks an effect (of a bias, imumon diagnose may "
            "name it); the smoothed sigma is widened by that"
        ]
