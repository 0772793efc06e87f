"""The smoothed estimates beside the samples, in a second run over the same recording."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.smoothing.combine import SUSPECT, Smoothed, combine
from imumon.estimation.smoothing.record import SUFFIXES, Record

QUANTITIES = (
    *((f"temperature_estimate{s}", f"temperature_estimate_sd{s}", "degC") for s in SUFFIXES),
    *((f"temperature_rate{s}", f"temperature_rate_sd{s}", "degC/s") for s in SUFFIXES),
    *((f"gyro_bias_{a}", f"gyro_bias_sd_{a}", "rad/s") for a in "xyz"),
)
"""Columns, their standard deviations, and the unit of both."""


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
        self._units: dict[str, str] = {}
        self.disagreement: dict[str, float] = {}
        """r of `combine`, by quantity."""
        for value, sd, unit in QUANTITIES:
            if value in backward:
                found = combine(record.columns[value], record.columns[sd], backward[value], backward[sd])
                self._add(value, sd, unit, found)
        if heading is not None:
            self._add("heading", "heading_sd", "rad", heading)

    def _add(self, value: str, sd: str, unit: str, found: Smoothed) -> None:
        if math.isfinite(found.disagreement):
            self.disagreement[value] = found.disagreement
        if np.isfinite(found.sd).any():
            self._values |= {smoothed(value): found.value, smoothed(sd): found.sd}
            self._units |= {smoothed(value): unit, smoothed(sd): unit}

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return [
            Column(
                name,
                unit,
                description=f"{'standard deviation ' if '_sd' in name else ''}with what came later",
            )
            for name, unit in self._units.items()
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; the blocks must be the rows of the first run, in their order."""
        rows = np.arange(self._rows, self._rows + len(block))
        self._rows += len(block)
        slot = np.minimum(np.searchsorted(self._stop, rows, side="right"), max(len(self._stop) - 1, 0))
        return {name: values[slot] for name, values in self._values.items()}

    def notices(self) -> list[str]:
        """Return, once, the quantities in which forward and backward contradict each other."""
        suspect = [f"{name} ({value:.1f} σ)" for name, value in self.disagreement.items() if value > SUSPECT]
        if self._reported or not suspect:
            return []
        self._reported = True
        return [
            f"forward and backward contradict each other in {', '.join(suspect)}: something turned at once "
            "that the filter takes for smooth, or its model lacks an effect (of a bias, imumon diagnose may "
            "name it); the smoothed sigma is widened by that"
        ]


def smoothed(name: str) -> str:
    """Return the name of the smoothed column: ``gyro_bias_sd_x`` becomes ``gyro_bias_smoothed_sd_x``."""
    for quantity in ("temperature_estimate", "temperature_rate", "gyro_bias", "heading"):
        name = name.replace(quantity, f"{quantity}_smoothed")
    return name
