"""What a stage that thinks per slot shows at each row."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.filters.segments import Breaks
from imumon.filters.slots import held


class Shown:
    """What a slot said holds until the next one says otherwise, and is void from a restart of the device on.

    Parameters
    ----------
    shape : sequence of int
        Of what a slot says.
    """

    def __init__(self, shape: Sequence[int]) -> None:
        self._values = np.full(tuple(shape), np.nan)
        self._breaks = Breaks()

    def breaks(self, block: SampleBlock) -> list[int]:
        """Return the rows of the next block from which on nothing that was said before holds."""
        return self._breaks.rows(block["device_time_ns"], block["segment"])

    def spread(self, rows: IntArray, outputs: FloatArray, breaks: Sequence[int], n: int) -> FloatArray:
        """Return what is shown at n rows, (n, ...), of what slots said that are known from `rows` on."""
        at = np.concatenate([rows, np.array(breaks, np.int64)])
        values = np.concatenate([outputs, np.full((len(breaks), *outputs.shape[1:]), np.nan)])
        order = np.argsort(at, kind="stable")
        result = held(at[order], values[order], self._values, n)
        if n:
            self._values = result[-1].copy()
        return result
