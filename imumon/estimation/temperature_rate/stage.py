"""Temperature rate as a stage of the pipeline: channels, ranges, notices."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.estimation.temperature_rate.thermometer import StepFinder
from imumon.filters.rates import RateMethod
from imumon.protocols.thermometer import TemperatureRateParameters

CHANNELS = ("temperature", *(f"temperature_{axis}" for axis in "xyz"))


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
        self._last: dict[str, float] = {}
        """Last reading of each channel that has had one, °C."""
        self._finders: dict[str, StepFinder] = {}
        """The steps that each channel shows, as long as they may contradict the declared one."""
        self._notices: list[str] = []
        self._noticed: set[tuple[str, str]] = set()

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
                self._finders[channel] = StepFinder()
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
        valid = np.flatnonzero(np.isfinite(reading))
        first = 0 if channel in self._last else int(valid[0]) if len(valid) else len(block)
        if len(valid):
            self._compare_step(channel, reading[valid])
            self._last[channel] = float(reading[valid[-1]])
        method = self._methods[channel]
        result = method.process(block["device_time_ns"][first:], block["segment"][first:], reading[first:])
        if isinstance(method, MultipleModelRate) and math.isfinite(method.stuck_degc):
            text = f"it leapt to {method.stuck_degc:g} °C, as no temperature does, and stuck there: "
            self._notice(channel, "stuck", text + "taken for a fault of the thermometer until it changes")
        estimates = np.full((4, len(block)), np.nan)
        estimates[:, first:] = result.temperature, result.rate, result.temperature_sd, result.rate_sd
        return [*estimates]

    def _reading(self, channel: str, block: SampleBlock) -> FloatArray:
        """Return the readings, NaN where there is none or it is out of range."""
        given = block[channel] if channel in block else np.full(len(block), np.nan)
        low, high = self._parameters.lowest_degc, self._parameters.highest_degc
        with np.errstate(invalid="ignore"):
            inside = (given >= low) & (given <= high)
        if (outside := given[np.isfinite(given) & ~inside]).size:
            text = f"{outside[0]:g} °C is left out, as all beyond {low:g} to {high:g} (lowest_degc, "
            self._notice(channel, "outside", text + "highest_degc): is its unit right?")
        return np.where(inside, given, np.nan)

    def _compare_step(self, channel: str, reading: FloatArray) -> None:
        """Compare the declared step with what the changes of valid readings show, until they show it."""
        declared, finder = self._parameters.step_degc, self._finders[channel]
        if declared is None or finder.changes >= 1000:
            return
        changes = np.abs(np.diff(reading, prepend=self._last.get(channel, reading[0])))
        for change in changes[changes > 0.0].tolist():
            finder.learn(change)
        if (found := finder.contradiction(declared)) is not None:
            self._notice(channel, "step", f"step_degc contradicts the data: {found}")

    def _notice(self, channel: str, what: str, text: str) -> None:
        """Add a notice, once for each channel and kind."""
        if (channel, what) not in self._noticed:
            self._noticed.add((channel, what))
            self._notices.append(f"{channel}: {text}")

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the declared step and with the readings; for the log."""
        notices, self._notices = self._notices, []
        return notices


def _columns(channel: str) -> list[Column]:
    suffix = channel.removeprefix("temperature")
    of = f" of {channel}" if suffix else ""
    return [
        Column(f"temperature_estimate{suffix}", "degC", description=f"estimated temperature{of}"),
        Column(f"temperature_rate{suffix}", "degC/s", description=f"estimated rate{of}"),
        Column(f"temperature_estimate_sd{suffix}", "degC", description="its standard deviation"),
        Column(f"temperature_rate_sd{suffix}", "degC/s", description="its standard deviation"),
    ]
