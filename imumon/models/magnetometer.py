"""Hard and soft iron of a unit: what turns its magnetometer's readings into the field."""

from typing import Annotated, Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from imumon.blocks import FloatArray
from imumon.config import StrictModel

_Three = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
_NotNegative = Annotated[FiniteFloat, Field(ge=0.0)]


class MagnetometerModel(StrictModel):
    """Field = soft_iron (reading - hard_iron), as `imumon magnetometer` finds it."""

    unit: str
    """Of readings and field, as the device has it."""
    hard_iron: _Three
    hard_iron_sd: _Three
    """Reading where there is no field."""
    soft_iron: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    soft_iron_sd: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    """Symmetric; it leaves the mean strength of the field as it was read."""
    field: Annotated[FiniteFloat, Field(gt=0.0)]
    """Strength of the field."""
    residual_sd: _NotNegative
    """What a reading is off from that strength after the correction, noise and all."""
    coverage: Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
    """Share of the directions that were measured, 0 to 1."""
    session: str | None = None
    sha256: str | None = None
    """The recording."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if np.linalg.eigvalsh(np.array(self.soft_iron)).min() <= 0.0:
            raise ValueError("soft_iron is not a stretching: an eigenvalue is not positive")
        return self

    def corrected(self, mag: FloatArray) -> FloatArray:
        """Return the field in body axes of readings, (n, 3)."""
        return np.asarray((mag - np.array(self.hard_iron)) @ np.array(self.soft_iron).T)

    @property
    def fit_sd(self) -> float:
        """Standard deviation of a component of the field by what the fit does not know."""
        return float(np.hypot(max(self.hard_iron_sd), self.field * np.array(self.soft_iron_sd).max()))

    @property
    def error_sd(self) -> float:
        """Standard deviation of a component of the field by that and by what is left over."""
        return float(np.hypot(self.residual_sd, self.fit_sd))
