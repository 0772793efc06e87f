"""Effects of the specific force on a gyro, and of the product of two drivers on any sensor."""

from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray

from .base import ACCEL, TEMPERATURE, Drive, Effect, Memory, Positive, Scale, Survey

LEAST_RANGE = 2.0
"""m/s², about twelve degrees of tilt: with less, poses and turn-on offsets look alike."""
Two = Field(min_length=2, max_length=2)


class GSensitivity(Effect):
    """The specific force along x, y, z in m/s².

    The vertical earth rate, 15.04 °/h times the sine of the latitude at 9.81 m/s², has the form of its
    diagonal.
    """

    kind: Literal["g_sensitivity"] = "g_sensitivity"
    sensors = ("gyro",)
    suspected_by = ("follow each other",)

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


class Product(Effect):
    """u v of two drivers, each as (driver - middle) / half span; of the specific force a u each component.

    Of the specific force with itself the columns are x², y², z², xy, xz and yz, in (m/s²)².  Of another
    driver v is a column as well, the last: at which temperature it does nothing is not known.
    """

    kind: Literal["product"] = "product"
    drivers: Annotated[list[str], Two]
    middle: Annotated[list[FiniteFloat], Two] = [0.0, 0.0]  # noqa: RUF012 - the model copies it
    half_span: Annotated[list[Positive], Two] = [1.0, 1.0]  # noqa: RUF012 - the model copies it

    @property
    def label(self) -> str:
        """For instance ``product(temperature, accel)``."""
        return f"product({', '.join(self.drivers)})"

    @property
    def inputs(self) -> tuple[str, ...]:
        """The drivers."""
        return tuple(name for name in dict.fromkeys(self.drivers) if name != TEMPERATURE)

    def scale_of(self, driver: str) -> Scale | None:
        """Return that of one of its drivers."""
        at = self.drivers.index(driver)
        return Scale(self.middle[at], self.half_span[at])

    @property
    def width(self) -> int:
        """Two, with the specific force three, and with its square six."""
        return {0: 2, 1: 3, 2: 6}[self.drivers.count(ACCEL)]

    @classmethod
    def grid(cls, survey: Survey) -> list[Self]:
        """Return those of the specific force, where it varies: with the temperature, and with itself."""
        if survey.accel_range < LEAST_RANGE:
            return []
        return [*cls.driven(survey, ACCEL), cls(drivers=[ACCEL, ACCEL])]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return that with the temperature, where that varies."""
        if not survey.thermal:
            return []
        scales = survey.scale, survey.others.get(driver, Scale(0.0, 1.0))
        middle, half_span = (list(ends) for ends in zip(*scales, strict=True))
        return [cls(drivers=[TEMPERATURE, driver], middle=middle, half_span=half_span)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the products."""
        first, second = (
            (np.reshape(drive.of(name), (len(drive), -1)) - middle) / half
            for name, middle, half in zip(self.drivers, self.middle, self.half_span, strict=True)
        )
        if first.shape[1] == second.shape[1] == 3:
            rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
            return first[:, rows] * second[:, columns]
        return first * second if ACCEL in self.drivers else np.hstack([first * second, second])
