"""The single values of a channel: their steps, the one that comes too often, those that repeat.

Means hide what is wrong with single samples, so these are looked at before.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.filters.rounding import digits, grid_step

KEPT = 100_000
"""Samples of a channel that are kept: evenly spaced over the whole of a recording, at least half as many."""
OFTEN, MORE_OFTEN = 0.01, 10.0
"""A value that has this share of all samples, and so many times more than those beside it, is no chance."""


@dataclass(frozen=True, slots=True)
class Look:
    """What is seen of a channel's values."""

    step: float
    """Of the grid that they lie on; 0 when there is none."""
    noise: float
    """Standard deviation of a sample about its neighbours, of those that differ; NaN when none does."""
    atom: float
    atom_share: float
    """The value that comes far more often than those beside it, and its share of all; NaN and 0 without
    one."""
    place: str
    """Where it is: within the others, at their end, or away from them."""
    repeated: float
    """Share of the samples that equal the one before."""
    ratio: float = np.inf
    """Noise before rounding, in steps, by how often each step is read; infinite where steps are far finer."""

    def without(self, share: float) -> Look:
        """Return what is seen beside this share of the samples, in which its frequent value stood still."""
        left = max(self.atom_share - share, 0.0) / (1.0 - share)
        repeated = max(self.repeated - share, 0.0) / (1.0 - share)
        if left < OFTEN:
            return replace(self, atom=np.nan, atom_share=0.0, place="inside", repeated=repeated)
        return replace(self, atom_share=left, repeated=repeated)


class Watcher:
    """Looks at the values of some channels while they go by."""

    def __init__(self, channels: Sequence[str]) -> None:
        self._kept: dict[str, list[FloatArray]] = {name: [] for name in channels}
        self._stride, self._phase, self._count = 1, 0, 0
        self._pairs = dict.fromkeys(channels, 0)
        self._same = dict.fromkeys(channels, 0)
        self._squares = dict.fromkeys(channels, 0.0)

    def through(self, blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
        """Yield the blocks as they are."""
        for block in blocks:
            self._take(block)
            yield block

    def _take(self, block: SampleBlock) -> None:
        chosen = slice(-self._phase % self._stride, None, self._stride)
        self._phase = (self._phase + len(block)) % self._stride
        self._count += len(block) // self._stride + 1
        for name, kept in self._kept.items():
            if name in block:
                values = block[name]
                steps = np.diff(values[np.isfinite(values)])
                self._pairs[name] += len(steps)
                self._same[name] += int((steps == 0.0).sum())
                self._squares[name] += float(steps @ steps)
                kept.append(values[chosen].astype(np.float64))
        if self._count > KEPT:
            joined = {name: np.concatenate(kept) for name, kept in self._kept.items() if kept}
            self._kept = {name: [values[::2]] for name, values in joined.items()}
            self._stride, self._count = 2 * self._stride, self._count // 2

    def looks(self) -> dict[str, Look]:
        """Return what was seen of each channel that has values."""
        found = {}
        for name, kept in self._kept.items():
            values = np.concatenate(kept) if kept else np.empty(0)
            values = values[np.isfinite(values)]
            if len(values) > 2 and self._pairs[name]:
                differing = self._pairs[name] - self._same[name]
                noise = np.sqrt(self._squares[name] / differing / 2.0) if differing else np.nan
                found[name] = _look(values, float(noise), self._same[name] / self._pairs[name])
        return found


def _look(values: FloatArray, noise: float, repeated: float) -> Look:
    distinct, count = np.unique(values, return_counts=True)
    step = grid_step(distinct, len(values))
    rounded = digits(values) if step > 0.0 else None
    ratio = np.inf if rounded is None else rounded.ratio
    at = int(np.argmax(count))
    beside = max(count[max(at - 1, 0) : at].tolist() + count[at + 1 : at + 2].tolist(), default=0)
    share = count[at] / len(values)
    coarse = step > 0.0 and not step < noise
    if coarse or len(distinct) < 3 or share < OFTEN or count[at] < MORE_OFTEN * max(beside, 1):
        return Look(step, noise, np.nan, 0.0, "inside", repeated, ratio)
    others = np.delete(distinct, at)
    place = "inside"
    if at in (0, len(distinct) - 1):
        far = abs(distinct[at] - (others[0] if at == 0 else others[-1])) > noise
        place = "apart" if far else "end"
    return Look(step, noise, float(distinct[at]), float(share), place, repeated, ratio)
