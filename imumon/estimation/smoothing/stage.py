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
from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.smoothing.record import SUFFIXES, Record

SUSPECT = 2.0
"""A standard normal value exceeds this in magnitude with a probability of 5 %."""
MEDIAN = 0.6745
"""Median of the magnitude of a standard normal value."""
QUANTITIES = (
    *((f"temperature_estimate{s}", f"temperature_estimate_sd{s}", "degC") for s in SUFFIXES),
    *((f"temperature_rate{s}", f"temperature_rate_sd{s}", "degC/s") for s in SUFFIXES),
    *((f"gyro_bias_{a}", f"gyro_bias_sd_{a}", "rad/s") for a in "xyz"),
)
"""Columns, their standard deviations, and the unit of both."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
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


class SmoothedEstimates:
    """Estimates from forward and backward filters; the columns are named as in `smoothed`.

    Parameters
    ----------
    record : Record
        Of the first run.
    backward : dict of str to array (n,)
        As from `imumon.estimation.smoothing.backward.backward`.
    heading : Smoothed, optional
        As from `imumon.estimation.smoothing.heading.still_heading`.
    """

    def __init__(
        self, record: Record, backward: Mapping[str, FloatArray], heading: Smoothed | None = None
    ) -> None:
        self._stop = record.stop
        self._rows = 0
        self._reported = False
        self._values: dict[str, FloatArray] = {}
        columns: list[Column] = []
        self.columns: Sequence[Column] = columns
        """The columns that `process` adds."""
        self.residuals: dict[str, float] = {}
        """r of `combine`, by quantity."""
        forward = record.columns
        found = {
            each: combine(forward[each[0]], forward[each[1]], backward[each[0]], backward[each[1]])
            for each in QUANTITIES
            if each[0] in backward
        }
        if heading is not None:
            found["heading", "heading_sd", "rad"] = heading
        for (value, sd, unit), of in found.items():
            if math.isfinite(of.residual):
                self.residuals[value] = of.residual
            if np.isfinite(of.sd).any():
                self._values |= {smoothed(value): of.value, smoothed(sd): of.sd}
                columns.append(Column(smoothed(value), unit, description="with what came later"))
                columns.append(
                    Column(smoothed(sd), unit, description="standard deviation with what came later")
                )

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


def smoothed(name: str) -> str:
    """Return the name of the smoothed column: ``gyro_bias_sd_x`` becomes ``gyro_bias_smoothed_sd_x``."""
    for quantity in ("temperature_estimate", "temperature_rate", "gyro_bias", "heading"):
        name = name.replace(quantity, f"{quantity}_smoothed")
    return name
