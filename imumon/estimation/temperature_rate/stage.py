"""Temperature rate as a stage of the pipeline: one estimator per temperature channel."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.temperature_rate.method import MultipleModelRate, StepWatch
from imumon.filters.rates import RateMethod
from imumon.protocols.thermometer import TemperatureRateParameters

CHANNEL = "temperature"
CHANNELS = (CHANNEL, *(f"{CHANNEL}_{axis}" for axis in "xyz"))


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel that comes.

    These are the columns "temperature" and "temperature_x" and so on; what follows "temperature" is added to
    the names of the results.

    Parameters
    ----------
    parameters : TemperatureRateParameters
        One set for all channels.
    new_method : callable, optional
        Makes the method of a channel; default the multiple-model filter.
    """

    def __init__(
        self,
        parameters: TemperatureRateParameters | None = None,
        new_method: Callable[[], RateMethod] | None = None,
    ) -> None:
        self._parameters = parameters or TemperatureRateParameters()
        self._new_method = new_method or partial(MultipleModelRate, self._parameters.step_degc)
        self._methods: dict[str, RateMethod] = {}
        self._begun: set[str] = set()
        self._watches: dict[str, StepWatch] = {}
        self._stuck: set[str] = set()
        self._outside: dict[str, float] = {}
        """What of each channel was first out of range, until it is reported; then NaN."""

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds so far."""
        return [column for channel in self._methods for column in _columns(channel)]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        for channel in CHANNELS:
            if channel in block and channel not in self._methods:
                self._methods[channel] = self._new_method()
                if self._parameters.step_degc is not None:
                    self._watches[channel] = StepWatch(self._parameters.step_degc)
        added: dict[str, ColumnArray] = {}
        for channel in self._methods:
            for column, part in zip(_columns(channel), self._estimate(channel, block), strict=True):
                added[column.name] = part
        return added

    def _estimate(self, channel: str, block: SampleBlock) -> Sequence[FloatArray]:
        """Return temperature, rate and their standard deviations, (n,) each.

        Rows before the first reading are kept from the method: there may have been no column for them, and
        what follows must not depend on that.
        """
        reading = self._reading(channel, block)
        first = 0
        if channel not in self._begun:
            valid = np.flatnonzero(np.isfinite(reading))
            if not len(valid):
                return [np.full(len(block), np.nan) for _ in range(4)]
            first = int(valid[0])
            self._begun.add(channel)
        time_ns, segment = block["device_time_ns"][first:], block["segment"][first:]
        if channel in self._watches:
            self._watches[channel].process(time_ns, segment, reading[first:])
        result = self._methods[channel].process(time_ns, segment, reading[first:])
        parts = (result.temperature, result.rate, result.temperature_sd, result.rate_sd)
        return [np.concatenate([np.full(first, np.nan), part]) for part in parts] if first else parts

    def _reading(self, channel: str, block: SampleBlock) -> FloatArray:
        """Return the readings, NaN where there is none or it is out of range."""
        reading = np.full(len(block), np.nan)
        if channel in block:
            given = block[channel]
            with np.errstate(invalid="ignore"):
                inside = (given >= self._parameters.lowest_degc) & (given <= self._parameters.highest_degc)
            reading[inside] = given[inside]
            if channel not in self._outside and (outside := given[np.isfinite(given) & ~inside]).size:
                self._outside[channel] = float(outside[0])
        return reading

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the declared step and with the readings; for the log."""
        texts = []
        for channel, value in self._outside.items():
            if not math.isnan(value):
                low, high = self._parameters.lowest_degc, self._parameters.highest_degc
                texts.append(
                    f"{channel}: {value:g} °C is left out, as all beyond {low:g} to {high:g} (lowest_degc, "
                    "highest_degc): is its unit right?"
                )
                self._outside[channel] = math.nan
        for channel, method in self._methods.items():
            if (
                isinstance(method, MultipleModelRate)
                and method.stuck is not None
                and channel not in self._stuck
            ):
                self._stuck.add(channel)
                texts.append(
                    f"{channel}: it leapt to {method.stuck:g} °C, as no temperature does, and stuck there: "
                    "taken for a fault of the thermometer until it changes"
                )
        for channel in list(self._watches):
            found = self._watches[channel].finder.contradiction()
            if found is not None:
                texts.append(f"{channel}: step_degc contradicts the data: {found}")
                del self._watches[channel]
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
