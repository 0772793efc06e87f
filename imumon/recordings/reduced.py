"""Means of whole recordings over slots of some seconds, and which of the slots are at rest."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.filters.slots import SlotGatherer, Slots

from .map import triple

AXES = "xyz"
GYRO, ACCEL = triple("gyro"), triple("accel")
PIECE = 4096
"""Samples at a time, to bound the memory: as many slots may end in them."""
QUIET_QUANTILE = 0.25
SIGNIFICANT = 8
"""Samples in a slot whose scatter is reliable: 1 in 400 of them has half or twice of what it should be."""
LOUDER = 3.0
"""A slot is quiet when its scatter on every axis is at most this much above that of the quietest quarter."""
JERK = 0.02
"""m/s² (0.1°): the mean specific force of a quiet slot is within this of its neighbours', beyond noise."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """m columns of a recording over n slots; a slot without samples is not there."""

    names: tuple[str, ...]  # the m columns
    slot_s: float  # length of a slot
    run: IntArray  # which run, (n,): a new segment, or a clock that goes back, begins another
    number: IntArray  # which slot of the grid of its run, (n,)
    segment: IntArray  # (n,)
    start_ns: IntArray  # device time at which the slot begins, (n,)
    span_s: FloatArray  # time between its first and its last sample, (n,)
    rest_share: FloatArray  # share of its samples at rest, (n,); NaN where rest was not detected
    count: IntArray  # finite values, (n, m)
    mean: FloatArray  # of the values, (n, m); NaN without any
    variance: FloatArray  # of the values, unbiased, (n, m); NaN with fewer than two
    smallest: FloatArray  # of the values, (n, m); NaN without any

    def __len__(self) -> int:
        return len(self.segment)

    def of(self, name: str) -> FloatArray:
        """Return the means of a column, (n,)."""
        return self.mean[:, self.names.index(name)]

    def mean_variance(self, name: str) -> FloatArray:
        """Return the variance that the samples' own noise, if it is white, leaves in the means, (n,)."""
        at = self.names.index(name)
        return self.variance[:, at] / np.maximum(self.count[:, at], 1)

    def has(self, name: str) -> bool:
        """Return whether a column has any value."""
        return bool(np.isfinite(self.of(name)).any())

    def at_rest(self) -> BoolArray:
        """Return which slots are at rest: as the detector found, else by `quiet`.

        Never by the size of the rate, which is what is to be found.
        """
        return np.where(np.isfinite(self.rest_share), self.rest_share == 1.0, self.quiet())

    def quiet(self) -> BoolArray:
        """Return which slots scatter little and have the specific force of their neighbours, (n,)."""
        quiet = np.ones(len(self), np.bool_)
        for name in (one for one in (*GYRO, *ACCEL) if one in self.names and self.has(one)):
            at = self.names.index(name)
            scatter = np.sqrt(np.where(self.count[:, at] >= SIGNIFICANT, self.variance[:, at], np.nan))
            known = scatter[np.isfinite(scatter)]
            if len(known):
                quiet &= ~(scatter > LOUDER * np.quantile(known, QUIET_QUANTILE))
            if name in ACCEL:  # a slot without a value is no evidence
                steps = np.abs(np.diff(self.of(name)))
                there = steps[np.isfinite(steps)]
                of_means = np.median(there) / (0.6745 * 2.0**0.5) if len(there) else 0.0
                sd = scatter / np.sqrt(np.maximum(self.count[:, at], 1))
                # Of a slot with too few samples its neighbours show how far it scatters.
                sd = np.where(np.isfinite(sd), sd, of_means)
                near = ~(steps > JERK + 5.0 * np.hypot(sd[1:], sd[:-1]))
                quiet[1:] &= near
                quiet[:-1] &= near
        return quiet


def reduce(blocks: Iterable[SampleBlock], names: Sequence[str], slot_s: float) -> Reduced:
    """Reduce samples with device_time_ns and segment, and at_rest where it was detected, in bounded memory.

    `names`: columns to reduce; one that a block lacks is missing there.
    `slot_s`: length of a slot; slots lie on a grid from the first sample of each run.
    """
    gatherer = gatherer_of(names, slot_s)
    parts = [part for block in blocks for part in kept_slots(gatherer, block, names)]
    parts.append(KeptSlots.of(gatherer.finish()))
    kept = KeptSlots(*(np.concatenate([getattr(part, name) for part in parts]) for name in KEPT))
    run = np.cumsum(kept.begins) - 1
    origin = kept.start_ns[kept.begins][run]
    number = (kept.start_ns - origin) // gatherer.length_ns
    with np.errstate(invalid="ignore", divide="ignore"):
        unbiased = np.where(kept.count > 1, kept.variance * kept.count / (kept.count - 1), np.nan)
    return Reduced(
        names=tuple(names),
        slot_s=slot_s,
        run=run,
        number=number,
        segment=kept.segment,
        start_ns=origin + number * gatherer.length_ns,
        span_s=np.asarray((kept.end_ns - kept.start_ns) * 1e-9),
        rest_share=kept.mean[:, -1],
        count=kept.count[:, :-1],
        mean=kept.mean[:, :-1],
        variance=unbiased[:, :-1],
        smallest=kept.smallest[:, :-1],
    )


def gatherer_of(names: Sequence[str], slot_s: float) -> SlotGatherer:
    """Return what gathers these columns, and whether the unit was at rest, into slots of so many seconds."""
    return SlotGatherer(len(names) + 1, round(slot_s * 1e9))


def kept_slots(gatherer: SlotGatherer, block: SampleBlock, names: Sequence[str]) -> "Iterator[KeptSlots]":
    """Yield the slots that end in a block of samples, a piece at a time.

    The last column is 1 at rest, 0 when not, and NaN where rest was not detected; a column that the block
    lacks is missing.
    """
    for start in range(0, len(block), PIECE):
        piece = block.rows(start, start + PIECE)
        at_rest = piece["at_rest"] == 1 if "at_rest" in piece else np.full(len(piece), np.nan)
        values = np.column_stack([piece.stacked(names), at_rest])
        yield KeptSlots.of(gatherer.process(piece["device_time_ns"], piece["segment"], values))


@dataclass(frozen=True, eq=False)
class KeptSlots:
    """What is kept of m slots of k columns that ended; the fields are those of `Slots`."""

    segment: IntArray
    begins: BoolArray
    start_ns: IntArray
    end_ns: IntArray
    count: IntArray
    mean: FloatArray
    variance: FloatArray
    smallest: FloatArray

    @classmethod
    def of(cls, slots: Slots) -> Self:
        """Return what is kept, without the memory of the rest."""
        return cls(*(getattr(slots, name).copy() for name in KEPT))

    def __len__(self) -> int:
        return len(self.begins)

    def __getitem__(self, which: slice) -> Self:
        return type(self)(*(getattr(self, name)[which] for name in KEPT))


KEPT = tuple(field.name for field in fields(KeptSlots))
