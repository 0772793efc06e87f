"""Effects of the time since power-on: what dies away, grows, jumps or swings, and each run's own constant."""

from functools import cache
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray

from .base import RATIO, Drive, Effect, Memory, Positive, Survey, logarithmic

SHORTEST_WARM_UP_S = 60.0
"""Two means of 30 s: a faster one is over in the first."""
SHORTEST_RELAXATION_S = 5.0
WIDTHS = (4.0, 16.0)
MOST_STEPS = 5
"""Up to five steps of these widths leave 0.2 to 0.6 % (rms, median; 2.9 % at most) of creeps through thirty
random barriers and of stretched exponentials, in 20 min, in 2 h and in 20 h, before they are refined."""
BEGUN = 1e-9
"""Share of a time constant: at power-on itself either integral is infinite, and their difference is not."""
EDGE_BLOCKS = 3
"""A jump closer than this to an end of the run cannot be distinguished from a bad block."""
LEAST_CYCLES = 4.0
"""Half a cycle imitates any slow residual."""
FREQUENCY_STEP = 0.4
"""Distance of neighbouring frequencies, as a share of the resolution of the longest run."""
BLOCKS_PER_PERIOD = 3.0
MOST_FREQUENCIES = 1000
"""As many as 1200 means have, the most that a search goes over.  Of more means the shortest periods are not
tried."""


class WarmUp(Effect):
    """exp(-t / time constant), t since power-on."""

    kind: Literal["warm_up"] = "warm_up"
    scope = "either"
    nonlinear = ("time_constant_s",)
    suspected_by = ("time since start",)
    time_constant_s: Positive

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a third of the shortest run: with longer ones it is a drift."""
        return [cls(time_constant_s=tau) for tau in logarithmic(SHORTEST_WARM_UP_S, survey.shortest_s / 3)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the decay."""
        return np.exp(-drive.time_s / self.time_constant_s)[:, None]


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
            for tau in logarithmic(
                SHORTEST_RELAXATION_S, survey.shortest_s / max(3.0, ratio ** (steps - 1)), RATIO**2
            )
        ]

    def moved(self, name: str, step: float, survey: Survey) -> float:
        """Return a parameter moved; a ratio stays above 1."""
        if name == "ratio":
            return 1.0 + (self.ratio - 1.0) * float(np.exp(0.3 * step))
        return super().moved(name, step, survey)

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return what is left of each step."""
        ends = self.time_constant_s * self.ratio ** np.arange(self.steps + 1)
        logarithm, table = np.log(np.maximum(drive.time_s, BEGUN * self.time_constant_s)), _integral()
        logs = [logarithm - np.log(end) for end in ends]
        integrals = [np.interp(log, *table) + np.maximum(table[0][0] - log, 0.0) for log in logs]
        return np.column_stack([slow - fast for fast, slow in pairwise(integrals)])


@cache
def _integral() -> tuple[FloatArray, FloatArray]:
    """Return log x and E1(x), from ends 1e9 time constants long to an E1 of 1e-19.

    A line between these errs by 1.1e-7; `exp1` would take ten times as long.  Before them E1 grows as log x
    falls.
    """
    from scipy.special import exp1  # 0.13 s, which no command spends that has no such effect

    logarithm = np.linspace(np.log(1e-9 * BEGUN), np.log(40.0), 30_000)
    return logarithm, exp1(np.exp(logarithm))


class Drift(Effect):
    """Time since power-on in hours."""

    kind: Literal["drift"] = "drift"
    scope = "either"
    suspected_by = ("time since start", "follow each other")

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the hours."""
        return (drive.time_s / 3600.0)[:, None]


class Step(Effect):
    """0 before the time, 1 after; each run has its own time and size."""

    kind: Literal["step"] = "step"
    scope = "event"
    nonlinear = ("time_s",)
    suspected_by = ("follow each other",)
    time_s: FiniteFloat

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return times at the bounds of the blocks of the longest run."""
        blocks = int(max(survey.durations_s) / survey.block_s)
        return [cls(time_s=index * survey.block_s) for index in range(EDGE_BLOCKS, blocks - EDGE_BLOCKS + 1)]

    def fits_in(self, duration_s: float, survey: Survey) -> bool:
        """Return whether the jump is not too near to an end of such a run."""
        edge = EDGE_BLOCKS * survey.block_s
        return edge <= self.time_s <= duration_s - edge

    def moved(self, name: str, step: float, survey: Survey) -> float:  # noqa: ARG002 - its one parameter
        """Return another time: the grid is that of the blocks."""
        return self.time_s + step * survey.block_s

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return whether the jump has been."""
        return np.asarray(drive.time_s >= self.time_s, np.float64)[:, None]


class RunOffset(Effect):
    """A constant; what it is in another run cannot be foreseen."""

    kind: Literal["run_offset"] = "run_offset"
    scope = "run"

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none with a single run."""
        return [cls()] if survey.runs > 1 else []

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return ones."""
        return np.ones((len(drive), 1))


class Periodic(Effect):
    """sin and cos of 2 pi k t / period, k = 1, 3, ... as many as `harmonics` states; t since power-on.

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
        step = FREQUENCY_STEP / max(survey.durations_s)
        count = min(MOST_FREQUENCIES, int((highest - lowest) / step) + 1) if highest > lowest else 0
        return [cls(period_s=1.0 / (lowest + index * step)) for index in range(count)]

    def moved(self, name: str, step: float, survey: Survey) -> float:  # noqa: ARG002 - its one parameter
        """Return another period: the grid is one of frequencies."""
        return 1.0 / (1.0 / self.period_s + step * FREQUENCY_STEP / max(survey.durations_s))

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return sine and cosine of each harmonic."""
        phase = 2 * np.pi / self.period_s * drive.time_s
        odd = (2 * np.arange(self.harmonics) + 1).tolist()
        return np.column_stack([part for k in odd for part in (np.sin(k * phase), np.cos(k * phase))])
