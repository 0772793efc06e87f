"""The refresh interval of a thermometer that repeats a reading over seconds, found from when it changes.

A reading that is refreshed every T seconds changes only at multiples of T.  Crossings of level edges are
not bound to such a comb: every change on it that need not be there is evidence, by the odds of hitting it
by chance.  A leap by more than a step after seconds of silence is evidence as well: a temperature passes
every level.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

SLOW_S, SLOWEST_S = 0.9, 120.0
"""Faster refreshes are seen within a slot; slower thermometers are not made."""
FASTEST = 20.0 / 60.0
"""°C/s; a leap that would need more is a fault ("several °C/min" is what the paper's sensors meet)."""
LEAP_STEPS = 1.5
"""More than one step, with half a step for its error."""
JITTER = 0.01
"""The interval wanders by so much, and by 1.5 samples."""
FARTHEST = 8
"""Multiples beyond this tell little: with the jitter, most times are on the comb."""
KNOWN, MOST = math.log(1000.0), 3.0 * math.log(1000.0)
"""Log odds from which on the interval is believed, and most that are kept."""


@dataclass(slots=True)
class RefreshFinder:
    """Finds the interval at which a reading is refreshed, where that is longer than a slot."""

    interval_s: float = 0.0
    """0 as long as there is no candidate."""
    evidence: float = 0.0
    """Log odds that changes are bound to it."""
    changed_s: float = float("nan")
    """Time of the last change; NaN before the first."""
    change: float = 0.0
    """The last change, °C."""

    @property
    def slow(self) -> bool:
        """Whether the reading is known to be repeated over slots until there is another."""
        return self.evidence >= KNOWN and self.interval_s > SLOW_S

    def refute(self) -> None:
        """Learn that the reading changed more than once within a slot."""
        self.evidence = max(self.evidence - KNOWN, 0.0)

    def begin(self) -> None:
        """Forget the time of the last change; what is known of the interval stays."""
        self.changed_s = float("nan")

    def learn(self, time_s: float, change: float, silent_s: float, step: float, gap_s: float) -> None:
        """Learn from a single change of the reading.

        Parameters
        ----------
        time_s, change : float
            When, and by how much, °C.
        silent_s : float
            How long there had been no change.
        step, gap_s : float
            Quantization step, 0 for none, and time between two samples.
        """
        gap = time_s - self.changed_s
        if math.isfinite(gap):
            self._compare(gap, change, step, 1.5 * gap_s + JITTER * gap)
        self.changed_s, self.change = time_s, change
        waited = min(silent_s, SLOWEST_S)
        leap = LEAP_STEPS * step < abs(change) < FASTEST * waited
        if step and leap and waited > max(SLOW_S, 3.0 * gap_s) and not self.slow:
            self.interval_s = min(self.interval_s, waited) if self.interval_s > SLOW_S else waited
            self.evidence = KNOWN

    def refreshed(self, start_s: float, end_s: float) -> float | None:
        """Return when between two times the reading was refreshed to what it was, or None."""
        if not math.isfinite(self.changed_s):
            return None
        passed = math.floor((end_s - self.changed_s) / self.interval_s)
        last = self.changed_s + passed * self.interval_s
        return last if passed >= 1 and last > start_s else None

    def _compare(self, gap: float, change: float, step: float, tolerance: float) -> None:
        whole = round(gap / self.interval_s) if self.interval_s else 0
        if whole > FARTHEST:
            self.evidence -= 1.0
            if self.evidence < 0.0:
                self.interval_s, self.evidence = gap, 0.0
            return
        off = abs(gap - whole * self.interval_s)
        if whole and off < tolerance:
            # Crossings at a constant rate are equally spaced too: one step each, the same way.
            needless = whole > 1 or change * self.change < 0.0 or abs(change) > LEAP_STEPS * step
            odds = math.log(max(self.interval_s / (2.0 * tolerance), 1.0))
            self.evidence = min(self.evidence + needless * odds, MOST)
            self.interval_s += 0.1 * (gap / whole - self.interval_s)
            return
        self.evidence -= KNOWN
        if self.evidence < KNOWN:
            # Towards the greatest common divisor, by a step of Euclid's.
            self.interval_s, self.evidence = off if whole else gap, 0.0
