"""A bias that swings with a period, from a fan, a regulator or a mains hum that is sampled slowly."""

from __future__ import annotations

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Positive, Survey

LEAST_CYCLES = 4.0
"""Half a cycle imitates any slow residual."""
STEP = 0.4
"""Distance of neighbouring frequencies, as a share of the resolution of the longest run."""
BLOCKS_PER_PERIOD = 3.0
MOST_FREQUENCIES = 1000
"""As many as 1200 means have, the most that a search goes over.  Of more means the shortest periods are not
tried."""


class Periodic(Effect):
    """sin and cos of 2 pi k t / period, k = 1, 3, ... as many as `harmonics` says; t since power-on.

    Odd ones: what swings is mostly alike on its way up and down.
    """

    kind: Literal["periodic"] = "periodic"
    scope = "either"
    nonlinear = ("period_s",)
    suspected_by = ("follow each other",)
    period_s: Positive
    harmonics: Annotated[int, Field(ge=1, le=9)] = 1

    @property
    def width(self) -> int:
        """Sine and cosine of each harmonic."""
        return 2 * self.harmonics

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return periods of which every run holds at least four."""
        lowest = LEAST_CYCLES / survey.shortest_s
        highest = 1.0 / (BLOCKS_PER_PERIOD * survey.block_s)
        step = STEP / max(survey.durations_s)
        count = min(MOST_FREQUENCIES, int((highest - lowest) / step) + 1) if highest > lowest else 0
        return [cls(period_s=1.0 / (lowest + index * step)) for index in range(count)]

    def moved(self, name: str, step: float, survey: Survey) -> float:  # noqa: ARG002 - its one parameter
        """Return another period: the grid is one of frequencies."""
        return 1.0 / (1.0 / self.period_s + step * STEP / max(survey.durations_s))

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return sine and cosine of each harmonic."""
        phase = 2 * np.pi / self.period_s * drive.time_s
        odd = (2 * np.arange(self.harmonics) + 1).tolist()
        return np.column_stack([part for k in odd for part in (np.sin(k * phase), np.cos(k * phase))])
