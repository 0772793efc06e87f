"""A bias that swings with a period, from a fan, a regulator or a mains hum that is sampled slowly."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Positive, Survey

LEAST_CYCLES = 4.0
"""Half a cycle imitates any slow residual."""
STEP = 0.4
"""Distance of neighbouring frequencies, as a share of the resolution of the longest run."""
BLOCKS_PER_PERIOD = 3.0
MOST_FREQUENCIES = 800


class Periodic(Effect):
    """sin and cos of 2 pi t / period, t since power-on."""

    name: ClassVar[str] = "periodic"
    kind: Literal["periodic"] = "periodic"
    nonlinear: ClassVar[tuple[str, ...]] = ("period_s",)
    period_s: Positive

    @property
    def width(self) -> int:
        """Sine and cosine."""
        return 2

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return periods of which every run holds at least four."""
        lowest = LEAST_CYCLES / survey.shortest_s
        highest = 1.0 / (BLOCKS_PER_PERIOD * survey.block_s)
        step = STEP / max(survey.durations_s)
        count = min(MOST_FREQUENCIES, int((highest - lowest) / step) + 1)
        return (
            [cls(period_s=1.0 / (lowest + index * step)) for index in range(count)]
            if highest > lowest
            else []
        )

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return sine and cosine."""
        phase = 2 * np.pi / self.period_s * drive.time_s
        return np.column_stack([np.sin(phase), np.cos(phase)])

    def spacing(self, survey: Survey, value: float) -> float:  # noqa: ARG002 - frequencies are evenly spaced
        """Return the distance of the frequencies in Hz."""
        return STEP / max(survey.durations_s)

    def moved(self, value: float, step: float) -> float:
        """Return the period of a frequency moved by a step."""
        return 1.0 / (1.0 / value + step)
