"""A bias that dies away after power-on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Positive, Survey, logarithmic

SHORTEST_S = 60.0
"""Two means of 30 s: a faster one is over in the first."""


class WarmUp(Effect):
    """exp(-t / time constant), t since power-on."""

    kind: Literal["warm_up"] = "warm_up"
    scope = "either"
    nonlinear = ("time_constant_s",)
    suspected_by = ("time since start",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "drift": "a run longer than four time constants of the warm-up",
        "temperature_rate": "power-on in equilibrium with the ambient temperature held",
        "temperature_curve": "a second run that starts at another temperature",
        "step": "another run: a warm-up comes again at the same time",
    }
    time_constant_s: Positive

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return time constants up to a third of the shortest run: with longer ones it is a drift."""
        return [cls(time_constant_s=tau) for tau in logarithmic(SHORTEST_S, survey.shortest_s / 3)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the decay."""
        return np.exp(-drive.time_s / self.time_constant_s)[:, np.newaxis]
