"""Stress in a package or a mounting that creeps away after power-on, over decades of time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Positive, Survey, logarithmic

SHORTEST_S = 10.0
RATIO = 1.6
STEP = 4.0
"""With steps of 4 four logarithms leave at most 2.7 % (rms) of creeps through thirty random barriers, in 20
min, in 2 h and in 20 h; of steps of 8 it is 4.3 %, and 20 min are too short for four."""
MOST_STEPS = 4


class StressRelaxation(Effect):
    """log(1 + t / tau), tau the time constant and 4, 16 and 64 times that; t since power-on.

    A logarithm is what barriers make that are equally many at each logarithm of their times from tau on
    (Amir, Oreg and Imry 2012, arXiv:1112.3371); a sum of them is a spectrum in steps.
    """

    kind: Literal["stress_relaxation"] = "stress_relaxation"
    scope = "either"
    nonlinear = ("time_constant_s",)
    suspected_by = ("time since start",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "warm_up": "a run of ten time constants of the warm-up: a relaxation goes on",
        "drift": "a run ten times as long: a relaxation slows down",
        "thermal_lag": "power-on in equilibrium with the ambient temperature held",
        "step": "another run: a relaxation comes again at the same time",
    }
    time_constant_s: Positive
    steps: Annotated[int, Field(ge=1, le=MOST_STEPS)] = 1

    @property
    def width(self) -> int:
        """One for each step of the spectrum."""
        return self.steps

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a tenth of the shortest run, the slowest up to its length: with longer
        ones it is a drift."""
        found = []
        for steps in range(1, MOST_STEPS + 1):
            longest = survey.shortest_s / max(10.0, STEP ** (steps - 1))
            times = logarithmic(SHORTEST_S, longest, RATIO)
            found += [cls(time_constant_s=tau, steps=steps) for tau in times]
        return found

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the logarithms."""
        times = self.time_constant_s * STEP ** np.arange(self.steps)
        return np.asarray(np.log1p(np.maximum(drive.time_s, 0.0)[:, np.newaxis] / times))
