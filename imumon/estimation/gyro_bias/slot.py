"""What a slot says to the bias: while the unit moves, and at rest."""

from __future__ import annotations

from dataclasses import dataclass

from imumon.blocks import FloatArray
from imumon.filters.turns import Turn

MOVED_DEGC = 0.5
"""The temperature has moved when it is this far from where it was last noted: noise does not count."""


@dataclass(frozen=True, slots=True, eq=False)
class Slot:
    """What the samples of half a second say."""

    start_s: float
    end_s: float
    """From the end of the slot before, or the first sample at rest, to the last sample; of a gap, to the
    first sample behind it."""
    holds_s: float
    """How long it takes until the next one ends."""
    follows: bool
    """Whether the unit was at rest, without a gap, at the end of the slot before and since then."""
    rest: bool
    """Whether it is at rest at the end."""
    rate: FloatArray
    """Mean of the gyros at rest less what the thermal model has added, rad/s, (3,); where it moves, of
    all."""
    force: FloatArray | None
    """Mean specific force, m/s², (3,)."""
    degc: FloatArray
    """Temperature of each gyro, (3,); NaN without any."""
    growth: FloatArray
    """What an uncertain temperature has added to the variance of the bias since the start, (rad/s)², (3,)."""
    lag_degc: FloatArray
    """By how much the gyros' temperatures may have fallen behind meanwhile, unseen (sd), °C, (3,)."""
    undecided: FloatArray
    """A turn, rad/s, of which nobody knows whether it is a change of the bias, or, at rest, nobody knew
    until then, (3,); else 0."""
    turn: Turn
    """Since the slot before, by rates less the thermal model's part."""
    gap: bool
    """Whether readings were missing for a while.  A slot that is nothing but a gap has no rate (NaN)."""
    covered: float = 1.0
    """Share of it that its samples cover at the shortest interval so far: lost ones leave more noise."""

    @property
    def dt(self) -> float:
        """Length, s."""
        return self.end_s - self.start_s

    @property
    def averaged_s(self) -> float:
        """What its samples cover, s: the white noise of its mean is that of so long."""
        return self.covered * self.dt


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A slot at rest, less the earth rate; `tilt` since the rest began, `fresh` when it is the first."""

    slot: Slot
    rate: FloatArray
    tilt: FloatArray
    fresh: bool
