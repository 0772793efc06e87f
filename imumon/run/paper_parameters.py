"""Keys of a pipeline file for the random error of gyros; apart from the estimators, to load quickly."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from imumon.config import StrictModel

Channel = Literal["gyro_x", "gyro_y", "gyro_z"]
LARGEST_RISK = 0.95


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
    """How the random error of gyros is estimated; every key has a default.

    Parameters
    ----------
    method : "drift" or "sr_rsukf"
        The default, a local level with flicker whose noise is learnt; or the published filter, beside which
        the default, an exponential mean and a plain hold are given, too.
    assume_rest : bool
        Whether the unit is at rest throughout when nothing says (no column ``at_rest``).
    noise : mapping of gyro_x, gyro_y, gyro_z to GyroNoise
        What is known of an axis; others are learnt.
    risk : float
        2 μ_x (R + q) of SR-RSUKF, without unit; 0 is SR-UKF.
    learn_s : float
        s at rest from which the noise is learnt before SR-RSUKF starts.
    phi_limit : float
        φ of SR-RSUKF is held within ±phi_limit.
    mean_s, hold_s : float
        Time constant of the exponential mean, and s at rest of which the hold is the mean.
    """

    method: Literal["drift", "sr_rsukf"] = "drift"
    assume_rest: bool = False
    noise: dict[Channel, GyroNoise] = Field(default_factory=dict)
    risk: float = Field(default=0.5, ge=0.0, le=LARGEST_RISK)
    learn_s: float = Field(default=60.0, ge=10.0, le=86400.0)
    phi_limit: float = Field(default=0.9, gt=0.0, lt=1.0)
    mean_s: float = Field(default=100.0, ge=1.0, le=86400.0)
    hold_s: float = Field(default=60.0, ge=1.0, le=86400.0)
