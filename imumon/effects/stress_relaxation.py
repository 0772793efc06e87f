"""Stress in a package or a mounting that creeps away after power-on, over decades of time."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import RATIO, Drive, Effect, Memory, Positive, Survey, logarithmic

SHORTEST_S = 5.0
WIDTHS = (4.0, 16.0)
MOST_STEPS = 5
"""Up to five steps of these widths leave 0.2 to 0.6 % (rms, median; 2.9 % at most) of creeps through thirty
random barriers and of stretched exponentials, in 20 min, in 2 h and in 20 h, before they are refined."""
BEGUN = 1e-9
"""Share of a time constant: at power-on itself either integral is infinite, and their difference is not."""


class StressRelaxation(Effect):
    """E1(t / longest) - E1(t / shortest) for each step of a spectrum of barriers, t since power-on.

    That is what barriers make that are equally many at each logarithm of their time constant between two
    ends (Primak 1955, doi:10.1103/PhysRev.100.1677).  The first step begins at `time_constant_s`, each is
    `ratio` wide, and no spectrum has barriers of both signs.
    """

    kind: Literal["stress_relaxation"] = "stress_relaxation"
    scope = "either"
    one_sign = True
    nonlinear = ("time_constant_s", "ratio")
    suspected_by = ("time since start",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "warm_up": "a run of ten time constants of the warm-up: a relaxation goes on",
        "drift": "a run ten times as long: a relaxation slows down",
        "thermal_lag": "power-on in equilibrium with the ambient temperature held",
        "step": "another run: a relaxation comes again at the same time",
    }
    time_constant_s: Positive
    ratio: Annotated[FiniteFloat, Field(gt=1.0)]
    steps: Annotated[int, Field(ge=1, le=MOST_STEPS)] = 1

    @property
    def width(self) -> int:
        """One for each step of the spectrum."""
        return self.steps

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return spectra that begin within a third of the shortest run, their slowest step within all of it:
        others are a drift."""
        return [
            cls(time_constant_s=tau, ratio=ratio, steps=steps)
            for ratio in WIDTHS
            for steps in range(1, MOST_STEPS + 1)
            for tau in logarithmic(SHORTEST_S, survey.shortest_s / max(3.0, ratio ** (steps - 1)), RATIO**2)
        ]

    def moved(self, name: str, step: float, survey: Survey) -> float:
        """Return a parameter moved; a ratio stays above 1."""
        if name == "ratio":
            return 1.0 + (self.ratio - 1.0) * float(np.exp(0.3 * step))
        return super().moved(name, step, survey)

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return what is left of each step."""
        ends = self.time_constant_s * self.ratio ** np.arange(self.steps + 1)
        logarithm = np.log(np.maximum(drive.time_s, BEGUN * self.time_constant_s))
        integrals = [np.interp(logarithm - np.log(end), *_integral()) for end in ends]
        return np.column_stack([slow - fast for fast, slow in pairwise(integrals)])


@cache
def _integral() -> tuple[FloatArray, FloatArray]:
    """Return log x and E1(x), from ends 1e9 time constants long to an E1 of 1e-19.

    A line between these errs by 1.1e-7; calls of `exp1` would take ten times as long.
    """
    from scipy.special import exp1  # 0.13 s, which no command spends that has no such effect

    logarithm = np.linspace(np.log(1e-9 * BEGUN), np.log(40.0), 30_000)
    return logarithm, np.asarray(exp1(np.exp(logarithm)))
