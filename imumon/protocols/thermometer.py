"""What a device file holds of temperature sensors; apart from the estimators, so that it loads quickly."""

from typing import Literal

from pydantic import Field

from imumon.config import StrictModel


class TemperatureRateParameters(StrictModel):
    """What a device file states of its temperature sensors; every key has a default.

    Parameters
    ----------
    method : "level_bank" or "fir_exponential"
        Not used any more: the latter is as ``published: [fir]`` of a pipeline file.
    step_degc : float, optional
        Quantization step δτ in °C, else it is estimated.
    window_s, time_constant_s, buffer_size
        T_w and T0 in s and N of the published filter; the estimator does not use them.
    lowest_degc, highest_degc
        Not used any more: readings that cannot be are left out before the estimators.
    """

    method: Literal["level_bank", "fir_exponential"] = "level_bank"
    step_degc: float | None = Field(default=None, gt=0.0, le=10.0)
    window_s: float = Field(default=300.0, gt=0.0, le=86400.0)
    time_constant_s: float = Field(default=180.0, gt=0.0, le=86400.0)
    buffer_size: int = Field(default=1000, ge=7, le=1_000_000)
    lowest_degc: float | None = Field(default=None, exclude=True)
    highest_degc: float | None = Field(default=None, exclude=True)
