"""Settings of the bias estimator in a pipeline file; apart from it, so that it loads quickly."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator

from imumon.config import StrictModel

_Positive = Annotated[float, Field(gt=0.0, le=10.0)]
_NotNegative = Annotated[float, Field(ge=0.0, le=10.0)]
_PerAxis = _Positive | Annotated[list[_Positive], Field(min_length=3, max_length=3)]
_PerAxisOrNone = _NotNegative | Annotated[list[_NotNegative], Field(min_length=3, max_length=3)]


class GyroBiasParameters(StrictModel):
    """Noise of the sensors, and how the bias is followed; every key has a default, which suits any unit.

    Parameters
    ----------
    angle_random_walk_rad_per_sqrt_s : float or [x, y, z], optional
        Square root of the two-sided density of the gyro's white noise (0.28 °/√h is 8.1e-5).  Measured at
        rest when it is not given.
    bias_instability_rad_per_s, rate_random_walk_rad_per_s_per_sqrt_s : float or [x, y, z], optional
        Flicker coefficient B (floor of the Allan deviation 0.664 B) and bias random walk K.  When one is
        given, both hold, the other being zero, in proportion to the white noise of the first rest.  When
        neither is, how much the bias wanders is learned from the innovations.
    velocity_random_walk_m_per_s_per_sqrt_s : float, optional
        The same for the accelerometers.  Not used: it is measured at rest.
    zeroing_s : float
        Not used any more: nothing is filtered twice.
    assume_at_rest : bool
        Whether data without the column at_rest are taken as at rest throughout.
    """

    angle_random_walk_rad_per_sqrt_s: _PerAxis | None = None
    bias_instability_rad_per_s: _PerAxisOrNone | None = None
    rate_random_walk_rad_per_s_per_sqrt_s: _PerAxisOrNone | None = None
    velocity_random_walk_m_per_s_per_sqrt_s: _Positive | None = None
    zeroing_s: float = Field(default=60.0, ge=5.0, le=240.0)
    assume_at_rest: bool = False

    @property
    def retired(self) -> set[str]:
        """Keys that were given and are not used any more."""
        return self.model_fields_set & {"zeroing_s"}

    @model_validator(mode="before")
    @classmethod
    def _of_today(cls, given: Any) -> Any:
        """Take what sessions of before say by default: what is added was chosen once."""
        if isinstance(given, dict) and given.get("thermal_form") == "increments":
            return {key: value for key, value in given.items() if key != "thermal_form"}
        return given
