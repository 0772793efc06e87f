"""Temperature rate as a stage of the pipeline: one estimator per temperature channel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from imumon.blocks import ColumnArray, SampleBlock
from imumon.columns import Column
from imumon.config import StrictModel
from imumon.errors import ImumonError, Reason
from imumon.estimation.temperature_rate.fir import FirExponentialRate
from imumon.estimation.temperature_rate.level_bank import LevelBankRate
from imumon.estimation.temperature_rate.series import RateMethod
from imumon.estimation.temperature_rate.step import StepFinder

CHANNEL = "temperature"


class TemperatureRateParameters(StrictModel):
    """What a device file says of its temperature sensors; every key has a default.

    Parameters
    ----------
    method : "level_bank" or "fir_exponential"
        The default, which needs no tuning; or the published filter.
    step_degc : float, optional
        Quantization step δτ in °C.  The default method finds it; the published one must be told.
    window_s, time_constant_s, buffer_size
        T_w and T0 in s and N of the published filter; the default method does not use them.
    lowest_degc, highest_degc : float
        Readings outside are taken as missing.
    """

    method: Literal["level_bank", "fir_exponential"] = "level_bank"
    step_degc: float | None = Field(default=None, gt=0.0, le=10.0)
    window_s: float = Field(default=300.0, gt=0.0, le=86400.0)
    time_constant_s: float = Field(default=180.0, gt=0.0, le=86400.0)
    buffer_size: int = Field(default=1000, ge=7, le=1_000_000)
    lowest_degc: float = Field(default=-100.0, ge=-273.15)
    highest_degc: float = Field(default=250.0, le=2000.0)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.method == "fir_exponential" and self.step_degc is None:
            raise ValueError("method fir_exponential needs step_degc")
        if self.lowest_degc >= self.highest_degc:
            raise ValueError(f"lowest_degc {self.lowest_degc} is not below highest_degc {self.highest_degc}")
        return self


def _level_bank(parameters: TemperatureRateParameters) -> RateMethod:
    return LevelBankRate(parameters.step_degc)


def _fir_exponential(parameters: TemperatureRateParameters) -> RateMethod:
    if parameters.step_degc is None:
        raise ImumonError(Reason.BAD_CONFIG, "method fir_exponential without step_degc")
    return FirExponentialRate(
        parameters.step_degc, parameters.window_s, parameters.time_constant_s, parameters.buffer_size
    )


_METHODS: dict[str, Callable[[TemperatureRateParameters], RateMethod]] = {
    "level_bank": _level_bank,
    "fir_exponential": _fir_exponential,
}


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel.

    Parameters
    ----------
    channels : sequence of str
        Columns of the block to estimate, "temperature" or "temperature_x" and so on; what follows
        "temperature" is added to the names of the results.
    parameters : TemperatureRateParameters
        One set for all channels.

    Raises
    ------
    ImumonError
        BAD_CONFIG when a channel is not a temperature.
    """

    def __init__(
        self, channels: Sequence[str] = (CHANNEL,), parameters: TemperatureRateParameters | None = None
    ) -> None:
        for channel in channels:
            if channel != CHANNEL and not channel.startswith(f"{CHANNEL}_"):
                raise ImumonError(
                    Reason.BAD_CONFIG,
                    f"temperature rate of the column {channel!r}",
                    "only temperature, temperature_x and the like can be",
                )
        self._parameters = parameters or TemperatureRateParameters()
        self._methods = {name: _METHODS[self._parameters.method](self._parameters) for name in channels}
        declared = self._parameters.step_degc
        self._finders = {} if declared is None else {name: StepFinder(declared) for name in channels}

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return [column for channel in self._methods for column in _columns(channel)]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        added: dict[str, ColumnArray] = {}
        n = len(block)
        low, high = self._parameters.lowest_degc, self._parameters.highest_degc
        for channel, method in self._methods.items():
            reading = np.full(n, np.nan)
            if channel in block:
                given = block[channel]
                with np.errstate(invalid="ignore"):
                    inside = (given >= low) & (given <= high)
                reading[inside] = given[inside]
            if channel in self._finders:
                self._finders[channel].process(reading)
            result = method.process(block["device_time_ns"], block["segment"], reading)
            values = (result.temperature, result.rate, result.temperature_sd, result.rate_sd)
            for column, part in zip(_columns(channel), values, strict=True):
                added[column.name] = part
        return added

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the declared step; for the log."""
        texts = []
        for channel in list(self._finders):
            found = self._finders[channel].contradiction()
            if found is not None:
                texts.append(f"{channel}: step_degc contradicts the data: {found}")
                del self._finders[channel]
        return texts


def _columns(channel: str) -> list[Column]:
    suffix = channel.removeprefix(CHANNEL)
    of = f" of {channel}" if suffix else ""
    return [
        Column(f"temperature_estimate{suffix}", "degC", description=f"estimated temperature{of}"),
        Column(f"temperature_rate{suffix}", "degC/s", description=f"estimated rate{of}"),
        Column(f"temperature_estimate_sd{suffix}", "degC", description="its standard deviation"),
        Column(f"temperature_rate_sd{suffix}", "degC/s", description="its standard deviation"),
    ]
