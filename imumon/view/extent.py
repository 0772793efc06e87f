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
"""A band wider than so many times the usual one is cut off: it would leave nothing to see of the others."""
LEAST_STEPS = 4.0
"""The axis spans at least so many steps of a quantized column, or of the last digit of a card."""
STILL = 0.02
"""What never changes is shown on an axis of this share of its value."""
AHEAD = 0.1
"""The ends leave so much of the span free, for what comes until the next step."""
TAB_HEIGHT, FRAME_HEIGHT, MARK_HEIGHT = 750, 36, 20
"""Points, in a window of 1456 x 819: a tab; of each strip its title and times; the number of a mark."""
LATEST_S = {True: 3.0, False: 90.0}
"""The invisible line is looked at so far back, in a live view and in a recording, which comes in batches."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """What is drawn in some rows, in the unit that is drawn.

    Parameters
    ----------
    values : array of shape (n, lines)
    reach : array of shape (n, lines)
        Half of the height of the band about each value; zero without one.
    least : float
        The axis spans at least as much.
    floor : float, optional
        The axis begins here, where no value is below.
    """

    values: FloatArray
    reach: FloatArray
    least: float = 0.0
    floor: float | None = None


@dataclass(slots=True, eq=False)
class _Step:
    """The least and greatest value of each line within a step of time, and half of its widest band."""

    number: int
    low: FloatArray
    high: FloatArray
    half: FloatArray

    def take(self, other: _Step) -> None:
        self.low = np.fmin(self.low, other.low)
        self.high = np.fmax(self.high, other.high)
        self.half = np.fmax(self.half, other.half)


@dataclass(slots=True)
class Extent:
    """The ends of what a panel has to show in its window, found anew with each step; in constant memory.

    Parameters
    ----------
    window_s : float, optional
        What the panel shows of time; all without.
    """

    window_s: float | None = None
    _resolution: float = np.inf
    _steps: deque[_Step] = field(default_factory=deque)

    def ends(self, clock: IntArray | None, drawn: Reach, marks: int) -> tuple[float, float] | None:
        """Return both ends of the axis, once in a step of time; None while it goes on.

        They are moved outwards until three marks, and no more than `marks` steps between them, have room for
        their numbers.
        """
        began = self._gather(0 if clock is None or not len(clock) else int(clock[-1]) // STEP_NS, drawn)
        if not began:
            return None
        half = np.array([step.half for step in self._steps])
        half = np.fmin(half, WIDE * float(np.median(half.max(axis=1))))
        low = float(np.nanmin(np.array([step.low for step in self._steps]) - half))
        high = float(np.nanmax(np.array([step.high for step in self._steps]) + half))
        least = max(drawn.least, LEAST_STEPS * self._resolution if np.isfinite(self._resolution) else 0.0)
        if low == high:  # nothing is known of what it resolves
            least = max(least, STILL * abs(low)) or 1.0
        short = max(0.0, least - (high - low))
        ahead = AHEAD * max(high - low, least)
        if drawn.floor is not None and low >= drawn.floor:
            high = max(high + ahead, drawn.floor + least)
            below, above = with_marks(drawn.floor, high, marks)
            return drawn.floor, above + drawn.floor - below
        return with_marks(low - 0.5 * short - ahead, high + 0.5 * short + ahead, marks)

    def _gather(self, number: int, drawn: Reach) -> bool:
        """Take rows; tell whether they begin a step."""
        if not np.isfinite(drawn.values).any():
            return False
        change = np.abs(np.diff(drawn.values, axis=0))
        moved = change[change > 0]
        if len(moved) and np.mean(change == 0) > 0.5:  # most samples repeat the last: it comes in steps
            self._resolution = min(self._resolution, float(moved.min()))
        low, high = np.fmin.reduce(drawn.values), np.fmax.reduce(drawn.values)
        step = _Step(number, low, high, np.nan_to_num(np.fmax.reduce(drawn.reach)))
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


def marks_of(strips: int, height: float = TAB_HEIGHT) -> int:
    """Return how many steps between marks have room in each of so many strips above each other, 3 or more."""
    return max(3, int((height / max(strips, 1) - FRAME_HEIGHT) / MARK_HEIGHT))


LARGEST = 1e300
"""No axis is longer, so that its ends and marks are numbers; a value beyond is no measurement."""


def with_marks(low: float, high: float, most: int) -> tuple[float, float]:
    """Return the ends, moved outwards until three marks, a power of ten apart, lie between them.

    The viewer writes numbers at powers of ten, of which it takes the finest that has room: here `most` steps.
    """
    low, high = (min(max(end, -LARGEST), LARGEST) for end in (low, high))
    span = max(high - low, 1e-12 * max(abs(low), abs(high)), 1e-300)
    step = 10.0 ** math.ceil(math.log10(span / most) - 1e-9)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    while last - first < 2:
        if high / step - last > first - low / step:
            last += 1
        else:
            first -= 1
    return min(low, first * step), max(high, last * step)


def entity(drawn: str) -> str:
    """Return the entity of the invisible line beside what is drawn."""
    return f"{drawn}/extent"


def declare_extent(rec: rr.RecordingStream, drawn: str) -> None:
    """Log that the line is not to be seen."""
    unseen = rr.SeriesLines(names=["", ""], colors=[[0, 0, 0, 0]] * 2, widths=[0.0, 0.0])
    rec.log(entity(drawn), unseen, static=True)
