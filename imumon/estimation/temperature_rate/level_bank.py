"""Temperature rate from the level that a sensor reads, also while the reading does not change.

Samples are gathered into slots of a second.  What a slot says of the temperature depends on its readings:

- *mixed*: two neighbouring levels.  The share of the upper one weighs the boundary between them, as a noisy
  or drifting temperature spends time on both sides.  Where a hypothesis moves so fast that noise does not
  matter, the time of the crossing is the measurement.
- *unchanged*: one level.  The temperature is inside, away from the edges by what the noise demands.  Where
  the prediction is sharper than the noise, each such slot is a measurement.  Where it is not, the same
  interval says nothing new every second: it is applied once to what is shown (truncated Gaussian), and taken
  into the state only when the prediction has grown wider than the level or contradicts it.  Such slots are
  gathered into one, as long as the temperature does not move much.
- *spread*: more levels.  The mean is a measurement.
- *noisy*: noise alone spans several levels.  The mean is a measurement, and the steps do not matter.

How smooth the truth is and how noisy the sensor is are hypotheses of a bank (`bank`), so nothing is tuned.
"""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.compiled import njit
from imumon.estimation.temperature_rate.bank import (
    JERKS,
    NEGLIGIBLE,
    NOISE_FACTORS,
    NOISES,
    RR,
    START_RATE,
    TT,
    WEIGHT,
    R,
    T,
    condition,
    empty_bank,
    mix,
    motion_over,
    predict,
    restart,
    reweigh,
)
from imumon.estimation.temperature_rate.probability import ROOT_2_PI, truncated, weigh
from imumon.estimation.temperature_rate.series import RateEstimate, Resumable
from imumon.estimation.temperature_rate.step import (
    MISFIT,
    MISFIT_ALLOWED,
    SEEN,
    STEP,
    SUPPORT,
    SUPPORT_NEEDED,
    TINY,
    learn_step,
)

SLOT_S, SLOT_SAMPLES, LONGEST_SLOT_S = 1.0 - 1e-6, 5, 10.0
"""A slot has this length and at least so many samples, unless they are very rare."""
QUIET_STEPS, QUIET_GROWTH = 0.1, 2.0
"""Unchanged slots are one until the temperature may have moved so many steps; each lasts so much longer."""
SWEEP = 4.0
"""A crossing is timed where the temperature moves by so many noise deviations within a slot."""
CROWDED = 1.8
"""∫ φ²/(Φ(1 - Φ)): readings d °C apart that pass an edge locate it with a variance of d σ over this."""
GLIDE_S = 3.0
"""Time constant with which what is shown follows the state, so that it does not jump."""
SHARPER = 2.0
"""A prediction sharper than so many noise deviations sees the edge of a level as soft."""
WIDER = 1.5
"""A prediction wider than so many steps is replaced by the level."""
SURPRISE = math.log(0.02)
"""So is one that has less than this log probability to be inside."""
EDGE = 1.5
"""Readings that do not flicker keep the temperature so many noise deviations from the edge."""
GATE, GATE_STEPS, GATE_SLOTS = 8.0, 5.0, 10
"""A reading off by so many deviations and steps is a fault; after so many slots it is the truth."""
GAP_S = 600.0
"""After so long without a reading, or of a dead sensor, there is no estimate; a later reading begins anew."""
LATE_S, LATE_FACTOR = 5.0, 3.0
"""Readings missed for so long, and so many times the usual interval, ..."""
UNSEEN_JERK = 1e-13
"""... let the temperature do this, °C²/s⁵, that nobody saw."""
FROZEN_S, DRIFT_PER_S = 3600.0, 1.0 / 3600.0**2
"""A level unchanged for an hour is trusted less: the band grows by 1 °C/h every hour, up to the start's."""
DEAD_S = 60.0
"""Noise that stops for so long is a dead sensor."""
FIRST_STEP = 0.1
"""Step assumed before one is seen, when none is declared."""
MEMORY = 1.0 / 32.0
HIDDEN = 0.3
"""Share of slots in which noise alone spans several levels, above which the steps do not matter."""

FINEST_STEP = 1e-4
"""°C; finer steps are none."""

# Numbers of the state: first those of `step`, then the current slot, ...
(
    SLOT_START, SUM, SUM_TIME, SUM_CROSSED, SUM_GAP, LOW, HIGH, PATH, SQUARES, DIFFERENCE, SLOT_MEAN,
    LAST_READING, LAST_TIME,
    # ... unchanged slots that wait, and how long they may, ...
    ASIDE_START, ASIDE_TIME, ASIDE_LAST, ASIDE_LEVEL, ASIDE_LONGEST,
    # ... what has been learnt of the sensor, ...
    WHITE, HIDING, LAST_CHANGE, LAST_VALID, INTERVAL,
    # ... and what is shown: its time, values, standard deviations, and the remainders that glide away.
    BANK_TIME, SHOWN_TIME, SHOWN_T, SHOWN_R, SHOWN_A, SHOWN_T_SD, SHOWN_R_SD, GLIDE_T, GLIDE_R,
) = range(4, 36)  # fmt: skip
NUMBERS = 36
# Integers of the state.
STARTED, SAMPLES, VALID, CHANGES, OUTLIERS, ASIDE = range(6)
INTEGERS = 6
# Kinds of slots.
UNCHANGED, MIXED, SPREAD, NOISY = range(4)


class LevelBankRate(Resumable):
    """The default method: a bank of filters that hears what a level says by staying.

    Parameters
    ----------
    step : float or None
        Quantization step in °C, if it is known; it is found from the readings in any case.
    """

    def __init__(self, step: float | None = None) -> None:
        if step is not None and not step > TINY:
            raise ValueError(f"a step of {step} °C")
        self._bank = empty_bank()
        self._work = empty_bank()
        self._numbers = np.zeros(NUMBERS)
        self._numbers[STEP] = FIRST_STEP if step is None else step
        self._integers: IntArray = np.zeros(INTEGERS, np.int64)
        super().__init__(bank=self._bank, numbers=self._numbers, integers=self._integers)

    @property
    def step(self) -> float | None:
        """The step in °C that the readings show, None as long as they do not."""
        known = self._numbers[SUPPORT] >= SUPPORT_NEEDED and not _has_no_steps(self._numbers)
        return float(self._numbers[STEP]) if known else None

    @property
    def noise(self) -> float:
        """Standard deviation in °C of the noise before quantization, as the bank weighs it."""
        weights = self._bank[:, WEIGHT].reshape(len(JERKS), len(NOISES)).sum(0)
        return float(weights @ NOISES * self._numbers[STEP])

    def process(self, time_ns: IntArray, segment: IntArray, reading: FloatArray) -> RateEstimate:
        """Return the estimates of samples that follow those of the last call.

        Parameters
        ----------
        time_ns, segment : array, (n,)
            Device time and the number of its segment; a new segment starts anew but keeps the step.
        reading : array, (n,)
            °C; NaN where there is none.
        """
        result = RateEstimate.empty(len(reading))
        for start, stop, begins, seconds in self.clock.runs(time_ns, segment):
            if begins:
                self._integers[STARTED] = 0
            out = result.rows(start, stop)
            _process(
                seconds,
                reading[start:stop],
                self._bank,
                self._work,
                self._numbers,
                self._integers,
                out.temperature,
                out.rate,
                out.temperature_sd,
                out.rate_sd,
            )
        return result


@njit
def _process(
    seconds: FloatArray,
    readings: FloatArray,
    bank: FloatArray,
    work: FloatArray,
    numbers: FloatArray,
    integers: IntArray,
    temperature: FloatArray,
    rate: FloatArray,
    temperature_sd: FloatArray,
    rate_sd: FloatArray,
) -> None:
    for i in range(seconds.size):
        t, reading = seconds[i], readings[i]
        valid = math.isfinite(reading)
        hidden = _has_no_steps(numbers)
        last = numbers[LAST_CHANGE] if hidden else numbers[LAST_VALID]
        if integers[STARTED] and t - last > GAP_S:
            integers[STARTED] = 0
        if not integers[STARTED]:
            if not valid or (hidden and abs(reading - numbers[LAST_READING]) <= TINY):
                continue
            _start(t, reading, bank, numbers, integers)
        elapsed = t - numbers[SLOT_START]
        if elapsed >= SLOT_S and (integers[SAMPLES] >= SLOT_SAMPLES or elapsed >= LONGEST_SLOT_S):
            _finish(t, bank, work, numbers, integers)
            _open(t, numbers, integers)
        integers[SAMPLES] += 1
        if valid:
            _gather(t, reading, numbers, integers)
        age = t - numbers[SHOWN_TIME]
        fade = math.exp(-age / GLIDE_S)
        remainder = numbers[GLIDE_R] * fade
        temperature[i] = numbers[SHOWN_T] + age * numbers[SHOWN_R] + fade * numbers[GLIDE_T]
        rate[i] = numbers[SHOWN_R] + age * numbers[SHOWN_A] + remainder
        temperature_sd[i] = math.hypot(numbers[SHOWN_T_SD], fade * numbers[GLIDE_T])
        rate_sd[i] = math.hypot(numbers[SHOWN_R_SD], remainder)


@njit
def _start(t: float, reading: float, bank: FloatArray, numbers: FloatArray, integers: IntArray) -> None:
    """Begin with a reading; what is known of the sensor stays."""
    restart(bank, reading, numbers[STEP], 0.0, False)
    integers[STARTED] = 1
    integers[OUTLIERS] = integers[ASIDE] = 0
    numbers[LAST_READING], numbers[DIFFERENCE] = reading, 0.0
    numbers[LAST_TIME] = numbers[LAST_CHANGE] = numbers[LAST_VALID] = numbers[BANK_TIME] = t
    numbers[ASIDE_LONGEST] = SLOT_S
    numbers[INTERVAL] = 0.0
    numbers[SHOWN_TIME], numbers[SHOWN_T] = t, reading
    numbers[SHOWN_R] = numbers[SHOWN_A] = numbers[GLIDE_T] = numbers[GLIDE_R] = 0.0
    numbers[SHOWN_T_SD], numbers[SHOWN_R_SD] = numbers[STEP], math.sqrt(bank[0, RR])
    _open(t, numbers, integers)


@njit
def _open(t: float, numbers: FloatArray, integers: IntArray) -> None:
    """Begin a slot."""
    numbers[SLOT_START] = t
    numbers[SUM] = numbers[SUM_TIME] = numbers[SUM_CROSSED] = numbers[SUM_GAP] = 0.0
    numbers[PATH] = numbers[SQUARES] = 0.0
    numbers[LOW], numbers[HIGH] = np.inf, -np.inf
    integers[SAMPLES] = integers[VALID] = integers[CHANGES] = 0


@njit
def _gather(t: float, reading: float, numbers: FloatArray, integers: IntArray) -> None:
    """Take a reading into the slot."""
    difference = reading - numbers[LAST_READING]
    change = abs(difference)
    numbers[SQUARES] += (difference - numbers[DIFFERENCE]) ** 2
    numbers[DIFFERENCE] = difference
    if change > TINY:
        learn_step(change, numbers)
        numbers[LAST_CHANGE] = t
        if integers[VALID] == 0 and t - numbers[LAST_TIME] < LONGEST_SLOT_S:
            # The level changed between two slots: the last reading of the other belongs to the crossing.
            _count(numbers[LAST_TIME], numbers[LAST_READING], numbers, integers)
        integers[CHANGES] += 1
        numbers[PATH] += change
        numbers[SUM_CROSSED] += 0.5 * (t + numbers[LAST_TIME])
        numbers[SUM_GAP] += t - numbers[LAST_TIME]
    _count(t, reading, numbers, integers)
    numbers[LAST_READING], numbers[LAST_TIME], numbers[LAST_VALID] = reading, t, t


@njit
def _count(t: float, reading: float, numbers: FloatArray, integers: IntArray) -> None:
    integers[VALID] += 1
    numbers[SUM] += reading
    numbers[SUM_TIME] += t
    numbers[LOW] = min(numbers[LOW], reading)
    numbers[HIGH] = max(numbers[HIGH], reading)


@njit
def _finish(t: float, bank: FloatArray, work: FloatArray, numbers: FloatArray, integers: IntArray) -> None:
    """Set the slot aside if nothing has happened; take it, and before it what has been set aside, if not."""
    if integers[VALID] and not integers[CHANGES]:
        if integers[ASIDE]:
            integers[VALID] += integers[ASIDE]
            numbers[SUM] += integers[ASIDE] * numbers[ASIDE_LEVEL]
            numbers[SUM_TIME] += numbers[ASIDE_TIME]
            numbers[SLOT_START] = numbers[ASIDE_START]
            integers[ASIDE] = 0
        if t - numbers[SLOT_START] < numbers[ASIDE_LONGEST]:
            integers[ASIDE] = integers[VALID]
            numbers[ASIDE_START], numbers[ASIDE_TIME] = numbers[SLOT_START], numbers[SUM_TIME]
            numbers[ASIDE_LAST], numbers[ASIDE_LEVEL] = numbers[LAST_TIME], numbers[LAST_READING]
            return
    elif integers[ASIDE]:
        kept, counts = numbers.copy(), integers.copy()
        _open(numbers[ASIDE_START], numbers, integers)
        integers[VALID] = counts[ASIDE]
        numbers[SUM], numbers[SUM_TIME] = counts[ASIDE] * numbers[ASIDE_LEVEL], numbers[ASIDE_TIME]
        numbers[LOW] = numbers[HIGH] = numbers[LAST_READING] = numbers[ASIDE_LEVEL]
        numbers[LAST_TIME] = numbers[ASIDE_LAST]
        _close(kept[SLOT_START], bank, work, numbers, integers)
        numbers[SLOT_START:SLOT_MEAN] = kept[SLOT_START:SLOT_MEAN]
        numbers[LAST_READING], numbers[LAST_TIME] = kept[LAST_READING], kept[LAST_TIME]
        integers[SAMPLES:OUTLIERS] = counts[SAMPLES:OUTLIERS]
        integers[ASIDE] = 0
    _close(t, bank, work, numbers, integers)


@njit
def _close(t: float, bank: FloatArray, work: FloatArray, numbers: FloatArray, integers: IntArray) -> None:
    """Bring the bank to the end of the slot and decide what is shown from now on."""
    n = integers[VALID]
    kind = _learn_noise(numbers, integers) if n else UNCHANGED
    dead = _has_no_steps(numbers) and t - numbers[LAST_CHANGE] > DEAD_S
    at = numbers[SUM_TIME] / n if n else t
    dt = max(at - numbers[BANK_TIME], 0.0)
    unseen = n == 0 or dead or dt > max(LATE_S, LATE_FACTOR * numbers[INTERVAL])
    _advance(bank, work, dt, unseen)
    numbers[BANK_TIME] = at
    measured = False
    if n and not dead:
        numbers[INTERVAL] = dt
        if _is_fault(kind, bank, numbers):
            integers[OUTLIERS] += 1
            if integers[OUTLIERS] >= GATE_SLOTS:
                slope = (numbers[SUM] / n - numbers[SLOT_MEAN]) / max(dt, TINY)
                restart(bank, numbers[SUM] / n, numbers[STEP], slope, True)
                integers[OUTLIERS] = 0
        else:
            integers[OUTLIERS] = 0
            _measure(kind, bank, numbers, integers)
            measured = True
        numbers[SLOT_MEAN] = numbers[SUM] / n
    confined = measured and kind == UNCHANGED
    _show(t, confined, bank, work, numbers)
    numbers[ASIDE_LONGEST] = SLOT_S
    if confined:
        still = QUIET_STEPS * numbers[STEP] / max(abs(numbers[SHOWN_R]) + numbers[SHOWN_R_SD], TINY)
        longer = QUIET_GROWTH * (t - numbers[SLOT_START])
        numbers[ASIDE_LONGEST] = max(min(still, longer, LONGEST_SLOT_S) - TINY, SLOT_S)


@njit
def _has_no_steps(numbers: FloatArray) -> bool:
    """Tell whether noise hides the steps, or the readings have none."""
    if numbers[HIDING] > HIDDEN or numbers[STEP] < FINEST_STEP:
        return True
    known = numbers[SUPPORT] >= SUPPORT_NEEDED and numbers[MISFIT] < MISFIT_ALLOWED
    return numbers[SEEN] > 2 * SUPPORT_NEEDED and not known


@njit
def _learn_noise(numbers: FloatArray, integers: IntArray) -> int:
    """Return the kind of the slot; learn of noise that hides the steps."""
    n, changes = integers[VALID], integers[CHANGES]
    span = numbers[HIGH] - numbers[LOW]
    # Noise changes most readings, to and fro; a spike changes two, and a ramp does not turn.
    noisy = span > 1.5 * numbers[STEP] and 2 * changes >= n and numbers[PATH] > 1.5 * span
    if changes:
        numbers[HIDING] += MEMORY * (noisy - numbers[HIDING])
    stepless = _has_no_steps(numbers)
    if noisy or (stepless and changes):
        # Second differences, in which a ramp does not count; a spike may not spoil what is known.
        white = numbers[SQUARES] / (6.0 * n)
        if numbers[WHITE] > 0.0:
            numbers[WHITE] += MEMORY * (min(white, 4.0 * numbers[WHITE]) - numbers[WHITE])
        else:
            numbers[WHITE] = white
    if noisy or stepless:
        return NOISY
    if span > 1.5 * numbers[STEP]:
        return SPREAD
    return UNCHANGED if span < 0.5 * numbers[STEP] else MIXED


@njit
def _advance(bank: FloatArray, work: FloatArray, dt: float, unseen: bool) -> None:
    mix(bank, work, dt)
    motion = motion_over(dt)
    for k in range(len(bank)):
        if bank[k, WEIGHT] > NEGLIGIBLE:
            jerk = JERKS[k // NOISES.size]
            predict(bank[k], motion, max(jerk, UNSEEN_JERK) if unseen else jerk)


@njit
def _is_fault(kind: int, bank: FloatArray, numbers: FloatArray) -> bool:
    """Tell whether no hypothesis allows for the readings of the slot."""
    step = numbers[STEP]
    spread = step * step + (numbers[WHITE] if kind == NOISY else 0.0)
    for k in range(len(bank)):
        if bank[k, WEIGHT] > NEGLIGIBLE:
            off = max(abs(numbers[LOW] - bank[k, T]), abs(numbers[HIGH] - bank[k, T]))
            if off < GATE_STEPS * step or off * off < GATE * GATE * (bank[k, TT] + spread):
                return False
    return True


@njit
def _measure(kind: int, bank: FloatArray, numbers: FloatArray, integers: IntArray) -> None:
    """Take the slot into every hypothesis."""
    step, n = numbers[STEP], integers[VALID]
    mean = numbers[SUM] / n
    duration = max(numbers[LAST_TIME] - numbers[SLOT_START], 0.0)
    log_evidence = np.zeros(len(bank))
    share, informative = 0.0, 1.0
    if kind == MIXED:
        share = min(max((mean - numbers[LOW]) / (numbers[HIGH] - numbers[LOW]), 0.5 / n), 1.0 - 0.5 / n)
        # Independent readings change level this often; a single crossing changes it once.
        informative = min(float(n), max(1.0, integers[CHANGES] / (2.0 * share * (1.0 - share))))
    for k in range(len(bank)):
        row = bank[k]
        if row[WEIGHT] <= NEGLIGIBLE:
            continue
        j = k % NOISES.size
        noise = NOISES[j] * step
        sigma = math.hypot(noise, row[R] * duration / math.sqrt(12.0))
        if kind == NOISY:
            variance = NOISE_FACTORS[j] * max(numbers[WHITE], step * step / 12.0) / n + TINY * TINY
            log_evidence[k] = _fit(row, mean, variance)
        elif kind == SPREAD:
            levels = (numbers[HIGH] - numbers[LOW]) / step
            variance = noise * noise / n + step * step / 12.0 / (levels * levels)
            log_evidence[k] = _fit(row, mean, variance)
        elif kind == MIXED and _sweeps(row[R], abs(row[R]) * duration, noise, numbers, integers):
            log_evidence[k] = _cross(row, noise, numbers, integers)
        elif kind == MIXED:
            edge = 0.5 * (numbers[LOW] + numbers[HIGH])
            m, v, log_evidence[k] = weigh(
                row[T], math.sqrt(row[TT]), edge, edge,
                share * informative, (1.0 - share) * informative, sigma,
            )  # fmt: skip
            condition(row, m, v)
        else:
            log_evidence[k] = _stay(row, mean - step / 2, mean + step / 2, float(n), sigma, step)
    reweigh(bank, log_evidence)


@njit
def _fit(row: FloatArray, z: float, variance: float) -> float:
    """Take a Gaussian measurement of the temperature into one hypothesis; return its log evidence."""
    total = row[TT] + variance
    residual = z - row[T]
    condition(row, row[T] + row[TT] / total * residual, row[TT] * variance / total)
    return float(-0.5 * math.log(total) - 0.5 * residual * residual / total)


@njit
def _sweeps(rate: float, moved: float, noise: float, numbers: FloatArray, integers: IntArray) -> bool:
    """Tell whether the readings of a mixed slot pass the edge once, but for the noise of a hypothesis."""
    changes = integers[CHANGES]
    upward = numbers[LAST_READING] > 0.5 * (numbers[LOW] + numbers[HIGH])
    few = 1.0 + SWEEP * noise * integers[VALID] / max(moved, TINY)
    return moved > SWEEP * noise and changes % 2 == 1 and changes <= few and (rate > 0.0) == upward


@njit
def _cross(row: FloatArray, noise: float, numbers: FloatArray, integers: IntArray) -> float:
    """Take the time at which one hypothesis passed the edge into it; return log evidence."""
    changes = integers[CHANGES]
    since = numbers[BANK_TIME] - numbers[SUM_CROSSED] / changes
    each = max(abs(row[R]) * numbers[SUM_GAP] / changes, TINY * TINY)
    edge = 0.5 * (numbers[LOW] + numbers[HIGH])
    variance = each * (each / 12.0 + noise / CROWDED) + row[RR] * since * since
    # The probability to cross between two readings is the density times the way between them.
    density = _fit(row, edge + row[R] * since, variance)
    return density + math.log(each / ROOT_2_PI)


@njit
def _stay(row: FloatArray, low: float, high: float, n: float, sigma: float, step: float) -> float:
    """Take a reading that does not change into one hypothesis, if it says something; return log evidence."""
    mean, sd = row[T], math.sqrt(row[TT])
    if sd < SHARPER * sigma:
        if min(mean - low, high - mean) > 5.0 * sigma + 3.0 * sd:
            return 0.0
        m, v, log_mass = weigh(mean, sd, low, high, n, n, sigma)
        condition(row, m, v)
        return log_mass
    shift, shrink, log_mass = truncated((low - mean) / sd, (high - mean) / sd)
    if sd < WIDER * step and log_mass > SURPRISE:
        return 0.0
    condition(row, mean + shift * sd, shrink * sd * sd)
    return log_mass


@njit
def _show(t: float, confined: bool, bank: FloatArray, work: FloatArray, numbers: FloatArray) -> None:
    """Merge the hypotheses, each confined to the level that is being read or not, into what is shown."""
    count, total = _confine(confined, bank, work, numbers)
    if not total > 1e-200:
        # The level is out of reach of all hypotheses.
        count, total = _confine(False, bank, work, numbers)
    mean, variance = np.zeros(3), np.zeros(2)
    for k in range(count):
        work[k, WEIGHT] /= total
        for p in range(3):
            mean[p] += work[k, WEIGHT] * work[k, T + p]
    for k in range(count):
        variance[0] += work[k, WEIGHT] * (work[k, TT] + (work[k, T] - mean[0]) ** 2)
        variance[1] += work[k, WEIGHT] * (work[k, RR] + (work[k, R] - mean[1]) ** 2)
    mean[0] += numbers[LAST_READING]
    _glide_to(t, mean, variance, numbers)


@njit
def _confine(confined: bool, bank: FloatArray, work: FloatArray, numbers: FloatArray) -> tuple[int, float]:
    """Write the hypotheses that count into `work`, T less the reading; return how many and their weight."""
    step, count, total = numbers[STEP], 0, 0.0
    for k in range(len(bank)):
        row, shown = bank[k], work[count]
        if row[WEIGHT] <= NEGLIGIBLE:
            continue
        shown[:] = row
        shown[T] -= numbers[LAST_READING]
        sd, sigma = math.sqrt(row[TT]), NOISES[k % NOISES.size] * step
        if confined and sd >= SHARPER * sigma:
            half = step / 2 - min(EDGE * sigma, 0.3 * step)
            shift, shrink, log_mass = truncated((-half - shown[T]) / sd, (half - shown[T]) / sd)
            condition(shown, shown[T] + shift * sd, shrink * row[TT])
            shown[WEIGHT] *= math.exp(log_mass)
        total += shown[WEIGHT]
        count += 1
    return count, total


@njit
def _glide_to(t: float, mean: FloatArray, variance: FloatArray, numbers: FloatArray) -> None:
    """Set what is shown from t on; the difference to what was shown until now fades away."""
    age = t - numbers[SHOWN_TIME]
    fade = math.exp(-age / GLIDE_S)
    before_t = numbers[SHOWN_T] + age * numbers[SHOWN_R] + fade * numbers[GLIDE_T]
    before_r = numbers[SHOWN_R] + age * numbers[SHOWN_A] + fade * numbers[GLIDE_R]
    ahead = t - numbers[BANK_TIME]
    distrust = min(DRIFT_PER_S * max(t - numbers[LAST_CHANGE] - FROZEN_S, 0.0), START_RATE)
    numbers[SHOWN_TIME] = t
    numbers[SHOWN_T] = mean[0] + ahead * mean[1]
    numbers[SHOWN_R] = mean[1] + ahead * mean[2]
    numbers[SHOWN_A] = mean[2]
    numbers[SHOWN_T_SD] = math.sqrt(max(variance[0], 0.0))
    numbers[SHOWN_R_SD] = math.hypot(math.sqrt(max(variance[1], 0.0)), distrust)
    numbers[GLIDE_T] = before_t - numbers[SHOWN_T]
    numbers[GLIDE_R] = before_r - numbers[SHOWN_R]
