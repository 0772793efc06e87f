"""Means of a second at rest, and what any random-error filter must beat: their mean, fading or held.

The filters of the paper run at every sample; where they begin, and with which noise, is found from these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from imumon.filters.slots import Slots

SLOT_S = 1.0
LEAST_S = 0.5
"""A slot that saw the unit at rest for less than this is not believed: the motion may have begun in it."""


@dataclass(frozen=True, slots=True)
class RestMean:
    """One second of one axis."""

    begins: bool
    """Whether a segment begins here."""
    elapsed_s: float
    """From the middle of the last slot to the middle of this one."""
    covered_s: float
    """Time at rest with readings; 0 where the slot says nothing."""
    mean: float
    """rad/s; NaN where the slot says nothing."""
    interval_s: float
    """Between samples."""


class RestMeans:
    """Turns slots of readings that are NaN except at rest into means, whatever the division into blocks."""

    def __init__(self) -> None:
        self._middle_ns = 0
        self._begins = True
        self._interval_s = 0.0
        self._alone = True

    def process(self, slots: Slots) -> list[list[RestMean]]:
        """Return for each slot the mean of each column."""
        found = []
        for k in range(len(slots)):
            middle_ns = int(slots.middle_ns[k])
            self._begins |= bool(slots.begins[k])
            elapsed = SLOT_S if self._begins else (middle_ns - self._middle_ns) * 1e-9
            samples = int(slots.samples[k])
            inside = (int(slots.end_ns[k]) - int(slots.start_ns[k])) * 1e-9
            # A sample alone is the whole of a slow stream, or what a gap left of a fast one.
            if samples > 1:
                self._interval_s = inside / (samples - 1)
            elif self._alone or not self._interval_s:
                self._interval_s = elapsed
            self._alone = samples == 1
            interval = self._interval_s
            row = []
            for count, mean in zip(slots.count[k], slots.mean[k], strict=True):
                covered = float(count) * interval
                known = (covered, float(mean)) if covered >= LEAST_S else (0.0, math.nan)
                row.append(RestMean(self._begins, elapsed, *known, interval))
            found.append(row)
            self._middle_ns, self._begins = middle_ns, False
        return found


@dataclass
class ExponentialMean:
    """Mean with exponentially fading memory; over what there is until that is as long as the memory."""

    time_constant_s: float
    """s at rest; infinity for the mean of everything."""
    longest_s: float = math.inf
    """After so many s at rest the mean is held."""
    rest_s: float = field(default=0.0, init=False)
    mean: float = field(default=math.nan, init=False)

    def step(self, new: RestMean) -> float:
        """Take in a second; return the mean, NaN before the first reading of a segment."""
        if new.begins:
            self.rest_s, self.mean = 0.0, math.nan
        if new.covered_s > 0.0 and self.rest_s < self.longest_s:
            self.rest_s += new.covered_s
            gain = max(new.covered_s / self.rest_s, -math.expm1(-new.covered_s / self.time_constant_s))
            before = new.mean if math.isnan(self.mean) else self.mean
            self.mean = before + gain * (new.mean - before)
        return self.mean


def hold(seconds: float) -> ExponentialMean:
    """Return a mean of the first seconds at rest that stays."""
    return ExponentialMean(math.inf, seconds)
