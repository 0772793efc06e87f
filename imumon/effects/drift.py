"""A bias that grows in proportion to the time since power-on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Survey


class Drift(Effect):
    """Time since power-on in hours."""

    kind: Literal["drift"] = "drift"
    scope = "either"
    suspected_by = ("time since start", "follow each other")
    separated_by: ClassVar[Mapping[str, str]] = {
        "temperature_rate": "a second ramp in the other direction",
        "temperature_curve": "a second ramp in the other direction",
        "run_offset": "longer runs, the device not switched off between them",
        "step": "a longer run: a drift goes on",
    }

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - any run can show it
        """Return the one there is."""
        return [cls()]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - time is its memory
        """Return the hours."""
        return np.asarray(drive.time_s / 3600.0)[:, np.newaxis]
