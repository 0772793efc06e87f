"""How far the vertical axis of a panel reaches: over the estimates and their bands, and never into digits.

Rerun's axis follows the lines alone, so that a band is cut off, and it magnifies what is constant until the
rounding fills the panel.  An invisible line beside the drawn ones says what has to be seen.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np
import rerun as rr

from imumon.blocks import FloatArray, IntArray

STEP_NS = 1_000_000_000
"""So often the ends are found anew."""
REMEMBERED = 1200
"""Steps; where a window has more, neighbours become one."""
WIDE = 4.0
"""A band wider than so many times the usual one is cut off, and so is a spike that is higher by so many times
what the line spans without it: it would leave nothing to see of the others."""
LEAST_STEPS = 4.0
"""The axis spans at least so many steps of a quantized column, or of the last digit of a card."""
STILL = 0.02
"""What never changes is shown on an axis of this share of its value."""
AHEAD = 0.1
"""The ends leave so much of the span free, for what comes until the next step."""
LARGEST = 1e300
"""No axis ends beyond it, so that its length is a number; a value beyond is no measurement."""
MOST_STRIPS = 4
"""Above each other: in a fifth of a tab only the first of ten steps are fine enough for three numbers."""
LATEST_S = 3.0
"""Of the invisible line a live view looks at so much."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """What is drawn in some rows, in the unit that is drawn."""

    values: FloatArray
    """Array, (n, lines)."""
    reach: FloatArray
    """Half of the height of the band about each value, (n, lines); zero without one."""
    least: float = 0.0
    """The axis spans at least as much."""
    floor: float | None = None
    """The axis begins here, where no value is below."""


@dataclass(slots=True, eq=False)
class _Step:
    """What each line spans within a step of time, also without spikes, and half of its widest band."""

    number: int
    low: FloatArray
    high: FloatArray
    calm_low: FloatArray
    calm_high: FloatArray
    half: FloatArray

    def take(self, other: _Step) -> None:
        self.low = np.fmin(self.low, other.low)
        self.high = np.fmax(self.high, other.high)
        self.calm_low = np.fmin(self.calm_low, other.calm_low)
        self.calm_high = np.fmax(self.calm_high, other.calm_high)
        self.half = np.fmax(self.half, other.half)


@dataclass(slots=True)
class Extent:
    """The ends of what a panel has to show in its window, found anew with each step; in constant memory."""

    window_s: float | None = None
    """What the panel shows of time; all without."""
    _resolution: float = np.inf
    _before: FloatArray | None = None
    _steps: deque[_Step] = field(default_factory=deque)

    def ends(self, clock: IntArray | None, drawn: Reach) -> tuple[float, float] | None:
        """Return both ends of the axis, once in a step of time; None while it goes on."""
        began = self._gather(0 if clock is None or not len(clock) else int(clock[-1]) // STEP_NS, drawn)
        if not began:
            return None
        low, high = self._visible()
        least = max(drawn.least, LEAST_STEPS * self._resolution if np.isfinite(self._resolution) else 0.0)
        if low == high:  # nothing is known of what it resolves
            least = max(least, STILL * abs(low)) or 1.0
        span = max(high - low, least)
        if drawn.floor is not None and low >= drawn.floor:
            return drawn.floor, max(high, drawn.floor + least) + AHEAD * span
        beyond = AHEAD * span + 0.5 * (span - (high - low))
        return low - beyond, high + beyond

    def _visible(self) -> tuple[float, float]:
        """Return the ends of all lines with their bands, without spikes and bands that are much too wide."""
        steps = self._steps
        calm_low = np.fmin.reduce([step.calm_low for step in steps])
        calm_high = np.fmax.reduce([step.calm_high for step in steps])
        room = WIDE * (calm_high - calm_low)
        half = np.array([step.half for step in steps])
        usual = float(np.median(half.max(axis=1)))
        half = np.where(half > WIDE * usual, usual, half)
        low = np.fmax([step.low for step in steps], calm_low - room) - half
        high = np.fmin([step.high for step in steps], calm_high + room) + half
        bottom, top = np.clip([np.nanmin(low), np.nanmax(high)], -LARGEST, LARGEST).tolist()
        return bottom, top

    def _gather(self, number: int, drawn: Reach) -> bool:
        """Take rows; tell whether they begin a step."""
        if not np.isfinite(drawn.values).any():
            return False
        change = np.abs(np.diff(drawn.values, axis=0))
        moved = change[change > 0]
        if len(moved) and np.mean(change == 0) > 0.5:  # most samples repeat the last: it comes in steps
            self._resolution = min(self._resolution, float(moved.min()))
        calm = self._calm(drawn.values)
        step = _Step(
            number,
            np.fmin.reduce(drawn.values),
            np.fmax.reduce(drawn.values),
            np.fmin.reduce(calm),
            np.fmax.reduce(calm),
            np.nan_to_num(np.fmax.reduce(drawn.reach)),
        )
        if self._steps and number == self._steps[-1].number:
            self._steps[-1].take(step)
            return False
        if self._steps and number < self._steps[-1].number:  # the clock went back
            self._steps.clear()
        self._steps.append(step)
        while self.window_s is not None and (number - self._steps[0].number) * STEP_NS > 1e9 * self.window_s:
            self._steps.popleft()
        if len(self._steps) > REMEMBERED:
            self._halve()
        return True

    def _calm(self, values: FloatArray) -> FloatArray:
        """Return the median of each value and the two before it: a spike of one sample is gone."""
        first = values[:1] if self._before is None else self._before
        padded = np.concatenate([first, first[:1] if len(first) < 2 else first[:0], values])
        self._before = padded[-2:]
        a, b, c = padded[:-2], padded[1:-1], padded[2:]
        return np.asarray(np.fmax(np.fmin(a, b), np.fmin(np.fmax(a, b), c)))

    def _halve(self) -> None:
        """Make one step of each two neighbours, but for the last, which goes on."""
        last, steps = self._steps.pop(), self._steps
        self._steps = deque()
        while steps:
            step = steps.popleft()
            if steps:
                step.take(steps.popleft())
            self._steps.append(step)
        self._steps.append(last)


def columns_of(strips: int) -> int:
    """Return beside each other how many strips of a tab stand."""
    return math.ceil(strips / MOST_STRIPS)


def entity(drawn: str) -> str:
    """Return the entity of the invisible line beside what is drawn."""
    return f"{drawn}/extent"


def declare_extent(rec: rr.RecordingStream, drawn: str) -> None:
    """Log that the line is not to be seen."""
    unseen = rr.SeriesLines(names=["", ""], colors=[[0, 0, 0, 0]] * 2, widths=[0.0, 0.0])
    rec.log(entity(drawn), unseen, static=True)
