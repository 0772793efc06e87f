"""Slots of a quarter of a second, from which rest is detected, and measurements of the bias made of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.filters.slots import Slots
from imumon.filters.turns import PAUSE_INTERVALS, PAUSE_S, Turn

SLOT_S = 0.25
SENSORS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
AXES = len(SENSORS)
GYRO, ACCEL = slice(0, 3), slice(3, 6)
MODELLED, POWER_ON_SD, HEADING = (slice(AXES + 3 * i, AXES + 3 * i + 3) for i in range(3))
DEGC = slice(AXES + 9, AXES + 15)
REST_GIVEN, GATHERED = AXES + 15, AXES + 16
"""Columns that are gathered: gyros, rad/s; accelerometers, m/s²; what a model has added to the bias, rad/s;
sd of its unknown state at power-on, rad/s; a vector that turns with the heading (`heading_of`); temperature
of each gyro, °C, and its sd; 1 for given rest and 0 for given motion; and how many there are."""
COARSEST_STEPS = (0.035, 0.16)
"""rad/s (2 °/s) and m/s² (1/61 g), coarser than 8 bits for ±250 °/s and ±2 g: a larger rms change of readings
that rarely change is shaking, and no rounding."""


class Slot(NamedTuple):
    """A slot of samples; of what is missing the value is NaN.  Rates are in rad/s, forces in m/s²."""

    end_s: float  # since the first sample of its segment
    length_s: float  # from the end of the slot before, or of the gap before it, to its last sample
    covered_s: float  # by its samples at the shortest interval so far: less than the length if some are lost
    gap_s: float  # length of the gap before it; 0 without one
    samples: FloatArray  # number of samples of each of the six axes, (6,)
    mean: FloatArray  # of all columns that are gathered, (22,)
    variance: FloatArray  # of the samples of the six axes about the mean (n - 1), (rad/s)², (m/s²)², (6,)
    step: FloatArray  # of the sensor, (6,), if most readings are as the one before, but not all; else ∞
    turn: Turn
    rest_given: bool | None  # whether it was at rest throughout; None where that is to be detected


class Measurement(NamedTuple):
    """What the filters of the bias are updated with: means over about a quiet second."""

    end_s: float
    length_s: float
    covered_s: float  # by its samples: the variance of the mean rate is that of one second over this time
    rate: FloatArray  # less the thermal model and the known earth rate, rad/s, (3,)
    force: FloatArray  # m/s², (3,); the last known one where it is missing, zero before the first
    read: FloatArray  # temperature of each gyro and its sd, °C, (2, 3); NaN where missing, as is the heading
    heading: FloatArray  # a vector that turns with it (`heading_of`), (3,)
    rounding: FloatArray | float = 0.0  # largest error of the rate by rounding, rad/s, (3,)


@dataclass
class Timing:
    """Times of the slot before, s: its end, the interval of its samples, and the shortest interval so far."""

    origin_ns: int = 0
    end_s: float = 0.0
    interval_s: float = 0.0
    shortest_s: float = np.inf

    def slots(self, ended: Slots) -> Iterator[Slot]:
        """Yield slots that ended, one after the other; a first sample alone covers no time."""
        count = ended.count[:, :AXES].astype(np.float64)
        several = np.where(count > 1.0, count, np.nan)
        variance = ended.variance[:, :AXES] * several / (several - 1.0)
        # A step is the rms change of readings that rarely change.
        changes, pairs = ended.changes[:, :AXES], ended.step_count[:, :AXES]
        rare = (changes > 0) & (2 * changes <= pairs)
        steps = np.where(rare, np.sqrt(ended.step_squares[:, :AXES] / np.maximum(changes, 1)), np.inf)
        steps = np.where(steps <= np.repeat(COARSEST_STEPS, 3), steps, np.inf)
        for k, mean in enumerate(ended.mean):
            given = float(ended.smallest[k, REST_GIVEN])
            at_rest = None if np.isnan(given) else given == 1.0
            samples = int(ended.count[k, GYRO].max()) or int(ended.samples[k])
            first_ns, begins = int(ended.start_ns[k]), bool(ended.begins[k])
            if begins:
                self.origin_ns, self.end_s = first_ns, 0.0
                self.interval_s, self.shortest_s = 0.0, np.inf
            start, end = self.since_origin_s(first_ns), self.since_origin_s(int(ended.end_ns[k]))
            gap = 0.0 if begins else self.gap_s(start)
            if begins or gap:
                start -= (end - start) / (samples - 1) if samples > 1 else self.interval_s
            else:
                start = self.end_s
            length, covered, self.end_s = end - start, 0.0, end
            if length > 0.0:
                self.interval_s = length / samples
                if not (begins or gap):  # these may be what a buffer held, all at once
                    self.shortest_s = min(self.shortest_s, self.interval_s)
                covered = min(length, samples * self.shortest_s)
            sensors = count[k], mean, variance[k], steps[k]
            yield Slot(end, length, covered, gap, *sensors, ended.turns[k], at_rest)

    def since_origin_s(self, time_ns: int) -> float:
        """Return the seconds since the first sample of the segment."""
        return 1e-9 * (time_ns - self.origin_ns)

    def gap_s(self, start_s: float) -> float:
        """Return the length of the gap before a sample; 0 if it follows."""
        pause = start_s - self.end_s
        return pause if pause > max(PAUSE_S, PAUSE_INTERVALS * self.interval_s) and self.interval_s else 0.0


def heading_of(block: SampleBlock) -> FloatArray:
    """Return a vector that turns with the heading, (n, 3): the magnetic field in body axes, else cosine and
    sine of the yaw and zero, else NaN."""
    if block.mag is not None:
        return block.mag
    yaw = block.columns.get("yaw")
    if yaw is None:
        w, x, y, z = block.stacked([f"q_{part}" for part in "wxyz"]).T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])
