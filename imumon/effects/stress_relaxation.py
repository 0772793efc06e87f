"""Stress in a package or a mounting that creeps away after power-on, over decades of time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Positive, Survey, logarithmic

SHORTEST_S = 10.0
LONGEST_S = 2000.0
RATIO = 1.6
EXPONENTS = (0.0, 0.3, 0.5)
LARGEST_EXPONENT = 0.6
"""Nearer to 1 it is a warm-up."""


class StressRelaxation(Effect):
    """exp(-(t / time constant)^exponent) (Kohlrausch); with exponent 0, log(1 + t / time constant).

    The logarithm is what the other tends to as its exponent goes to 0.  t since power-on.
    """

    kind: Literal["stress_relaxation"] = "stress_relaxation"
    scope = "either"
    nonlinear = ("time_constant_s", "exponent")
    suspected_by = ("time since start",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "warm_up": "a run of ten time constants of the warm-up: a relaxation goes on",
        "drift": "a run ten times as long: a relaxation slows down",
        "thermal_lag": "power-on in equilibrium with the ambient temperature held",
        "step": "another run: a relaxation comes again at the same time",
    }
    time_constant_s: Positive
    exponent: Annotated[FiniteFloat, Field(ge=0.0, lt=1.0)] = 0.0

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a tenth of the shortest run: with longer ones it is a drift."""
        times = logarithmic(SHORTEST_S, min(LONGEST_S, survey.shortest_s / 10), RATIO)
        return [cls(time_constant_s=tau, exponent=power) for power in EXPONENTS for tau in times]

    def moved(self, name: str, step: float, survey: Survey) -> float:
        """Return a parameter moved; the exponent no nearer to 1 than `LARGEST_EXPONENT`."""
        value = super().moved(name, step, survey)
        return min(value, LARGEST_EXPONENT) if name == "exponent" else value

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the decay, or the logarithm."""
        ratio = np.maximum(drive.time_s, 0.0) / self.time_constant_s
        column = np.exp(-(ratio**self.exponent)) if self.exponent else np.log1p(ratio)
        return np.asarray(column[:, np.newaxis])
