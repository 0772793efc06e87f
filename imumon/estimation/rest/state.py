"""What the rest detector remembers, by name: the noise at rest, the latest slots, and the last rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from imumon.blocks import BoolArray, FloatArray
from imumon.compiled import records
from imumon.estimation.rest.thermometer import EFFECTS, LAG_S, effects

SLOT_S = 0.125
AXES = 6
"""Gyro x, y, z in rad/s, then accelerometer x, y, z in m/s²."""
GYRO, ACCEL = slice(0, 3), slice(3, 6)
LEVELS = 8
"""Windows of 1, 2, 4 ... 128 slots are compared with their predecessors."""
EVERY = 8
"""Slots in a unit of the history of a rest."""
KEPT = 9 << (LEVELS - 1)
"""Slots that are remembered: 144 s, in which the compass sees a turn of 0.3 °/s."""
CAPACITY = 2 * KEPT
MOST_UNITS = 4096

COARSEST_STEPS = (0.035, 0.16)
"""No gyro (rad/s) and no accelerometer (m/s²) reads in coarser steps: 2 °/s is what may shake at rest."""

DITHER = 2.0 * np.pi**2
"""Noise of variance v lets a mean err by exp(-DITHER v) steps of the sensor, v in steps squared (Widrow)."""
ROUNDED = 1.0 / 12.0
"""Variance of what rounding adds, in steps squared."""


class Slot:
    """One slot of samples of the six axes; a record, arrays are (6,)."""

    start_s: float
    end_s: float
    """Time of its first sample and of the first behind it, s."""
    samples: FloatArray
    average: FloatArray
    within: FloatArray
    """Finite samples, their mean, and their variance about it (n - 1; NaN for a single one)."""
    jumps: FloatArray
    """Half the mean square of the steps from sample to sample: the variance, if the noise is white; NaN
    without any."""
    smallest: FloatArray
    largest: FloatArray
    first: FloatArray
    last: FloatArray
    """Of the finite samples; NaN without any."""
    reference: FloatArray
    """Mean of what turns with the heading (`compass`), (3,); NaN without any."""
    degc: float
    """Temperature, °C; NaN without any."""


_ARRAYS = ("samples", "average", "within", "jumps", "smallest", "largest", "first", "last")
_ONE: Any = records(Slot, 1, **dict.fromkeys(_ARRAYS, AXES), reference=3)


def empty_slots(count: int) -> Sequence[Slot]:
    """Return so many slots to be filled in."""
    made: Any = np.zeros(count, _ONE.dtype)
    return cast(Sequence[Slot], made)


class Windows(NamedTuple):
    """The latest slots, oldest first, and the noise at rest that windows of them had; filled in place.

    The mean of any window is a difference of running sums (`means`).
    """

    total: FloatArray
    samples: FloatArray
    """Sum and number of the samples of all slots before each, (CAPACITY + 1, 6)."""
    seconds: FloatArray
    """Seconds of all slots before each, (CAPACITY + 1,)."""
    average: FloatArray
    within: FloatArray
    jumps: FloatArray
    """Of each slot, (CAPACITY, 6)."""
    reference: FloatArray
    """The same of what turns with the heading, (CAPACITY, 3)."""
    degc: FloatArray
    """Temperature, °C, the last that was known, (CAPACITY,); NaN before there was one."""
    known: BoolArray
    """Axes whose noise at rest is known, (6,)."""
    sample_variance: FloatArray
    """Variance of a sample at rest, (6,)."""
    quietest: FloatArray
    """As little as its least value allows, for what it leaves of the steps (`windows.QUIETER`), (6,)."""
    variance: FloatArray
    gain: FloatArray
    """Variance of the mean of a window at rest, and the share of the next window in it, (LEVELS, 6)."""
    step: FloatArray
    """Least difference of two readings that was seen, (6,)."""
    resolution: FloatArray
    """What is left of the step after this noise, (6,); 0 until the noise is known."""
    last: FloatArray
    """Last reading, (6,)."""
    rest_mean: FloatArray
    """Mean at rest, while there is rest, (6,)."""
    low: FloatArray
    high: FloatArray
    """Band of single readings of a unit at rest, (6,)."""
    recent: FloatArray
    """Means that are being compared, (3, 6): the latest window and the two before it."""


def new_windows() -> Windows:
    """Return windows of which nothing is known."""
    return Windows(
        total=np.zeros((CAPACITY + 1, AXES)),
        samples=np.zeros((CAPACITY + 1, AXES)),
        seconds=np.zeros(CAPACITY + 1),
        average=np.zeros((CAPACITY, AXES)),
        within=np.zeros((CAPACITY, AXES)),
        jumps=np.zeros((CAPACITY, AXES)),
        reference=np.zeros((CAPACITY, 3)),
        degc=np.full(CAPACITY, np.nan),
        known=np.zeros(AXES, np.bool_),
        sample_variance=np.zeros(AXES),
        quietest=np.zeros(AXES),
        variance=np.zeros((LEVELS, AXES)),
        gain=np.zeros((LEVELS, AXES)),
        step=np.repeat(COARSEST_STEPS, 3),
        resolution=np.zeros(AXES),
        last=np.full(AXES, np.nan),
        rest_mean=np.zeros(AXES),
        low=np.zeros(AXES),
        high=np.zeros(AXES),
        recent=np.zeros((3, AXES)),
    )


@dataclass
class Past:
    """History of a rest in units of `EVERY` slots, for `wander`; running sums as in `Windows`."""

    units: int = 0
    total: FloatArray = field(default_factory=lambda: np.zeros((MOST_UNITS + 1, AXES)))
    samples: FloatArray = field(default_factory=lambda: np.zeros((MOST_UNITS + 1, AXES)))
    """Sum and number of the samples before each, (MOST_UNITS + 1, 6)."""
    warmth: FloatArray = field(default_factory=lambda: np.zeros((MOST_UNITS + 1, EFFECTS)))
    """Sum of the `thermometer.effects` before each, °C, from the temperature at first, (MOST_UNITS + 1,
    EFFECTS); zero where there is no thermometer."""
    first_degc: float = np.nan
    lagged: float = 0.0
    """Temperature at first, °C, and how far one that is behind it has come since."""
    seconds: float = 0.0
    """Length of all."""

    def add(self, windows: Windows, length: int) -> None:
        """Take the latest slots; a full history forgets its older half, and without gyros it begins anew."""
        first = length - EVERY
        if (windows.samples[length, GYRO] == windows.samples[first, GYRO]).any():
            self.forget()
            return
        if self.units == MOST_UNITS:
            kept = MOST_UNITS // 2
            for sums in (self.total, self.samples, self.warmth):
                sums[: kept + 1] = sums[kept:] - sums[kept]
            self.units, self.seconds = kept, 0.5 * self.seconds
        k = self.units
        self.total[k + 1] = self.total[k] + windows.total[length] - windows.total[first]
        self.samples[k + 1] = self.samples[k] + windows.samples[length] - windows.samples[first]
        degc = float(windows.degc[length - 1])
        self.first_degc = degc if np.isnan(self.first_degc) else self.first_degc
        seconds = float(windows.seconds[length] - windows.seconds[first])
        self.warmth[k + 1] = self.warmth[k]
        if not np.isnan(degc):
            self.lagged += (1.0 - math.exp(-seconds / LAG_S)) * (degc - self.first_degc - self.lagged)
            self.warmth[k + 1] += effects(degc - self.first_degc, self.lagged)
        self.seconds += seconds
        self.units += 1

    @property
    def unit_s(self) -> float:
        """Length of a unit, s."""
        return self.seconds / self.units

    def forget(self) -> None:
        """Begin anew."""
        self.units, self.seconds, self.first_degc, self.lagged = 0, 0.0, np.nan, 0.0

    def means(self, ages: npt.NDArray[np.intp]) -> FloatArray:
        """Return the means between neighbouring ages, units that rise, (k, 6) for (k + 1,)."""
        total, samples = self.total[self.units - ages], self.samples[self.units - ages]
        return np.asarray((total[:-1] - total[1:]) / (samples[:-1] - samples[1:]))

    def warmed(self, ages: npt.NDArray[np.intp]) -> FloatArray:
        """Return the mean effects of temperature between the same ages, °C, (k, EFFECTS)."""
        warmth = self.warmth[self.units - ages]
        return np.asarray((warmth[:-1] - warmth[1:]) / np.diff(ages)[:, np.newaxis])


class Anchor(NamedTuple):
    """Mean of an earlier rest and its variance, (6,) each, its end, s, what turn it may be, (3,), and °C."""

    mean: FloatArray
    variance: FloatArray
    at_s: float
    turn: FloatArray
    degc: float

    def turn_now(self, mean: FloatArray) -> FloatArray:
        """Return the turn that a mean, (6,), is if the bias has not changed since, (3,)."""
        change = mean - self.mean
        return np.where(np.isfinite(change), change, 0.0)[GYRO] + self.turn


@dataclass
class Spells:
    """Steady means in motion that gave way to others, so that they were no rest, and the latest."""

    count: int = 0
    seconds: float = 0.0
    """How long they lasted altogether."""
    since_s: float | None = None
    """Since when the latest has been."""

    def end(self, now_s: float) -> None:
        """Say that the latest gives way."""
        if self.since_s is not None:
            self.count, self.seconds, self.since_s = self.count + 1, self.seconds + now_s - self.since_s, None


@dataclass
class State:
    """All that is carried from slot to slot; arrays are (6,) unless another shape is given."""

    windows: Windows = field(default_factory=new_windows)
    length: int = 0
    """Slots in them."""
    quiet_from: int = 0
    ring_from: int = 0
    """Places where the windows, and the slots of a trial, may begin."""
    at_rest: bool = False
    quiet_since_s: float = -np.inf
    """When the last sign of motion was."""
    hold_s: float = -np.inf
    long_hold_s: float = -np.inf
    """Times before which there is no rest again; the latter for a trial."""
    slots: int = 0
    """Slots since the beginning."""
    past: Past = field(default_factory=Past)
    """History of this rest."""
    strengths: FloatArray = field(default_factory=lambda: np.zeros(14))
    strengths_seen: FloatArray = field(default_factory=lambda: np.zeros(14))
    """Log-likelihoods of the noises that are tried (`wander`) before this history, and with it, (14,)."""
    unseen: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rms of a turn that nobody knows of, rad/s, (3,): it may have begun in this rest."""
    unseen_age: float = 0.0
    """How long ago it did, units of the history."""
    anchors: list[Anchor] = field(default_factory=list)
    """Means of earlier rests that differ, the latest first."""
    undecided_since_s: float = np.nan
    """Since when a mean has been steady that differs from the anchors; NaN when none has."""
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rate, rad/s, by which the gyros differ from the latest anchor while nothing tells a turn from a
    bias, (3,)."""
    chance: float = 1.0
    """Probability that the bias is off by as much: at rest, that it is a turn, and in motion, that it is
    none."""
    spells: Spells = field(default_factory=Spells)
    """Of this motion."""
    begun: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Rms of the turn in which the recording may have begun, rad/s, (3,)."""
    shown: FloatArray = field(default_factory=lambda: np.zeros(3))
    """`undecided` when something was last decided, (3,)."""
    steady: FloatArray = field(default_factory=lambda: np.full(AXES, np.nan))
    """Mean of a turn, when it was last undisturbed, at `steady_s`; NaN without any."""
    steady_s: float = 0.0
    rest_since_s: float = -np.inf
    """When the last rest was found."""
    caution: float = 1.0
    """Factor of the time for which motion that is no longer seen is watched for."""
    slow: bool = False
    turning: bool = False
    shaken: bool = False
    """Whether the last rest ended so slowly that its end was hard to see, whether a steady turn has been
    the hypothesis since, and whether what moved since was more than a steady turn."""

    @property
    def quiet_slots(self) -> int:
        """Slots since the last sign of motion."""
        return self.length - self.quiet_from

    @property
    def undecided(self) -> FloatArray:
        """What may be a turn, and may be bias, rad/s, (3,): from before this rest, or since.

        So may half of what the noise leaves of a gyro's step, for its readings are the same with and without.
        """
        likely = [math.sqrt(self.chance) * self.turn, self.unseen, self.begun]
        turn = max(likely, key=lambda one: float(one @ one))
        return np.asarray(np.copysign(np.hypot(turn, 0.5 * self.windows.resolution[GYRO]), turn))

    def show(self) -> None:
        """Let what is undecided now be shown until something is decided again."""
        self.shown = self.undecided

    def means(self, cuts: npt.NDArray[np.intp]) -> FloatArray:
        """Return the means between neighbouring cuts, (..., k, 6) for (..., k + 1).

        The cuts are numbers of slots and fall; NaN where a window is empty.
        """
        total, samples = self.windows.total[cuts], self.windows.samples[cuts]
        difference = total[..., :-1, :] - total[..., 1:, :]
        return np.asarray(difference / (samples[..., :-1, :] - samples[..., 1:, :]))

    def latest(self, slots: int) -> tuple[FloatArray, FloatArray]:
        """Return mean and number of the samples of the latest slots, (6,) each; NaN without any."""
        n, total, samples = self.length, self.windows.total, self.windows.samples
        count = samples[n] - samples[n - slots]
        return (total[n] - total[n - slots]) / count, count

    def span_s(self, slots: int) -> float:
        """Return how long the latest slots took."""
        seconds = self.windows.seconds
        return float(seconds[self.length] - seconds[self.length - slots])

    @property
    def degc(self) -> float:
        """Temperature now, °C; NaN where it has never been known."""
        return float(self.windows.degc[self.length - 1])

    @property
    def slot_s(self) -> float:
        """Length of a slot, of late: at low rates that of a sample."""
        slots = min(self.length, 32)
        return self.span_s(slots) / slots if slots else SLOT_S

    def make_room(self) -> None:
        """Forget the oldest slots when there is no place left."""
        if self.length < CAPACITY:
            return
        moved, windows = CAPACITY - KEPT, self.windows
        for sums in (windows.total, windows.samples, windows.seconds):
            sums[: KEPT + 1] = sums[moved:] - sums[moved]
        for values in (windows.average, windows.within, windows.jumps, windows.reference, windows.degc):
            values[:KEPT] = values[moved:]
        self.length = KEPT
        self.quiet_from, self.ring_from = max(self.quiet_from - moved, 0), max(self.ring_from - moved, 0)
