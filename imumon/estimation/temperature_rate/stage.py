"""Temperature rate as a stage of the pipeline: channels, ranges, notices."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import TEMPERATURES, Column
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.filters.rates import RateMethod
from imumon.protocols.thermometer import TemperatureRateParameters


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel that comes.

    These are the columns "temperature" and "temperature_x" and so on; what follows "temperature" is added to
    the names of the results.  `new_method` makes the method of a channel, the multiple-model filter.
    """

    def __init__(
        self,
        parameters: TemperatureRateParameters | None = None,
        new_method: Callable[[], RateMethod] | None = None,
    ) -> None:
        self._parameters = parameters or TemperatureRateParameters()
        self._new_method = new_method or partial(MultipleModelRate, self._parameters.step_degc)
        self._channels: dict[str, _Channel] = {}
        self._notices: dict[tuple[str, str], str] = {}
        """One for each channel and kind."""
        self._reported = 0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds so far."""
        return [column for name in self._channels for column in _columns(name)]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        for name in TEMPERATURES:
            if name in block and name not in self._channels:
                self._channels[name] = _Channel(self._new_method())
        estimates = [self._estimate(name, channel, block) for name, channel in self._channels.items()]
        values = [column for estimate in estimates for column in estimate]
        return {column.name: each for column, each in zip(self.columns, values, strict=True)}

    def _estimate(self, name: str, channel: _Channel, block: SampleBlock) -> FloatArray:
        """Return temperature, rate and their standard deviations, (4, n).

        Rows before the first reading are kept from the method: there may have been no column for them, and
        what follows must not depend on that.
        """
        reading = self._reading(name, block)
        begun = np.logical_or.accumulate(np.isfinite(reading)) | channel.begun
        channel.begun |= bool(begun[-1:].any())
        method = channel.method
        found = method.process(block["device_time_ns"][begun], block["segment"][begun], reading[begun])
        if isinstance(method, MultipleModelRate) and np.isfinite(method.stuck_degc):
            text = f"it leapt to {method.stuck_degc:g} °C, as no temperature does, and stuck there: "
            self._notice(name, "stuck", text + "taken for a fault of the thermometer until it changes")
        estimates = np.full((4, len(block)), np.nan)
        estimates[:, begun] = found.temperature, found.rate, found.temperature_sd, found.rate_sd
        return estimates

    def _reading(self, name: str, block: SampleBlock) -> FloatArray:
        """Return the readings, NaN where there is none or it is out of range."""
        given = block[name] if name in block else np.full(len(block), np.nan)
        low, high = self._parameters.lowest_degc, self._parameters.highest_degc
        inside = (given >= low) & (given <= high)
        if (outside := given[np.isfinite(given) & ~inside]).size:
            text = f"{outside[0]:g} °C is left out, as all beyond {low:g} to {high:g} (lowest_degc, "
            self._notice(name, "outside", text + "highest_degc): is its unit right?")
        return np.where(inside, given, np.nan)

    def _notice(self, name: str, kind: str, text: str) -> None:
        self._notices.setdefault((name, kind), f"{name}: {text}")

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the readings; for the log."""
        new = [*self._notices.values()][self._reported :]
        self._reported += len(new)
        return new


@dataclass(slots=True)
class _Channel:
    """The method of a channel, and whether there was a reading."""

    method: RateMethod
    begun: bool = False


def _columns(channel: str) -> list[Column]:
    suffix = channel.removeprefix("temperature")
    of = f" of {channel}" if suffix else ""
    return [
        Column(f"temperature_estimate{suffix}", "degC", description=f"estimated temperature{of}"),
        Column(f"temperature_rate{suffix}", "degC/s", description=f"estimated rate{of}"),
        Column(f"temperature_estimate_sd{suffix}", "degC", description="its standard deviation"),
        Column(f"temperature_rate_sd{suffix}", "degC/s", description="its standard deviation"),
    ]
