"""When slots of samples begin and end, how much of them their samples cover, and gaps between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

GAP_S, GAP_INTERVALS = 0.25, 3.0
"""A pause between samples is a gap when it is longer than this and than so many usual intervals."""


class Span(NamedTuple):
    """What a slot covers."""

    end_s: float
    """Since the first sample of its segment."""
    seconds: float
    """From the end of the slot before, or of the gap before it, to its last sample."""
    covered_s: float
    """What its samples cover at the shortest interval so far: lost ones leave more noise."""
    gap_s: float
    """Length of the gap before it; 0 without one."""


@dataclass(slots=True)
class Timing:
    """The slot before: its end, its interval, and the shortest interval so far, s."""

    origin_ns: int = 0
    end_s: float = 0.0
    interval_s: float = 0.0
    shortest_s: float = math.inf

    def next(self, start_ns: int, end_ns: int, samples: int, begins: bool) -> Span:
        """Take a slot: device time of its first and last sample; `begins` with a new segment."""
        if begins:
            self.origin_ns, self.end_s, self.interval_s, self.shortest_s = start_ns, 0.0, 0.0, math.inf
        start, end = (1e-9 * (time_ns - self.origin_ns) for time_ns in (start_ns, end_ns))
        gap = 0.0 if begins else self.pause(start)
        if begins or gap:
            inside = (end - start) / (samples - 1) if samples > 1 else self.interval_s
            start -= inside
        else:
            start = self.end_s
        seconds = end - start
        if seconds > 0.0:
            self.interval_s = seconds / samples
            self.shortest_s = min(self.shortest_s, self.interval_s)
        self.end_s = end
        return Span(end, seconds, min(seconds, samples * self.shortest_s) if seconds > 0.0 else 0.0, gap)

    def pause(self, start_s: float) -> float:
        """Return the length of the gap before a sample; 0 if it follows."""
        pause = start_s - self.end_s
        return pause if pause > max(GAP_S, GAP_INTERVALS * self.interval_s) and self.interval_s else 0.0
