"""The bias jumps once, at an unknown time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np
from pydantic import FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Survey

EDGE_BLOCKS = 3
"""A jump closer than this to an end of the run cannot be told from a bad block."""
MOST_TIMES = 300


class Step(Effect):
    """0 before the time, 1 after; each run has its own time and size."""

    kind: Literal["step"] = "step"
    scope = "event"
    nonlinear = ("time_s",)
    suspected_by = ("follow each other",)
    separated_by: ClassVar[Mapping[str, str]] = {"run_offset": "a run with the jump in its middle"}
    time_s: FiniteFloat

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return times at the bounds of the blocks of the longest run."""
        blocks = int(max(survey.durations_s) / survey.block_s)
        stride = max(1, -(-blocks // MOST_TIMES))
        bounds = range(EDGE_BLOCKS, blocks - EDGE_BLOCKS + 1, stride)
        return [cls(time_s=index * survey.block_s) for index in bounds]

    def fits_in(self, duration_s: float, survey: Survey) -> bool:
        """Return whether the jump is not too near to an end of such a run."""
        edge = EDGE_BLOCKS * survey.block_s
        return edge <= self.time_s <= duration_s - edge

    def moved(self, name: str, step: float, survey: Survey) -> float:  # noqa: ARG002 - its one parameter
        """Return another time: the grid is that of the blocks."""
        return self.time_s + step * survey.block_s

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return whether the jump has been."""
        return np.asarray(drive.time_s >= self.time_s, np.float64)[:, np.newaxis]
