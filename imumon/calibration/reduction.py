"""From samples to means over blocks of seconds, in constant memory, whatever the division of the stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.compiled import njit

BLOCK_S = 10.0
"""Length of a block: long against the sample noise, short against a chamber's ramps."""
_PIECE = 4096
"""Samples at a time: as many blocks may end, and there is room for so many."""
NO_VERDICT = -1
"""Stands in `BlockMeans.at_rest` for rows that nobody judged."""


@dataclass(frozen=True, slots=True, eq=False)
class BlockMeans:
    """Means of m columns over n blocks.

    Parameters
    ----------
    names : tuple of str
        The m columns.
    segment, start_ns : array (n,) of int
        Segment, and device time at which the block begins, whole blocks after its segment's first sample.
    span_s : array (n,)
        Time between its first and its last sample.
    at_rest : array (n,) of int
        1 when every sample is at rest, 0 when one is not, `NO_VERDICT` when that was not judged.
    count, mean, sd : array (n, m)
        Number of values, their mean (NaN without any) and standard deviation (NaN with fewer than two).
    """

    names: tuple[str, ...]
    segment: IntArray
    start_ns: IntArray
    span_s: FloatArray
    at_rest: IntArray
    count: IntArray
    mean: FloatArray
    sd: FloatArray

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self.segment)

    def columns(self, names: Sequence[str]) -> list[int]:
        """Return the places of columns; raises ValueError when there is none of this name."""
        return [self.names.index(name) for name in names]


class BlockReducer:
    """Takes samples in pieces of any size; its result depends on the samples alone, to the bit.

    Parameters
    ----------
    names : sequence of str
        Float columns to reduce; one that a piece lacks is missing there.
    """

    def __init__(self, names: Sequence[str], block_s: float = BLOCK_S) -> None:
        self.names = tuple(names)
        self._block_ns = round(block_s * 1e9)
        # segment, block's number, segment's first time, block's first and last time, verdict, rows
        self._place = np.array([-1, 0, 0, 0, 0, NO_VERDICT, 0], np.int64)
        self._count = np.zeros(len(self.names), np.int64)
        self._sums = np.zeros(
            (3, len(self.names))
        )  # first value; sum and sum of squares of what differs from it
        self._parts: list[tuple[IntArray, IntArray, FloatArray]] = []

    def process(self, block: SampleBlock) -> None:
        """Take samples with device_time_ns and segment, and at_rest if that was judged."""
        for start in range(0, len(block), _PIECE):
            self._process(block.rows(start, min(start + _PIECE, len(block))))

    def _process(self, block: SampleBlock) -> None:
        n = len(block)
        values = np.full((n, len(self.names)), np.nan)
        for j, name in enumerate(self.names):
            if name in block:
                values[:, j] = block[name]
        verdict = np.full(n, NO_VERDICT, np.int64)
        if "at_rest" in block:
            verdict[:] = np.where(block["at_rest"] == 1, 1, 0)
        time_ns, segment = block["device_time_ns"], block["segment"]
        place, count = np.empty((n, 7), np.int64), np.empty((n, len(self.names)), np.int64)
        sums = np.empty((n, 3, len(self.names)))
        done = accumulate(
            time_ns, segment, verdict, values, self._block_ns,
            self._place, self._count, self._sums, place, count, sums,
        )  # fmt: skip
        if done:
            self._parts.append((place[:done].copy(), count[:done].copy(), sums[:done].copy()))

    def finish(self) -> BlockMeans:
        """Return all blocks; the last one may be short."""
        parts = list(self._parts)
        if self._place[6]:
            parts.append((self._place[np.newaxis], self._count[np.newaxis], self._sums[np.newaxis]))
        m = len(self.names)
        place = np.concatenate([np.empty((0, 7), np.int64), *(part[0] for part in parts)])
        count = np.concatenate([np.empty((0, m), np.int64), *(part[1] for part in parts)])
        first, total, squares = np.moveaxis(
            np.concatenate([np.empty((0, 3, m)), *(part[2] for part in parts)]), 1, 0
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = np.where(count > 0, first + total / count, np.nan)
            variance = np.where(count > 1, (squares - total**2 / count) / (count - 1), np.nan)
        return BlockMeans(
            names=self.names,
            segment=place[:, 0],
            start_ns=place[:, 2] + place[:, 1] * self._block_ns,
            span_s=(place[:, 4] - place[:, 3]) * 1e-9,
            at_rest=place[:, 5],
            count=count,
            mean=mean,
            sd=np.sqrt(np.maximum(variance, 0.0)),
        )


@njit
def accumulate(
    time_ns: IntArray,
    segment: IntArray,
    verdict: IntArray,
    values: FloatArray,
    block_ns: int,
    place: IntArray,
    count: IntArray,
    sums: FloatArray,
    place_out: IntArray,
    count_out: IntArray,
    sums_out: FloatArray,
) -> int:
    """Add samples to the open block (place, count, sums); return how many were closed into the outputs."""
    done = 0
    for i in range(len(time_ns)):
        restarted = place[6] == 0 or segment[i] != place[0]
        origin = time_ns[i] if restarted else place[2]
        number = (time_ns[i] - origin) // block_ns
        if restarted or number != place[1]:
            if place[6]:
                place_out[done], count_out[done], sums_out[done] = place, count, sums
                done += 1
            place[0], place[1], place[2], place[3] = segment[i], number, origin, time_ns[i]
            place[5], place[6] = verdict[i], 0
            count[:] = 0
            sums[:] = 0.0
        place[4] = time_ns[i]
        place[5] = min(place[5], verdict[i])
        place[6] += 1
        for j in range(values.shape[1]):
            value = values[i, j]
            if np.isfinite(value):
                if count[j] == 0:
                    sums[0, j] = value
                count[j] += 1
                difference = value - sums[0, j]
                sums[1, j] += difference
                sums[2, j] += difference * difference
    return done
