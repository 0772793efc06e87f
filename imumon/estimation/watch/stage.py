"""The watch over the bias filter as a stage of the pipeline: sequential tests of normalised innovations.

When the filter is right, an innovation over its standard deviation, v, is standard normal whatever came
before.  So for every regressor r that is known before v the factor::

    e = exp(theta r v - |theta r| tolerance - theta² r² kappa / 2)                  (1)

has an expectation of at most one, given the past, as long as the mean of v is within tolerance of zero
and its variance within kappa.  A CUSUM of log e, max(0, m) + log e, is below the logarithm of the
Shiryaev-Roberts sum, which less the number of steps is a supermartingale: the mean number of steps until m
exceeds log A is A at least.  Of K such tests the limit log(K A) keeps that mean.  See Pollak 1985 for the
sum, Shin, Ramdas and Rinaldo 2023 ("E-detectors") for tests under a composite hypothesis.  The variance of v
has tests of its own, with::

    e = exp(lambda v²) sqrt(1 - 2 lambda kappa)                                     (2)
"""

import math
from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np
from pydantic import Field

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.config import StrictModel
from imumon.effects.library import suspected_by
from imumon.lane import LaneState, Level

EXPLAINING_SHARE = 0.7
"""A pattern explains the innovations with at least this share of the strongest evidence.  Assumed."""
SLOT_S, BLOCK = 1.0, 10  # length of a slot at rest, s, and how many make a step of the tests
LEARNING = 20  # slots after a start that do not count: the filter is still estimating the noise.  Assumed.
CLIP = 4.0
"""An innovation counts as no more than this many standard deviations: a knock is no effect.  Assumed."""
TOLERANCE, KAPPA = 0.03, 1.1
"""Mean and variance of an innovation that are still as the filter expects.  Assumed."""
THETAS = (0.12, 0.35, 1.0, -0.12, -0.35, -1.0)
"""Means that are tested for, per unit of a regressor; the best is at most 1.7 times off in between."""
LAMBDAS = np.array([0.1, 0.3])  # of (2): best for variances of 1.4 and 3


class WatchParameters(StrictModel):
    """How rare false alarms are.

    Parameters
    ----------
    false_alarm_hours : float
        Least mean time at rest, h, until a false alarm, while the filter is right.
    learn : bool
        Whether a better model, once found, runs beside the present one until its predictions are better.
    """

    false_alarm_hours: float = Field(default=24.0, ge=0.1, le=1e5)
    learn: bool = False


class Pattern(StrEnum):
    """What innovations that are not white may follow; effects name it in `suspected_by`."""

    TEMPERATURE = "temperature"
    RATE = "temperature rate"
    TIME = "time since start"
    AUTOCORRELATION = "follow each other"
    VARIANCE = "exceed their standard deviation"


DRIVERS = (Pattern.TEMPERATURE, Pattern.RATE, Pattern.TIME)
"""Of a bias; the other patterns are of the innovations themselves."""
REGRESSORS = (
    Pattern.TEMPERATURE, Pattern.RATE, Pattern.RATE, Pattern.TIME, Pattern.TIME,
    Pattern.AUTOCORRELATION, Pattern.AUTOCORRELATION,
)  # fmt: skip
"""r: the temperature and twice its rate behind high-passes, `DECAYS_S`, and past innovations, `KEPT`."""
HIGH_PASS_S = np.array([300.0, math.inf, 100.0])
LEAST_CHANGE = np.array([0.2, 0.003, 0.003])
"""Time constants of the high-passes, s (infinite: none), and the least changes that are no noise of the
thermometer, and so the least scale, °C and °C/s."""
SCALE_S = 3600.0
"""These regressors are in units of their largest value, which is forgotten within about an hour."""
DECAYS_S = np.array([math.inf, 600.0])  # a constant and a warm-up: their time constants
KEPT = np.array([0.0, math.exp(-SLOT_S / 10.0)])
"""What a slot leaves of the means of earlier innovations: the last one, and those of about 10 s."""
PAST_SCALE = 3.0 * np.sqrt((1.0 - KEPT) / (1.0 + KEPT))  # three of their standard deviations

THETA = np.tile(THETAS, (len(REGRESSORS), 1))
THETA[-len(KEPT) :] = np.maximum(THETA[-len(KEPT) :], 0.0)
"""Of each test of (1); a negative correlation with the past is no fault: the filter's sigma is too large."""
PATTERNS = np.append(np.repeat(REGRESSORS, len(THETAS)), [Pattern.VARIANCE] * len(LAMBDAS))
"""Of each test, those of (1) and then those of (2), (t,)."""


class State:
    """All that is carried from slot to slot, by axis."""

    def __init__(self, segment: int = NO_INT, first_ns: int = 0) -> None:
        self.low = np.full((3, len(HIGH_PASS_S)), np.nan)  # low-passes of temperature and rate, °C and °C/s
        self.scale = np.tile(LEAST_CHANGE, (3, 1))  # their largest high-passed values
        self.past = np.zeros((3, len(KEPT)))  # means of earlier innovations
        self.gain, self.cusum, self.peaks = np.zeros((3, 3, len(PATTERNS)))
        """Of each test: the sum of log e over the block, the CUSUM, and its largest value since the start."""
        self.segment, self.first_ns, self.last_s, self.slots = segment, first_ns, 0.0, 0
        """Segment and time of the first slot, ns; time of the last one since then, s; how many there were."""
        self.suspect = False  # whether the innovations contradict the filter


def limit(false_alarm_hours: float) -> float:
    """Return the value at which a CUSUM alarms, for a mean time at rest to a false alarm of so many hours."""
    tests = 3 * (np.count_nonzero(THETA) + len(LAMBDAS))
    return math.log(tests * false_alarm_hours * 3600.0 / (BLOCK * SLOT_S))


def step(
    state: State, now_s: float, innovation: FloatArray, temperature: FloatArray, rate: FloatArray
) -> float:
    """Take a slot; at the end of a block return the highest of the tests, else 0.

    `now_s` is the time since the first slot, s, and the `innovation`, (3,), over its standard deviation.
    Temperature and rate, (3,), are those of each gyro, °C and °C/s, NaN where unknown.
    """
    dt, state.last_s = now_s - state.last_s, now_s
    state.slots += 1
    v = np.clip(innovation, -CLIP, CLIP)[:, None]
    # Temperature and rates behind their high-passes, between -1 and 1; 0 where unknown.
    value = np.column_stack([temperature, rate, rate])
    state.low = np.where(np.isnan(state.low), np.where(np.isinf(HIGH_PASS_S), 0.0, value), state.low)
    state.low += -np.expm1(-dt / HIGH_PASS_S) * np.nan_to_num(value - state.low)
    change = value - state.low
    least = np.maximum(math.exp(-dt / SCALE_S) * state.scale, LEAST_CHANGE)
    state.scale = np.where(np.isnan(change), state.scale, np.maximum(np.abs(change), least))
    thermal = np.nan_to_num(change / state.scale)
    decay = np.tile(np.exp(-now_s / DECAYS_S), (3, 1))
    past = np.clip(state.past / PAST_SCALE, -1.0, 1.0)
    state.past = KEPT * state.past + (1.0 - KEPT) * v
    counted = state.slots - LEARNING
    if counted <= 0:
        return 0.0
    theta_r = (np.hstack([thermal, decay, past])[:, :, None] * THETA).reshape(3, -1)
    of_mean = theta_r * v - TOLERANCE * np.abs(theta_r) - 0.5 * KAPPA * theta_r**2
    of_variance = LAMBDAS * v**2 + 0.5 * np.log(1.0 - 2.0 * LAMBDAS * KAPPA)
    state.gain += np.hstack([of_mean, of_variance])
    if counted % BLOCK:
        return 0.0
    state.cusum = np.maximum(state.cusum, 0.0) + state.gain
    state.gain[:] = 0.0
    state.peaks = np.maximum(state.peaks, state.cusum)
    return float(state.peaks.max())


class ModelWatch:
    """Detects when the innovations of the bias filter are not what the filter expects.

    They should be white, standard normal, and have nothing to do with temperature, its rate or the time.  A
    suspicion stays until the device restarts: a model that has failed does not get better when the
    temperature comes to rest.  How often in vain: docs/appendix/closing-the-loop-details.md.

    Parameters
    ----------
    modelled : bool
        Whether the filter uses a bias model; it decides what is advised.
    """

    columns: Sequence[Column] = (
        Column("model_suspect", "1", "int64", "1 once the innovations contradict the bias filter, else 0"),
    )

    def __init__(self, parameters: WatchParameters | None = None, modelled: bool = False) -> None:
        given = parameters or WatchParameters()
        self._alarm_at = limit(given.false_alarm_hours)
        self._modelled = modelled
        self._state = State()
        self._texts: list[str] = []

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return ``model_suspect`` of a block, int64.

        Needs ``device_time_ns``, ``segment`` and ``zupt_innovation_{x,y,z}``; takes what there is of
        ``temperature_estimate`` and ``temperature_rate``, of each axis before those of the unit.
        """
        innovations = block.stacked([f"zupt_innovation_{axis}" for axis in "xyz"])
        state, time_ns, segment = self._state, block["device_time_ns"], block["segment"]
        suspect = np.where(segment == state.segment, int(state.suspect), 0)
        slots = np.flatnonzero(np.isfinite(innovations).any(1))
        temperature, rate = (_of_axes(block, f"temperature_{name}", slots) for name in ("estimate", "rate"))
        for k, row in enumerate(slots.tolist()):
            now_s = 1e-9 * int(time_ns[row] - state.first_ns)
            if segment[row] != state.segment or now_s < state.last_s:  # a restart
                state = self._state = State(int(segment[row]), int(time_ns[row]))
                now_s, suspect[row:] = 0.0, 0
            highest = step(state, now_s, np.nan_to_num(innovations[row]), temperature[k], rate[k])
            if highest >= self._alarm_at and not state.suspect:
                state.suspect = True
                suspect[row:] = segment[row:] == state.segment
                self._texts.append(interpret(state.peaks, self._modelled)[1])
        return {"model_suspect": suspect}

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the lane ``model``: MODEL OK, MODEL SUSPECT with the reason, waiting, or no model."""
        if self._state.suspect:
            reason = interpret(self._state.peaks, self._modelled)[0]
            return {"model": LaneState(f"MODEL SUSPECT: {reason}", Level.BAD)}
        if self._state.slots < LEARNING + BLOCK:
            none = "" if self._modelled else "no model; "
            return {"model": LaneState(f"{none}waiting for rest", Level.WAIT)}
        if not self._modelled:
            return {"model": LaneState("no model; innovations as expected")}
        return {"model": LaneState("MODEL OK", Level.GOOD)}

    def notices(self) -> list[str]:
        """Return what was suspected so far, and which command reports more."""
        return self._texts


def _of_axes(block: SampleBlock, name: str, rows: IntArray) -> FloatArray:
    """Return a column at some rows, of each axis where it has its own, else of the unit, (rows, 3)."""
    *of_axes, unit = block.stacked([f"{name}_x", f"{name}_y", f"{name}_z", name])[rows].T
    return np.column_stack([np.where(np.isfinite(of), of, unit) for of in of_axes])


def interpret(peaks: FloatArray, modelled: bool) -> tuple[str, str]:
    """Return a short reason and a line for the log, with a bias model in use or not.

    The strongest driver of the bias that explains the innovations is named, before the mere fact that these
    follow each other, and that before their size: an effect does all three.  `peaks` are of `State`, (3, t).
    """
    least = EXPLAINING_SHARE * float(peaks.max())
    strength = {pattern: peaks[:, pattern == PATTERNS].max(1) for pattern in Pattern}
    explains = [pattern for pattern in Pattern if strength[pattern].max() >= least]
    drivers = [pattern for pattern in explains if pattern in DRIVERS]
    named = max(drivers, key=lambda pattern: float(strength[pattern].max())) if drivers else explains[0]
    does = f"follow {named}" if drivers else str(named)
    axes = ", ".join(axis for axis, peak in zip("xyz", strength[named], strict=True) if peak >= least)
    if named is Pattern.VARIANCE:
        advice = "the noise declared is too small, or something shakes the unit: imumon allan SESSION"
    elif not modelled and named in (Pattern.TEMPERATURE, Pattern.RATE):
        advice = "there is no model of the bias: imumon calibrate SESSION --out MODEL.yaml"
    else:
        lacks = "the model lacks" if modelled else "there may be"
        # A session that ran with a model has it.
        diagnose = f"imumon diagnose --train SESSION{' --model SESSION' * modelled} --out DIR"
        advice = f"{lacks} an effect such as {', '.join(suspected_by(named))}: {diagnose}"
    return (
        f"innovations {does}",
        f"MODEL SUSPECT: on {axes} the innovations of the bias filter {does}; {advice}",
    )
