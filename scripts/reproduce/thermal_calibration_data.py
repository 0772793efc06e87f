"""What the thermal calibration is tried on: the simulated soak, whose truth is known, and measured tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
from curve_slopes import curve_slope

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.calibration.cells import Channel, channel_of, group, levels
from imumon.lab.calibration.record import Record, read_session, record_of
from imumon.models.curves.points import Points
from imumon.recordings.importing import import_table
from imumon.recordings.reduced import GYRO
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.curves import curve_value

DEG_H = np.deg2rad(1.0) / 3600.0
"""1 °/h in rad/s."""
AXES = "xyz"
INSIDE = np.linspace(-20.53, 48.08, 1373)
"""Where curves are compared with the truth, every 0.05 °C."""
DWELLING_DEGC = 0.1
EVERY = 4
"""So many means on a level are one for the network: 75 of 300 on each show the same, in less time."""
_AT_ONCE = 200_000

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Soak:
    """The simulated soak in blocks of 10 s, and the truth at `INSIDE`, (n, 3) rad/s and rad/s/°C."""

    record: Record
    bias: FloatArray
    slope: FloatArray
    centers: FloatArray
    channels: list[Channel]

    def halfminutes(self, axis: int) -> Points:
        """Return means over 30 s of a gyro with their nearest level; every `EVERY`th of those on a level."""
        t = self.record.of(f"temperature_{AXES[axis]}").reshape(-1, 3).mean(axis=1)
        value = self.record.of(GYRO[axis]).reshape(-1, 3).mean(axis=1)
        level = np.argmin(np.abs(t[:, np.newaxis] - self.centers), axis=1)
        moving = np.abs(t - self.centers[level]) >= DWELLING_DEGC
        keep = moving | (np.arange(len(t)) % EVERY == 0)
        return Points(t, value, np.ones(len(t)), level).only(keep)

    def dwelling(self, points: Points) -> npt.NDArray[np.bool_]:
        """Return which of the points are on a level, not on the way between two."""
        return np.abs(points.temperature - self.centers[points.level]) < DWELLING_DEGC


def simulated_soak(seed: int, name: str = "crs05-soak") -> Soak:
    """Run a scenario of the soak; the truth is its curve plus the earth rate, which stays in it."""
    scenario = load_scenario(name)
    unit = SimulatedUnit(scenario, seed)
    earth: list[FloatArray] = []

    def blocks() -> Iterator[SampleBlock]:
        left = scenario.samples
        while left:
            block, truth = unit.run(min(left, _AT_ONCE))
            left -= len(block)
            earth.append(np.array([truth[f"rate_{axis}"][0] for axis in AXES]))
            yield block

    record = record_of(blocks(), name, "0" * 64, axes=scenario.axes)
    terms = [getattr(scenario.unit.gyro_bias_deg_per_s, axis) for axis in AXES]
    cells = group([record], None, None)
    centers = levels(cells)
    channels = [channel_of([record], cells, name, centers) for name in GYRO]
    return Soak(
        record=record,
        bias=np.deg2rad(np.column_stack([curve_value(term, INSIDE) for term in terms])) + earth[0],
        slope=np.deg2rad(np.column_stack([curve_slope(term, INSIDE) for term in terms])),
        centers=centers,
        channels=[channel for channel in channels if channel is not None],
    )


def chamber_cycle(data: Path, scratch: Path) -> Record:
    """Return the measured chamber cycle as `imumon import` and the pipeline give it."""
    folder = data / "chamber-cycle"
    import_table(folder / "cooling-heating.csv", folder / "map.yaml", scratch / "chamber-cycle")
    return read_session(scratch / "chamber-cycle")[0]


def during(record: Record, first: float, last: float) -> Record:
    """Return a record with only the blocks of a part of its time, as shares of the whole."""
    place = np.arange(len(record.means)) / len(record.means)
    return replace(record, rest=record.rest & (place >= first) & (place < last))
