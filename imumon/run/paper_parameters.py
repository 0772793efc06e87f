"""Keys of a pipeline file for the random error of gyros; apart from the estimators, to load quickly."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from imumon.config import StrictModel
from imumon.estimation.rest.parameters import Retired, retired

Channel = Literal["gyro_x", "gyro_y", "gyro_z"]


class GyroNoise(StrictModel):
    """Noise of a gyro axis, as Allan deviations give it; at least one kind of drift is needed.

    Parameters
    ----------
    angle_random_walk : float
        rad/√s, that is rad/s/√Hz.
    bias_instability : float, optional
        rad/s; B of IEEE Std 952, so that the Allan deviation has a floor at 0.664 B.
    rate_random_walk : float, optional
        rad/s/√s.
    """

    angle_random_walk: float = Field(gt=0.0, le=1.0)
    bias_instability: float | None = Field(default=None, ge=0.0, le=1.0)
    rate_random_walk: float | None = Field(default=None, ge=0.0, le=1.0)

    @model_validator(mode="after")
    def _drifts(self) -> Self:
        if not self.bias_instability and not self.rate_random_walk:
            raise ValueError("neither bias_instability nor rate_random_walk: leave the axis out to learn it")
        return self


class RandomErrorParameters(StrictModel):
    """How the published filters estimate the random error of gyros; every key has a default.

    Parameters
    ----------
    assume_rest : bool
        Whether the unit is at rest throughout when nothing says (no column ``at_rest``).
    noise : mapping of gyro_x, gyro_y, gyro_z to GyroNoise
        What is known of an axis; others are learnt.
    learn_s : float
        s at rest from which the noise is learnt before SR-RSUKF starts.
    mean_s, hold_s : float
        Time constant of the exponential mean, and s at rest of which the hold is the mean.
    method, risk, phi_limit
        Not used any more; ``method: sr_rsukf`` is as ``published: [sr_rsukf]``.
    """

    method: Literal["drift", "sr_rsukf"] = "drift"
    assume_rest: bool = False
    noise: dict[Channel, GyroNoise] = Field(default_factory=dict)
    learn_s: float = Field(default=60.0, ge=10.0, le=86400.0)
    mean_s: float = Field(default=100.0, ge=1.0, le=86400.0)
    hold_s: float = Field(default=60.0, ge=1.0, le=86400.0)
    risk: Retired = None
    phi_limit: Retired = None

    @property
    def retired(self) -> list[str]:
        """The keys that were given and are not used any more."""
        return [*retired(self), *(["method"] if self.method != "drift" else [])]
