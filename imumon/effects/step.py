"""The bias jumps once, at a time that nobody can foresee."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey

EDGE_BLOCKS = 3
"""A jump closer than this to an end of the run cannot be told from a bad block."""
MOST_TIMES = 300


class Step(Effect):
    """0 before the time, 1 after; each run has its own time and size."""

    name: ClassVar[str] = "step"
    kind: Literal["step"] = "step"
    own: ClassVar[bool] = True
    nonlinear: ClassVar[tuple[str, ...]] = ("time_s",)
    time_s: FiniteFloat

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return times at the bounds of the blocks of the longest run."""
        blocks = int(max(survey.durations_s) / survey.block_s)
        stride = max(1, -(-blocks // MOST_TIMES))
        return [
            cls(time_s=index * survey.block_s)
            for index in range(EDGE_BLOCKS, blocks - EDGE_BLOCKS + 1, stride)
        ]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return whether the jump has been."""
        return np.asarray(drive.time_s >= self.time_s, np.float64)[:, np.newaxis]

    def spacing(self, survey: Survey, value: float) -> float:  # noqa: ARG002 - the same everywhere
        """Return the distance of the blocks in seconds."""
        return survey.block_s

    def moved(self, value: float, step: float) -> float:
        """Return another time."""
        return value + step
