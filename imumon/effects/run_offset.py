"""Each run has a constant of its own: the bias is not the same after each power-on or mounting."""

from __future__ import annotations

from typing import Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Survey


class RunOffset(Effect):
    """A constant; what it is in another run nobody can foresee."""

    kind: Literal["run_offset"] = "run_offset"
    scope = "run"

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none with a single run."""
        return [cls()] if survey.runs > 1 else []

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return ones."""
        return np.ones((len(drive), 1))
