"""Is the signal quiet?  Means of neighbouring windows against the noise that the unit has at rest.

Of a unit at rest the means of slots are white noise of variance v, (rad/s)² or (m/s²)², about a constant.
While v is known, the means of the last L slots of a run, L = 1, 2, 4 ... 64, and of the L slots before them
may differ by D, summed over the three axes of a sensor::

    sum max(|D| - drift L dt, 0)² / (2 max(v / L, q²)) <= 42,    dt = 1/4 s

A change by q, of variance `QUIET_VARIANCE` plus that of rounding, is always quiet.  Quiet slots in a row are
a *run*, and rest from a second on.  While v is not known, or when 4 slots in all were unquiet since the last
run of 16, a *trial* of the last 16 slots finds v.
"""

import numpy as np

from imumon.blocks import BoolArray, FloatArray

from .slots import AXES, GYRO, Slot

TRIAL = 16  # slots of a trial
# Slots of a second: a choice for the shortest rest, for the longest pause between short runs, for the unquiet
# slots from which on the noise is doubtful, and for the time between trials.
SECOND_SLOTS = 4
SHORT_RUNS = 2  # after so many rest takes `TRIAL`: a slow tilt is quiet for single seconds.  Ablation.
QUIET_TOO_SHORT, FAR_SAMPLE = "quiet for too short a time", "a single sample is far from the mean"
LENGTHS = 2 ** np.arange(7)  # L, slots of the windows that are compared
LENGTH_COLUMN = LENGTHS[:, None]  # L beside the six axes, (7, 1)
CHI_SQUARE = 42.0  # three axes together: once in 2e8 for Gaussian noise of known variance
# Sd q of a mean of a second that is always quiet, (6,), rad/s (72 °/h) and m/s² (0.03°): by `CHI_SQUARE` two
# may differ by √84 q in an axis, 0.18 °/s, and means of slots by half, as MEMS biases step.  Assumed.
QUIET_SD = np.repeat([3.5e-4, 5e-3], 3)
# q² of a window, (7, 6): for less than a second it is in proportion to the time.
QUIET_VARIANCE = QUIET_SD**2 / np.maximum(1.0, SECOND_SLOTS / LENGTH_COLUMN)
UNSEEN_STEP = np.repeat([np.radians(2000.0 / 2**15), 0.0], 3)  # rad/s: gyros of 16 bits, ±2000 °/s; no m/s²
# Of the variance of a slot's samples, (rad/s)² and (m/s²)²:
NO_NOISE = 1e-20  # below this the samples do not change: rounding in a mean
LEAST_SCATTER = 1e-12  # up to this, in both units, it is never motion.  Assumed.
VARIANCE_SIGMAS, VARIANCE_FACTOR = 6.0, 2.0  # motion is above: chi-square sigmas, and a factor.  Assumed.
# A sample farther from the mean than these together ends a rest: noise, q, steps of the sensor.  Assumed.
SPIKE_SIGMAS, SPIKE_QUIET_SDS, SPIKE_STEPS = 8.0, 4.0, 1.5
MEMORY_SLOTS = 1200.0  # slots over which the noise is averaged at rest: five minutes.  Assumed.
# Limits of a trial (`_shows_motion`).  Assumed.
LARGEST_COLOUR = 5.0  # coloured: variance of means of 4 and 8 slots over that of white noise
SLOWER = 16.0  # slow: variance of slot means over what the samples in a slot explain
HALVES, HALVES_OFFSET = 5.0, 20.0  # uneven: factor of one half's sum of squares / v over the other's, offset
# Loud: rms of slot means, which pass 2 Hz, rad/s and m/s²: sensors of 0.1 °/s/√Hz and 1.5 mg/√Hz, one-sided.
LOUDEST_REST = np.array([2.5e-3, 0.021])
WHITE = 1.5  # white: variance of slot means over that by white samples in a slot
LEAST_SAMPLES = 3.0  # in a slot, for the variance of its samples to mean anything.  Assumed.
OUTLIER = 9.0  # a square above so many times its mean, three sigmas, counts as this: one knock is no noise
NOISE_CHANGE = 2.5  # factor of the variance from which on a trial has found a larger noise.  Assumed.


class QuietDetector:
    """The last slots, the latest one last, and the noise at rest; rad/s and m/s², arrays (..., 6)."""

    def __init__(self) -> None:
        # Means of 128 slots; an axis without reading keeps its last mean, 0 before the first.
        self.mean = np.zeros((2 * LENGTHS[-1], AXES))
        self.latest: list[Slot] = []  # 16 slots
        self.unread = np.full(AXES, np.inf)  # slots since the last reading of each axis; ∞ before the first
        # Variance at rest of the mean of a slot, and of its samples, (rad/s)² and (m/s²)².
        self.noise, self.sample_noise = np.zeros((2, AXES))
        self.noise_slots = 0.0  # slots that the noise is averaged over; 0 while it is not known
        self.noise_changed = False  # whether another noise has been found with this slot
        self.why_unquiet = ""  # of the latest slot; empty if it is quiet
        self.disturbed = False  # whether a single sample of the open slot was far from the mean
        # Step of the sensor, the least of all slots; 0 while it is not known, where `Slot.step` is ∞.
        self.step = np.zeros(AXES)
        self.pause_slots = 0  # unquiet ones since the last quiet one; a gap makes a pause no shorter
        self.restart()

    def restart(self) -> None:
        """Count anew after a gap or a restart of the device; the noise stays."""
        self.slots = 0  # how many there were since
        self.quiet_slots = 0  # length of the present run; 0 after an unquiet slot
        self.unquiet_slots = 0  # in all since the last run of a trial's length
        self.short_runs = 0  # in a row: shorter than a trial, with pauses of a second at most

    @property
    def present(self) -> BoolArray:
        """Axes that have readings in the latest slots, (6,)."""
        return self.unread < TRIAL

    @property
    def is_rest(self) -> bool:
        """Whether the signal has been quiet for long enough."""
        return self.quiet_slots >= (TRIAL if self.short_runs >= SHORT_RUNS else SECOND_SLOTS)

    @property
    def unrest(self) -> str:
        """Why it is no rest; empty where it is."""
        if self.disturbed:
            return FAR_SAMPLE
        return self.why_unquiet or ("" if self.is_rest else QUIET_TOO_SHORT)

    @property
    def floor(self) -> FloatArray:
        """Variance of a mean that rounding makes where the noise does not reach a step, (6,)."""
        return self.step**2 / 12.0

    @property
    def rounding_error(self) -> FloatArray:
        """Error of a mean by rounding to steps of the sensor, (6,): the larger one of two, in steps.

        Noise of sd s leaves exp(-2 π² s²) / 2 at most, with readings of variance r = s² + 1/12 (Sheppard).
        If s is below a third, two readings alternate.  Then r, at most 1/4, does not show s, and the error is
        up to √(1/4 - r), which is taken for three sigmas.
        Readings that are all equal may have any step up to `UNSEEN_STEP`.
        At rest the error is the same in each mean, so filters cannot average it out.  It is a sigma of the
        bias, and half of it one of a measurement: so two that err in opposite ways fit (`FIT_SIGMAS`).
        """
        unseen = self.present & (self.step == 0.0) & (self.sample_noise < NO_NOISE)
        step = np.where(unseen, UNSEEN_STEP, self.step)
        r = self.sample_noise / (step**2 + 1e-24)  # any value without a step
        by_noise = 0.5 * np.exp(-2.0 * np.pi**2 * np.maximum(r - 1.0 / 12.0, 0.0))
        return step * np.maximum(by_noise, np.sqrt(np.maximum(0.25 - r, 0.0)) / 3.0)

    def rest_until_far(self, readings: FloatArray) -> BoolArray:
        """Return which samples, (n, 6), of the open slot are at rest: one far from the mean ends rest."""
        tolerance = np.where(self.present, SPIKE_SIGMAS * np.sqrt(self.sample_noise + self.noise), np.inf)
        tolerance += SPIKE_QUIET_SDS * QUIET_SD + SPIKE_STEPS * self.step
        centre = self.mean[-SECOND_SLOTS:].sum(0) / SECOND_SLOTS
        far = ((readings < centre - tolerance) | (readings > centre + tolerance)).any(1)
        self.disturbed = bool(far.any())
        return ~np.maximum.accumulate(far)

    def update(self, slot: Slot, drift: FloatArray) -> None:
        """Detect rest at the end of a slot; `drift`, rad/s² and m/s³, (6,), is permitted at rest.  Where rest
        is given, only the noise is estimated."""
        self._append(slot)
        self.noise_changed = False
        self.slots += 1
        self.why_unquiet = self._why_unquiet(slot, drift)
        self.disturbed = False
        if self.why_unquiet:
            self._end_run()
        else:
            self.quiet_slots += 1
            if self.noise_slots:
                self._learn(slot)
                self.pause_slots = 0
                if self.quiet_slots >= TRIAL:
                    self.unquiet_slots = self.short_runs = 0
            elif self.quiet_slots >= TRIAL:  # given rest: only that is quiet while the noise is not known
                noise = self._white_variance()
                self._set_noise(noise, noise * slot.samples)
        # If a second in all was unquiet, the noise may have grown.
        doubtful = not self.noise_slots or (self.unquiet_slots >= SECOND_SLOTS and self.quiet_slots < TRIAL)
        if slot.rest_given is None and doubtful and self.slots >= TRIAL and self.slots % SECOND_SLOTS == 0:
            self._take_trial(slot.samples)

    def _append(self, slot: Slot) -> None:
        """Append a slot; axes that appear or vanish end the run, and the noise is learned anew."""
        present_before = self.present
        self.latest = [*self.latest[1 - TRIAL :], slot]
        readable = np.isfinite(slot.mean[:AXES])
        self.unread = np.where(readable, 0, self.unread + 1)
        self.mean = np.concatenate([self.mean[1:], np.where(readable, slot.mean[:AXES], self.mean[-1:])])
        if (present_before != self.present).any():
            self.noise_slots = 0.0
            self.restart()
        unknown = self.step == 0.0
        found = np.isfinite(slot.step) & ((slot.step < self.step) | unknown)
        # That a sensor has steps is known by its first one, which ends no rest though far from the mean.
        self.disturbed &= not (found & unknown).any()
        self.step = np.where(found, slot.step, self.step)

    def _end_run(self) -> None:
        self.unquiet_slots += 1
        self.pause_slots += 1
        if self.pause_slots > SECOND_SLOTS:
            self.short_runs = 0
        elif 0 < self.quiet_slots < TRIAL:
            self.short_runs += 1
        self.quiet_slots = 0

    def _why_unquiet(self, slot: Slot, drift: FloatArray) -> str:
        """Return why a slot is not quiet; empty if it is, or rest is given."""
        if slot.rest_given is not None:
            return "" if slot.rest_given else "motion is given"
        if not self.noise_slots:
            return "the noise at rest is not known yet"
        if self.disturbed:
            return FAR_SAMPLE
        if self._windows_differ(slot.length_s * drift):
            return "the mean changes by more than noise and drift"
        return "the samples scatter more than at rest" if self._scatters(slot) else ""

    def _windows_differ(self, drift_per_slot: FloatArray) -> bool:
        """Return whether means of windows differ by more than noise and drift, rad/s and m/s², (6,)."""
        sums = self.mean[::-1].cumsum(0)  # of the latest 1, 2, 3 ... slots
        # Of the window of the latest L slots less that of the L before; the sum of 2 L has both.
        change = 2.0 * sums[LENGTHS - 1] - sums[2 * LENGTHS - 1]
        excess = np.maximum(np.abs(change) / LENGTH_COLUMN - drift_per_slot * LENGTH_COLUMN, 0.0)
        square = excess**2 / (2.0 * np.maximum(self.noise / LENGTH_COLUMN, QUIET_VARIANCE + self.floor))
        differ = (square.reshape(-1, 2, 3).sum(2) > CHI_SQUARE).any(1)  # (length, sensor, axis)
        return bool(differ[self.quiet_slots + 1 >= 2 * LENGTHS].any())  # in the run with this slot

    def _scatters(self, slot: Slot) -> bool:
        """Return whether a slot of three samples or more scatters more than at rest (chi-square)."""
        # Wilson and Hilferty, with half the degrees of freedom: samples may be filtered.
        spread = 2.0 / (9.0 * np.maximum(0.5 * (slot.samples - 1.0), 1.0))  # variance of the cube root
        factor = VARIANCE_FACTOR * (1.0 - spread + VARIANCE_SIGMAS * np.sqrt(spread)) ** 3
        limit = np.maximum(factor * self.sample_noise, LEAST_SCATTER) + 12.0 * self.floor  # plus step²
        return bool(((slot.variance > limit) & (slot.samples >= LEAST_SAMPLES)).any())

    def _learn(self, slot: Slot) -> None:
        """Learn the noise from second differences, in which a drift cancels."""
        if self.quiet_slots < 3:  # of three means
            return
        gain = max(1.0 / MEMORY_SLOTS, 1.0 / (self.noise_slots + 1.0))
        self.noise_slots += 1.0
        before, middle, last = self.mean[-3:]
        square = ((last - middle) - (middle - before)) ** 2 / 6.0  # of white noise its variance: 1 + 4 + 1
        self.noise += gain * (np.minimum(square, OUTLIER * self.noise) - self.noise)
        # A variance of samples scatters less than a single square: 2 sigmas, plus step².
        within = np.minimum(slot.variance, 4.0 * self.sample_noise + 12.0 * self.floor)
        within = np.where(slot.samples >= LEAST_SAMPLES, within, self.sample_noise)
        self.sample_noise += gain * (within - self.sample_noise)

    def _set_noise(self, noise: FloatArray, sample_noise: FloatArray) -> None:
        self.noise, self.sample_noise = noise, sample_noise
        self.noise_slots = TRIAL - 2.0  # second differences
        self.noise_changed = True

    def _white_variance(self) -> FloatArray:
        """Return the variance of the last slot means by their second differences: no drift is in it, (6,)."""
        square = np.diff(self.mean[-TRIAL:], 2, axis=0) ** 2
        return np.asarray(np.maximum(square.mean(0) / 6.0, 1e-24))  # not 0: it divides

    def _take_trial(self, count: FloatArray) -> None:
        """Take the noise of the last 16 slots, each of as many samples as the latest one, `count`, (6,), if
        they look like rest, and none or a smaller one is known."""
        noise = self._white_variance()
        within = np.array([one.variance for one in self.latest])
        enough = np.isfinite(within).all(0) & (count >= LEAST_SAMPLES)
        sample_noise = np.where(enough, within.mean(0), noise * count)
        if self._shows_motion(noise, sample_noise, count):
            return
        larger = noise > NOISE_CHANGE * self.noise + self.floor
        larger |= sample_noise > NOISE_CHANGE * self.sample_noise + self.floor
        if larger.any() or not self.noise_slots:
            self.why_unquiet = ""
            self.quiet_slots = TRIAL
            self.unquiet_slots = self.short_runs = 0
            self._set_noise(noise, sample_noise)

    def _shows_motion(self, noise: FloatArray, sample_noise: FloatArray, count: FloatArray) -> bool:
        """Return whether the last 16 slots are coloured, slow, uneven or loud: then it is no rest.  Of each
        axis, (6,): variance of slot means by second differences, and variance and number of samples."""
        mean = self.mean[-TRIAL:]
        # Always rest: q, but beside a known noise, of which q may be many sigmas, only its outliers.
        least = np.minimum(QUIET_SD**2, OUTLIER * self.noise if self.noise_slots else np.inf) + self.floor
        # Coloured: in means of k slots white noise would average out.
        ratio = [
            mean.reshape(-1, k, AXES).mean(1).var(0, ddof=1) / np.maximum(noise / k, least) for k in (4, 8)
        ]
        coloured = np.reshape(ratio, (2, 2, 3)).mean(2) > LARGEST_COLOUR  # (length, sensor, axis)
        # Slow: the samples within a slot vary less than the slots.
        slow = (noise * count > SLOWER * sample_noise) & (noise > least)
        # Uneven: the 14 squares sum up to much more in one half than in the other, as by a knock.
        square = np.diff(mean, 2, axis=0) ** 2 / np.maximum(noise, least)
        halves = square.reshape(2, -1, 2, 3).sum((1, 3))  # (half, square, sensor, axis)
        uneven = halves.max(0) > HALVES * halves.min(0) + HALVES_OFFSET
        # Loud, as on a road.  Exempt: sensors of one or two samples a slot, and gyros whose slot means are no
        # louder than white samples make them, as of a noisy gyro at rest.
        loud = np.maximum(mean.var(0), noise).reshape(2, 3).mean(1) > LOUDEST_REST**2  # (sensor, axis)
        loud &= count.reshape(2, 3).max(1) >= LEAST_SAMPLES
        loud[0] &= (noise * count >= WHITE * sample_noise + NO_NOISE)[GYRO].any()  # of a gyro, not absent
        return bool(coloured.any() or slow.any() or uneven.any() or loud.any())
