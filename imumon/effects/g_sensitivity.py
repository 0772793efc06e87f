"""A gyro bias that depends on the specific force."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, Self

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL, Drive, Effect, Memory, Survey

LEAST_RANGE = 2.0
"""m/s², about twelve degrees of tilt: with less, poses and turn-on offsets look alike."""


class GSensitivity(Effect):
    """The specific force along x, y, z in m/s².

    The vertical earth rate, 15.04 °/h times the sine of the latitude at 9.81 m/s², has the form of its
    diagonal.
    """

    kind: Literal["g_sensitivity"] = "g_sensitivity"
    sensors = ("gyro",)
    suspected_by = ("follow each other",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "run_offset": "at least four poses within one run",
        "step": "each pose taken twice in one run",
    }

    @property
    def width(self) -> int:
        """One for each axis."""
        return 3

    @property
    def inputs(self) -> tuple[str, ...]:
        """The specific force."""
        return (ACCEL,)

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none unless the pose changes within a run."""
        return [cls()] if survey.accel_range >= LEAST_RANGE else []

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the specific force."""
        return drive.of(ACCEL)
