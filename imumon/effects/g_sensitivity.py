"""A gyro bias that depends on the specific force."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey

LEAST_RANGE = 2.0
"""m/s², about twelve degrees of tilt: with less, poses and turn-on offsets look alike."""


class GSensitivity(Effect):
    """The specific force along x, y, z in m/s².

    The vertical earth rate, 15.04 °/h times the sine of the latitude at 9.81 m/s², has the form of its
    diagonal.
    """

    name: ClassVar[str] = "g_sensitivity"
    kind: Literal["g_sensitivity"] = "g_sensitivity"
    needs_accel: ClassVar[bool] = True

    @property
    def width(self) -> int:
        """One for each axis."""
        return 3

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return the one there is; none unless the pose changes within a run."""
        return [cls()] if survey.accel_range >= LEAST_RANGE else []

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the specific force."""
        if drive.accel is None:
            raise ValueError("g sensitivity needs the specific force")
        return drive.accel
