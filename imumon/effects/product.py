"""A bias that one driver gives another one's hold on: the product of the two."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, FiniteFloat

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL, TEMPERATURE, Drive, Effect, Memory, Positive, Scale, Survey
from imumon.effects.g_sensitivity import LEAST_RANGE

Pair = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]


class Product(Effect):
    """u v of two drivers, each as (driver - middle) / half span; of the specific force a u each component.

    Of the specific force with itself the columns are x², y², z², xy, xz and yz, in (m/s²)².  Of another
    driver v is a column as well, the last: nobody knows at which temperature it does nothing.
    """

    kind: Literal["product"] = "product"
    separated_by: ClassVar[Mapping[str, str]] = {
        "g_sensitivity": "each pose at several temperatures, and upside down",
        "temperature_curve": "a run at one temperature in which the other driver moves",
    }
    drivers: Annotated[list[str], Field(min_length=2, max_length=2)]
    middle: Pair = Field(default_factory=lambda: [0.0, 0.0])
    half_span: Annotated[list[Positive], Field(min_length=2, max_length=2)] = Field(
        default_factory=lambda: [1.0, 1.0]
    )

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
        warm = cls(
            drivers=[TEMPERATURE, ACCEL],
            middle=[survey.middle_degc, 0.0],
            half_span=[survey.half_span_degc, 1.0],
        )
        square = cls(drivers=[ACCEL, ACCEL])
        return [warm, square] if survey.thermal else [square]

    @classmethod
    def driven(cls, survey: Survey, driver: str) -> list[Self]:
        """Return that with the temperature."""
        middle, half = astuple(survey.others[driver])
        if not survey.thermal:
            return []
        return [
            cls(
                drivers=[TEMPERATURE, driver],
                middle=[survey.middle_degc, middle],
                half_span=[survey.half_span_degc, half],
            )
        ]

    def contains(self, label: str) -> bool:
        """Tell whether it is a curve over the second driver."""
        return label == f"curve({self.drivers[1]})"

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it has no memory
        """Return the products."""
        first, second = (
            (_values(drive, name) - middle) / half
            for name, middle, half in zip(self.drivers, self.middle, self.half_span, strict=True)
        )
        if first.shape[1] == second.shape[1] == 3:
            rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
            return np.asarray(first[:, rows] * second[:, columns])
        return np.asarray(first * second if ACCEL in self.drivers else np.hstack([first * second, second]))


def _values(drive: Drive, driver: str) -> FloatArray:
    """Return a driver, (n, 1), or the specific force, (n, 3)."""
    if driver != ACCEL:
        return drive.of(driver)[:, np.newaxis]
    if drive.accel is None:
        raise ValueError("a product with the specific force needs it")
    return drive.accel
