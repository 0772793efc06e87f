"""Temperature rate as a stage of the pipeline: channels and notices."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import TEMPERATURES, Column
from imumon.estimation.temperature_rate.method import MultipleModelRate, RateMethod
from imumon.protocols.thermometer import TemperatureRateParameters


class TemperatureRate:
    """Temperature, its rate, and the standard deviation of both for each temperature channel that comes.

    These are the columns "temperature" and "temperature_x" and so on; what follows "temperature" is added to
    the names of the results.  `new_method` makes the method of a channel, the multiple-model filter.
    """

    prefix, title = "", "estimated"
    """Of the names and of the descriptions of the results."""

    def __init__(
        self,
        parameters: TemperatureRateParameters | None = None,
        new_method: Callable[[], RateMethod] | None = None,
    ) -> None:
        given = parameters or TemperatureRateParameters()
        self._new_method = new_method or partial(MultipleModelRate, given.step_degc)
        self._methods: dict[str, RateMethod | None] = {}
        """Of each channel; None until its first reading."""
        self._notices = {f"temperature: {name} is not used any more": False for name in given.retired}
        """Lines for the log, and whether `notices` has returned them."""

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds so far."""
        found = []
        for name in self._methods:
            suffix = name.removeprefix("temperature")
            of, sd = (f" of {name}" if suffix else ""), "its standard deviation"
            for result, unit, text in (
                ("estimate", "degC", f"{self.title} temperature{of}"),
                ("rate", "degC/s", f"{self.title} rate{of}"),
                ("estimate_sd", "degC", sd),
                ("rate_sd", "degC/s", sd),
            ):
                column = f"{self.prefix}temperature_{result}{suffix}"
                found.append(Column(column, unit, description=text))
        return found

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; a channel that is not in the block is missing throughout.
        """
        self._methods |= {name: self._methods.get(name) for name in TEMPERATURES if name in block}
        values = [each for name in self._methods for each in self._estimate(name, block)]
        return {column.name: each for column, each in zip(self.columns, values, strict=True)}

    def _estimate(self, name: str, block: SampleBlock) -> FloatArray:
        """Return temperature, rate and their standard deviations, (4, n).

        Rows before the first reading are kept from the method: there may have been no column for them, and
        what follows must not depend on that.
        """
        estimates = np.full((4, len(block)), np.nan)
        reading, first = block.columns.get(name, estimates[0]), 0
        method = self._methods[name]
        if method is None:
            known = np.flatnonzero(np.isfinite(reading))
            if not len(known):
                return estimates
            first, method = int(known[0]), self._new_method()
            self._methods[name] = method
        new = (values[first:] for values in (block["device_time_ns"], block["segment"], reading))
        estimates[:, first:] = method.process(*new)
        if isinstance(method, MultipleModelRate) and math.isfinite(method.stuck_degc):
            text = f"{name}: it leapt to {method.stuck_degc:g} °C, as no temperature does, and stuck there: "
            self._notices.setdefault(text + "taken for a fault of the thermometer until it changes", False)
        return estimates

    def notices(self) -> list[str]:
        """Return, once each, what is wrong with the readings; for the log."""
        texts = [text for text, returned in self._notices.items() if not returned]
        self._notices.update(dict.fromkeys(texts, True))
        return texts
