"""A channel takes part of what the other two axes of its sensor measure."""

from __future__ import annotations

from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Survey
from imumon.effects.g_sensitivity import LEAST_RANGE


class AxisCoupling(Effect):
    """The specific force along the two other axes, for an accelerometer: misalignment of one axis to the
    others.

    For a gyro the same two columns are part of its sensitivity to g; the diagonal one is where the earth
    rate is.
    """

    name: ClassVar[str] = "axis_coupling"
    kind: Literal["axis_coupling"] = "axis_coupling"
    needs_accel: ClassVar[bool] = True
    axis: Literal["x", "y", "z"]

    @property
    def width(self) -> int:
        """The other two axes."""
        return 2

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return one for each axis; none unless the pose changes within a run."""
        if survey.accel_range < LEAST_RANGE:
            return []
        axes: tuple[Literal["x", "y", "z"], ...] = ("x", "y", "z")
        return [cls(axis=axis) for axis in axes]

    def advance(self, state: FloatArray, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the specific force along the other two axes."""
        if drive.accel is None:
            raise ValueError("axis coupling needs the specific force")
        return np.delete(drive.accel, "xyz".index(self.axis), axis=1)
