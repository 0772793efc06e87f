"""Samples and estimates of the forward run as means over short slots: the input of the backward run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import NO_INT, FloatArray, IntArray, SampleBlock
from imumon.filters.slots import SlotGatherer, Slots
from imumon.filters.turns import mean_rates

SLOT_NS = 31_250_000
"""Half of the shortest slot over which a stage integrates rotations."""
SUFFIXES = ("", "_x", "_y", "_z")
"""Of the columns of a thermometer."""
READINGS = tuple(f"temperature{suffix}" for suffix in SUFFIXES)
SENSORS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
_THERMAL = ("temperature_estimate", "temperature_estimate_sd", "temperature_rate", "temperature_rate_sd")
_BIAS = ("gyro_bias", "gyro_bias_sd", "gyro_random_error")
NAMES = (
    *SENSORS,
    *READINGS,
    "at_rest",
    *(f"{name}{suffix}" for name in _THERMAL for suffix in SUFFIXES),
    *(f"{name}_{axis}" for name in _BIAS for axis in "xyz"),
    "attitude_estimate_heading",
    "heading",
    "heading_sd",
)


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """n slots of a recording, in order."""

    stop: IntArray
    """Row of the recording after the last of each slot, (n,)."""
    run: IntArray
    """Number of the segment, counted from restart to restart, (n,)."""
    middle_ns: IntArray
    """Device time, (n,)."""
    columns: dict[str, FloatArray]
    """Means of the sensors, (n,) each; the last value of temperatures, rest and estimates.  In motion the
    gyros have the constant rate whose rotation over the slot is that of the samples."""

    def vector(self, name: str) -> FloatArray:
        """Return the three axes of a column, (n, 3)."""
        return np.column_stack([self.columns[f"{name}_{axis}"] for axis in "xyz"])


class Recorder:
    """Averages the blocks of a run into slots; the result does not depend on the division into blocks."""

    def __init__(self) -> None:
        self._slots = SlotGatherer(len(NAMES), SLOT_NS, rates=0)
        self._rows = 0
        self._parts: list[tuple[IntArray, Slots]] = []

    def add(self, block: SampleBlock) -> None:
        """Take the next rows."""
        n = len(block)
        values = np.full((n, len(NAMES)), np.nan)
        for j, name in enumerate(NAMES):
            if name in block:
                values[:, j] = block[name]
        time_ns = block["device_time_ns"] if "device_time_ns" in block else np.full(n, NO_INT)
        slots = self._slots.process(time_ns, block["segment"], values)
        self._parts.append((slots.row + self._rows, slots))
        self._rows += n

    def finish(self) -> Record:
        """Return the record of all rows."""
        last = self._slots.finish()
        rows, parts = zip(*self._parts, (last.row + self._rows, last), strict=True)
        begins, middle_ns, final = (
            np.concatenate([getattr(slots, name) for slots in parts])
            for name in ("begins", "middle_ns", "last")
        )
        mean = np.concatenate([_means(slots) for slots in parts])
        columns = {
            name: np.ascontiguousarray((mean if name in SENSORS else final)[:, j])
            for j, name in enumerate(NAMES)
        }
        return Record(np.concatenate(rows), np.cumsum(begins), middle_ns, columns)


def _means(slots: Slots) -> FloatArray:
    """Return the means of slots, (m, columns); in motion, gyros as in `Record.columns`."""
    rate = mean_rates(slots.turns)
    use = np.isfinite(rate[:, 0]) & (slots.last[:, NAMES.index("at_rest")] != 1.0)
    mean = slots.mean.copy()
    mean[use, :3] = rate[use]
    return mean
