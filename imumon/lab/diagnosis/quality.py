"""Faults of single samples: digits, frequent values, standstill; means of blocks would hide them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.filters.rounding import digits, grid_step

KEPT = 100_000
"""Samples of a channel that are kept, evenly spaced over the recording, to bound the memory."""
FREQUENT, TIMES_MORE = 0.01, 10.0
"""A value with this share of all samples, and so many times more than its neighbours, is not by chance."""


class Samples(NamedTuple):
    """Statistics of the samples of a channel in a recording.

    `step` is that of the grid on which the values lie, 0 when there is none; `scatter` the standard deviation
    of a sample about its neighbour; `ratio` the noise before rounding, in steps, infinite where these are far
    finer; `atom` the value that is far more frequent than its neighbours (NaN without one).
    """

    step: float
    scatter: float
    ratio: float = np.inf
    atom: float = np.nan
    atom_share: float = 0.0


class Watcher:
    """Collects statistics of the samples of some channels while blocks pass."""

    def __init__(self, channels: Sequence[str]) -> None:
        self._kept: dict[str, list[FloatArray]] = {name: [] for name in channels}
        """Samples, and the step to each from the one before, (n, 2)."""
        self._stride, self._phase, self._count = 1, 0, 0

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks unchanged."""
        for block in blocks:
            chosen = slice(-self._phase % self._stride, None, self._stride)
            self._phase = (self._phase + len(block)) % self._stride
            self._count += len(block) // self._stride + 1
            for name in self._kept.keys() & block.columns.keys():
                values = block[name]
                steps = np.diff(values, prepend=np.nan)
                self._kept[name].append(np.column_stack([values, steps])[chosen].astype(np.float64))
            if self._count > KEPT:
                joined = {name: np.concatenate(kept) for name, kept in self._kept.items() if kept}
                self._kept = {name: [values[::2]] for name, values in joined.items()}
                self._stride, self._count = 2 * self._stride, self._count // 2
            yield block

    def samples(self) -> dict[str, Samples]:
        """Return the statistics of each channel that has values."""
        joined = {name: np.concatenate([*kept, np.empty((0, 2))]).T for name, kept in self._kept.items()}
        return {
            name: _samples(values[np.isfinite(values)], steps[np.isfinite(values)])
            for name, (values, steps) in joined.items()
            if np.isfinite(values).sum() > 2 and np.isfinite(steps).any()
        }


def _samples(values: FloatArray, steps: FloatArray) -> Samples:
    """Return the statistics; what a stuck sensor repeats counts once, so that no value of it is frequent."""
    fresh, known = steps != 0.0, np.isfinite(steps)
    scatter = float(np.sqrt(np.mean(steps[known] ** 2) / 2.0))
    moved = steps[known & fresh]
    noise = float(np.sqrt(np.mean(moved**2) / 2.0)) if len(moved) else np.nan
    distinct, where = np.unique(values, return_inverse=True)
    count = np.bincount(where, weights=fresh)
    step = grid_step(distinct, len(values))
    rounded = digits(values) if step > 0.0 else None
    found = Samples(step, scatter, np.inf if rounded is None else rounded.ratio)
    at = int(np.argmax(count))
    beside = max([*count[max(at - 1, 0) : at], *count[at + 1 : at + 2], 1.0])
    share = float(count[at] / max(count.sum(), 1.0))
    coarse = step > 0.0 and not step < noise
    if coarse or len(distinct) < 3 or share < FREQUENT or count[at] < TIMES_MORE * beside:
        return found
    return found._replace(atom=float(distinct[at]), atom_share=share)


class Fault(NamedTuple):
    """What is wrong with the data of a channel.

    `blind` is the most that the fault alone makes of a smooth bias: a smaller effect cannot be found.  It is
    infinite where nothing that is fitted would be the bias.
    """

    text: str
    blind: float
