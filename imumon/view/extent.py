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
"""So often the invisible line gets a point at each end."""
WINDOW = 15
"""The ends are those over so many steps: marks that move with each would be as fine as the finest of them."""
REMEMBERED = 600
"""Steps that a band is compared with."""
WIDE = 4.0
"""A band wider than so many times the usual one is cut off: it would leave nothing to see of the others."""
LEAST_STEPS = 4.0
"""The axis spans at least so many steps of a quantized column: three of its values can be read."""


STILL = 0.02
"""What never changes is shown on an axis of this share of its value."""
FEW_MARKS, FEWEST_MARKS = 5, 3
"""The viewer writes numbers at powers of ten that are 15 to 20 points apart or more: so many steps from end
to end in a strip of a hundred points, and in one of seventy."""
AHEAD = 0.1
"""The ends leave so much of the span free, for what comes until the next step."""


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


@dataclass(slots=True)
class Extent:
    """The ends of what a panel has to show, step by step; in constant memory."""

    _step: float = np.inf
    _low: float = np.inf
    _high: float = -np.inf
    _past: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _last: int | None = None
    _usual: deque[float] = field(default_factory=lambda: deque(maxlen=REMEMBERED))

    def ends(
        self, clock: IntArray | None, drawn: Reach, marks: int | None = None
    ) -> tuple[float, float] | None:
        """Return both ends of the axis, once in a step of time; None while it goes on.

        With `marks` they are moved outwards until three marks, and no more than so many steps between them,
        have room for their numbers.
        """
        self._gather(drawn)
        now = 0 if clock is None or not len(clock) else int(clock[-1]) // STEP_NS
        if self._low > self._high or (clock is not None and now == self._last):
            return None
        self._past.append((self._low, self._high))
        self._last, self._low, self._high = now, np.inf, -np.inf
        low, high = min(low for low, _ in self._past), max(high for _, high in self._past)
        least = max(drawn.least, LEAST_STEPS * self._step if np.isfinite(self._step) else 0.0)
        if low == high:  # nothing is known of what it resolves
            least = max(least, STILL * abs(low))
        short = max(0.0, least - (high - low))
        if drawn.floor is not None and low >= drawn.floor:
            low, high = drawn.floor, max(high, drawn.floor + least)
        else:
            low, high = low - 0.5 * short, high + 0.5 * short
        if marks is None:
            return low, high
        ahead = AHEAD * (high - low)
        return round_ends(low if low == drawn.floor else low - ahead, high + ahead, marks)

    def _gather(self, drawn: Reach) -> None:
        """Take rows, without a band that is wider than is usual here."""
        if not np.isfinite(drawn.values).any():
            return
        change = np.abs(np.diff(drawn.values, axis=0))
        moved = change[change > 0]
        if len(moved) and np.mean(change == 0) > 0.5:  # most samples repeat the last: it comes in steps
            self._step = min(self._step, float(moved.min()))
        self._usual.append(float(np.median(drawn.reach.max(axis=1))))
        half = np.minimum(drawn.reach, WIDE * float(np.median(self._usual)))
        self._low = min(self._low, float(np.nanmin(drawn.values - half)))
        self._high = max(self._high, float(np.nanmax(drawn.values + half)))


def round_ends(low: float, high: float, most: int) -> tuple[float, float]:
    """Return ends at marks, a power of ten apart, with two steps from end to end or more, up to `most`."""
    span = max(high - low, 1e-12 * max(abs(low), abs(high)), 1e-300)
    power = math.floor(math.log10(span)) - 1
    while True:
        step = 10.0**power
        first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
        if last - first <= most:
            return first * step, max(last, first + 2) * step
        power += 1


def entity(drawn: str) -> str:
    """Return the entity of the invisible line beside what is drawn."""
    return f"{drawn}/extent"


def declare_extent(rec: rr.RecordingStream, drawn: str) -> None:
    """Log that the line is not to be seen."""
    unseen = rr.SeriesLines(names=["", ""], colors=[[0, 0, 0, 0]] * 2, widths=[0.0, 0.0])
    rec.log(entity(drawn), unseen, static=True)
