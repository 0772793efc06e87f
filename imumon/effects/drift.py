"""A bias that grows in proportion to the time since power-on."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey

HOUR_S = 3600.0


class Drift(Effect):
    """Time since power-on in hours."""

    name: ClassVar[str] = "drift"
    kind: Literal["drift"] = "drift"

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - any run can show it
        """Return the one there is."""
        return [cls()]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the hours."""
        return np.asarray(drive.time_s / HOUR_S)[:, np.newaxis]
