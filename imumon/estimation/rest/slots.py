"""Slots of a quarter of a second, from which rest is detected, and measurements of the bias made of them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.filters.slots import Slots
from imumon.filters.turns import PAUSE_INTERVALS, PAUSE_S, Turn

SLOT_S = 0.25  # of a slot; a slower sample is one by itself
# Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s².
SENSORS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
AXES = len(SENSORS)
GYRO, ACCEL = slice(0, 3), slice(3, 6)
# Columns that `RestAndBias.process` stacks and gathers: gyros, rad/s; accelerometers, m/s²; what a model has
# added to the bias, rad/s; sd of its unknown state at power-on, rad/s; `heading_of` the block; temperature of
# each gyro, °C, and its sd; 1 for given rest and 0 for given motion; and how many there are.
MODELLED, POWER_ON_SD, HEADING = (slice(AXES + 3 * i, AXES + 3 * i + 3) for i in range(3))
DEGC = slice(AXES + 9, AXES + 15)
REST_GIVEN, GATHERED = AXES + 15, AXES + 16
GYRO_SETS = 4  # the segment of a slot is that of the samples times this, plus how many gyros the unit lacks
# rad/s (2 °/s) and m/s² (1/61 g): above steps of 8 bits for ±250 °/s and ±2 g.  A larger change is motion.
COARSEST_STEPS = (0.035, 0.16)


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
    lacks_gyro: bool  # whether the unit lacks a gyro, which then reads zero
    rest_given: bool | None  # whether it was at rest throughout; None where that is to be detected


class Measurement(NamedTuple):
    """What the filters of the bias are updated with: means over about a quiet second."""

    end_s: float
    length_s: float
    covered_s: float  # by its samples: the variance of the mean rate is that of one second over this time
    rate: FloatArray  # less the thermal model and the known earth rate, rad/s, (3,)
    force: FloatArray  # m/s², (3,); the last known one where it is missing, zero before the first
    degc_and_sd: FloatArray  # temperature of each gyro, and its sd, °C, (2, 3); NaN where missing
    heading: FloatArray  # a vector that turns with it (`heading_of`), (3,); NaN where missing
    rounding_sd: FloatArray | float = 0.0  # of the rate, rad/s, (3,): see `QuietDetector.rounding_error`


@dataclass
class Timing:
    """What the times of a slot are reckoned from: end and interval of the one before, s, and the shortest."""

    origin_ns: int = 0
    end_s: float = 0.0
    interval_s: float = 0.0
    shortest_s: float = np.inf

    def make_slots(self, ended: Slots) -> Iterator[Slot]:
        """Yield slots that ended, one after the other; a first sample alone covers no time."""
        # Statistics of all slots at once; then the times, one after the other.
        count = ended.count[:, :AXES].astype(np.float64)
        several = np.where(count > 1.0, count, np.nan)
        variance = ended.variance[:, :AXES] * several / (several - 1.0)
        changes = ended.changes[:, :AXES]
        rms = np.sqrt(ended.step_squares[:, :AXES] / np.maximum(changes, 1))
        rare = (changes > 0) & (2 * changes <= ended.step_count[:, :AXES])
        step = np.where(rare & (rms <= np.repeat(COARSEST_STEPS, 3)), rms, np.inf)
        for k, mean in enumerate(ended.mean):
            samples = int(ended.count[k, GYRO].max()) or int(ended.samples[k])
            first_ns, begins = int(ended.start_ns[k]), ended.begins[k]
            if begins:
                self.origin_ns = first_ns
                self.end_s = self.interval_s = 0.0
                self.shortest_s = np.inf
            first_s = self.since_origin_s(first_ns)
            end_s = self.since_origin_s(int(ended.end_ns[k]))
            gap_s = 0.0 if begins else self.gap_s(first_s)
            if begins or gap_s:  # the first sample, too, covers an interval
                start_s = first_s - ((end_s - first_s) / (samples - 1) if samples > 1 else self.interval_s)
            else:
                start_s = self.end_s
            self.end_s = end_s
            length_s, covered_s = end_s - start_s, 0.0
            if length_s > 0.0:
                self.interval_s = length_s / samples
                if not (begins or gap_s):  # these may be what a buffer held, all at once
                    self.shortest_s = min(self.shortest_s, self.interval_s)
                covered_s = min(length_s, samples * self.shortest_s)
            sensors = count[k], mean, variance[k], step[k]
            lacks_gyro = bool(ended.segment[k] % GYRO_SETS)
            given = float(ended.smallest[k, REST_GIVEN])
            at_rest = None if np.isnan(given) else given == 1.0
            yield Slot(end_s, length_s, covered_s, gap_s, *sensors, ended.turns[k], lacks_gyro, at_rest)

    def since_origin_s(self, time_ns: int) -> float:
        """Return the seconds since the first sample of the segment."""
        return 1e-9 * (time_ns - self.origin_ns)

    def gap_s(self, start_s: float) -> float:
        """Return the length of the gap before a sample; 0 if it follows."""
        pause = start_s - self.end_s
        return pause if self.interval_s and pause > max(PAUSE_S, PAUSE_INTERVALS * self.interval_s) else 0.0


def heading_of(block: SampleBlock) -> FloatArray:
    """Return the magnetic field in body axes, else cosine and sine of the yaw and zero, else NaN, (n, 3)."""
    if block.mag is not None:
        return block.mag
    yaw = block.columns.get("yaw")
    if yaw is None:
        w, x, y, z = block.stacked([f"q_{part}" for part in "wxyz"]).T
        yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(len(block))])
