"""Effects by which a bias follows its driver late: powers of it less those of the late one."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Memory, ScaledEffect, Survey
from imumon.effects.temperature_curve import MORE_DEGREES

SHORTEST_S = 20.0
"""A lag or delay that is shorter is a rate in means of 30 s."""
HIGHEST_ORDER = 9


class Follower(ScaledEffect):
    """u^k - v^k, k = 1 .. order: u the driver, v what follows it, both as (driver - middle) / half span.

    Of another driver than the temperature, which no declared curve is over, u is a column as well, the last.
    """

    order: Annotated[int, Field(ge=1, le=HIGHEST_ORDER)] = 1

    @property
    def width(self) -> int:
        """One for each power, and that of the driver itself."""
        return self.order + (not self.of_temperature)

    @classmethod
    def forms(cls, survey: Survey) -> list[dict[str, Any]]:
        """Return orders and scale to try: none at constant temperature, the cubic where runs can show it."""
        if not survey.thermal:
            return []
        orders = (1, 3) if may_sum(survey, 4) else (1,)
        return [{"order": order, **asdict(survey.scale)} for order in orders]

    @classmethod
    def of_curve(cls, survey: Survey) -> list[Self]:
        """Return those of more powers than are declared; none where the temperature went one way only."""
        every = [max(survey.degree, 1) + more for more in (0, *MORE_DEGREES)]
        orders = [order for order in every if order <= HIGHEST_ORDER]
        linear = [one for one in cls.grid(survey) if one.order == 1] if may_sum(survey, 2) else []
        return [one.model_copy(update={"order": order}) for order in orders for one in linear]

    def follow(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return what follows the driver, (n,), and carry the memory along."""
        raise NotImplementedError

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:
        """Return the differences of powers, ahead less following."""
        ahead, behind = self._powers(drive.of(self.driver)), self._powers(self.follow(memory, drive))
        late = ahead - behind
        return np.asarray(late if self.of_temperature else np.column_stack([late, ahead[:, :1]]))

    def _powers(self, values: FloatArray) -> FloatArray:
        u = (values - self.middle) / self.half_span
        powers = np.empty((len(u), self.order), order="F")
        powers[:, 0] = u
        for k in range(1, self.order):
            powers[:, k] = powers[:, k - 1] * u
        return powers


def may_sum(survey: Survey, reversals: int) -> bool:
    """Return whether the runs can show more than one term of a kind: two runs, or so many turns."""
    return survey.runs > 1 or survey.reversals >= reversals
