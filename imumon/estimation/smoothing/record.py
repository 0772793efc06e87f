"""Samples and estimates of the forward run over short slots, and the same stages with time reversed.

Reversed in time, a rotation by ω is one by -ω: the rates change their sign, and so does the estimated bias.
Time counts from the end of each run, and the order of the runs is reversed.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.estimation.rest.slots import SENSORS
from imumon.filters.slots import SlotGatherer, Slots
from imumon.pipeline import Estimator

SLOT_NS = 31_250_000
"""Half of the shortest slot over which a stage integrates rotations."""
SUFFIXES = ("", "_x", "_y", "_z")
"""Of the columns of a thermometer: of the unit, and of the sensors of its axes."""
QUANTITIES = (
    *(("temperature_estimate", suffix) for suffix in SUFFIXES),
    *(("temperature_rate", suffix) for suffix in SUFFIXES),
    *(("gyro_bias", suffix) for suffix in SUFFIXES[1:]),
)
"""What is smoothed: a quantity, and the suffix of its columns."""
REVERSED = {"temperature_estimate": 1.0, "temperature_rate": -1.0, "gyro_bias": -1.0}
"""Sign of each quantity when time is reversed."""
THERMOMETERS = tuple(f"temperature{suffix}" for suffix in SUFFIXES)


def value_and_sd(quantity: str, suffix: str = "") -> tuple[str, str]:
    """Return the names of the columns of a quantity and of its standard deviation."""
    return f"{quantity}{suffix}", f"{quantity}_sd{suffix}"


NAMES = (
    *SENSORS,
    *THERMOMETERS,
    "at_rest",
    *(name for quantity in QUANTITIES for name in value_and_sd(*quantity)),
    *(f"gyro_random_error_{axis}" for axis in "xyz"),
    "attitude_estimate_heading",
    "heading",
)
"""Columns of a record."""


class Record(NamedTuple):
    """n slots of a recording, in order.

    `stop` (n,) is the row of the recording after the last of each slot, `run` (n,) the number of the segment,
    counted from restart to restart, and `middle_ns` (n,) the device time.  `columns` are means of the
    sensors, (n,) each; the last value of temperatures, rest and estimates.
    """

    stop: IntArray
    run: IntArray
    middle_ns: IntArray
    columns: dict[str, FloatArray]

    def vector(self, name: str) -> FloatArray:
        """Return the three axes of a column, (n, 3)."""
        return np.column_stack([self.columns[f"{name}_{axis}"] for axis in "xyz"])


class Recorder:
    """Averages the blocks of a run into slots; the result does not depend on the division into blocks."""

    def __init__(self) -> None:
        self._slots = SlotGatherer(len(NAMES), SLOT_NS)
        self._rows = 0
        self._parts: list[tuple[IntArray, BoolArray, IntArray, FloatArray]] = []

    def add(self, block: SampleBlock) -> None:
        """Take the next rows."""
        n = len(block)
        missing = np.full(n, np.nan)
        values = np.column_stack([block.columns.get(name, missing) for name in NAMES])
        time_ns = block.columns.get("device_time_ns", np.full(n, NO_INT))
        self._keep(self._slots.process(time_ns, block["segment"], values))
        self._rows += n

    def _keep(self, slots: Slots) -> None:
        """Keep copies: what the gatherer returns holds the memory of all its results."""
        values = np.hstack([slots.mean[:, : len(SENSORS)], slots.last[:, len(SENSORS) :]])
        self._parts.append((slots.row + self._rows, slots.begins, slots.middle_ns, values))

    def finish(self) -> Record:
        """Return the record of all rows."""
        self._keep(self._slots.finish())
        stop, begins, middle_ns, values = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        columns = np.ascontiguousarray(values.T)
        return Record(stop, np.cumsum(begins), middle_ns, dict(zip(NAMES, columns, strict=True)))


def backward(record: Record, temperature: Estimator, bias: Estimator) -> dict[str, FloatArray]:
    """Return temperature, its rate and the bias, with their sigmas, by what comes later, (n,) each.

    The stages are new.  That of the bias has no bias model: the modelled bias is subtracted from the rates
    here.
    """
    ends = np.flatnonzero(np.diff(record.run, append=-1))
    last_ns = record.middle_ns[ends][np.searchsorted(record.run[ends], record.run)]
    # The modelled bias: zero without a model, NaN while it is not known.
    model = record.vector("gyro_bias") - record.vector("gyro_random_error")
    modelled = (np.nan_to_num(model) != 0.0).any(0)
    model = np.where(np.isfinite(model) | modelled, model, 0.0)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": last_ns - record.middle_ns,
        "segment": record.run.max(initial=0) - record.run,
    }
    for j, axis in enumerate("xyz"):
        columns[f"gyro_{axis}"] = model[:, j] - record.columns[f"gyro_{axis}"]
    present = [name for name in THERMOMETERS if np.isfinite(record.columns[name]).any()]
    columns |= {name: record.columns[name] for name in (*SENSORS[3:], *present)}
    block = SampleBlock({name: np.ascontiguousarray(values[::-1]) for name, values in columns.items()})
    block = block.with_columns(temperature.process(block))
    block = block.with_columns(bias.process(block))
    found = {}
    for quantity, suffix in QUANTITIES:
        value, sd = value_and_sd(quantity, suffix)
        if value in block:
            found[value], found[sd] = REVERSED[quantity] * block[value][::-1], block[sd][::-1]
    for j, axis in enumerate("xyz"):
        found[f"gyro_bias_{axis}"] += model[:, j]
    return found
