"""Where what was known is void: a segment of the device's clock begins, or its time runs back."""

from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, IntArray


class Breaks:
    """Finds the rows that begin anew, from block to block."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None

    def rows(self, time_ns: IntArray, segment: IntArray) -> list[int]:
        """Return the rows of the next block, (n,), at which a segment begins or time runs back.

        Rows without a time are passed over, and the very first row is no break.
        """
        dated = np.flatnonzero(time_ns != NO_INT)
        if not len(dated):
            return []
        times, labels = time_ns[dated], segment[dated]
        last_ns, last_label = self._last if self._last is not None else (times[0], labels[0])
        self._last = int(times[-1]), int(labels[-1])
        begins = np.diff(labels, prepend=last_label) != 0
        begins |= np.diff(times, prepend=last_ns) < 0
        return [int(row) for row in dated[begins]]
