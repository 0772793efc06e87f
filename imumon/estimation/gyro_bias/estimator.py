"""Slot by slot: is the unit at rest, and what is the bias?

`imumon.estimation.rest.quiet` tests whether anything moves, without a bias; of each quiet second
`hypotheses` decides what its mean is.  At rest is what is quiet for a second, has been decided on since it
was last not, and is not rather a turn.  While the unit moves, what moves the bias is in its variance.  All
rates are less what the thermal model has added since the start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import bank
from imumon.estimation.gyro_bias.hypotheses import CHANGED_BIAS, LEAST_SECONDS, Hypotheses, begun
from imumon.estimation.gyro_bias.modes import SENSITIVITY_SD, SLOPE, WALK, Modes, modes_of, unknown_modes
from imumon.estimation.gyro_bias.motion import Motion
from imumon.estimation.gyro_bias.place import Attitude
from imumon.estimation.gyro_bias.prediction import NOTHING, Shown
from imumon.estimation.gyro_bias.thermal_input import ThermalVariance
from imumon.estimation.rest.odds import by_compass
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.quiet import LEAST_SLOTS, TRIAL, QuietDetector
from imumon.estimation.rest.slots import ACCEL, GYRO, Second, Slot, second_of
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY

SECOND_S = 1.0 - 1e-6
UNDO_SLOTS = 2
"""Motion that begins within so many slots after a second takes that second back from the filters."""
BEGAN_LOG_RATIO = 8.0
"""Log likelihood ratio by the compass from which on the recording began in a turn."""
LEAST_WHITE = 1e-18
"""Variance of the mean of a second, (rad/s)²: less than any gyro has, and more than none."""


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """What is declared; None where it is not."""

    white_sd: FloatArray | None
    """Angle random walk, rad/√s, (3,)."""
    wander: tuple[FloatArray, FloatArray] | None
    """B, rad/s, and K, rad/s/√s, (3,) each."""
    latitude: float | None
    heading: float | None
    """Of the place, and of the first rest, rad."""
    slopes: tuple[float, ...]
    """Standard deviations of the slope over temperature, over σ, 1/°C."""
    rest: RestParameters
    rest_given: bool
    """Whether the slots say whether it rests."""

    @property
    def attitude(self) -> Attitude:
        """Attitude of which nothing is known."""
        return Attitude(self.latitude, self.heading)

    def modes(self, white: FloatArray) -> Modes:
        """Return the modes of the bank; `white`, (3,), is the variance of the mean of a second."""
        if self.wander is None:
            return unknown_modes(self.slopes)
        b, k = ((one / np.sqrt(white))[:, np.newaxis] for one in self.wander)
        return modes_of(b, k, self.slopes, np.ones((1, 1)))


@dataclass(slots=True, eq=False)
class Estimator:
    """All that is carried from slot to slot."""

    settings: Settings
    thermal: ThermalVariance
    quiet: QuietDetector = field(default_factory=QuietDetector)
    jumps: int = 0
    """How often the bias has changed, other than by a restart of the device."""
    hypotheses: Hypotheses | None = None
    """Of the bias, from the first rest on."""
    latest: list[Slot] = field(default_factory=list)
    """The latest 16 slots."""
    pending: list[Slot] = field(default_factory=list)
    """Quiet slots of a second that is not complete."""
    attitude: Attitude = field(init=False)
    added: FloatArray = field(default_factory=partial(np.zeros, 3))
    """Variance that has not been taken into the filters yet, (rad/s)², (3,)."""
    force: FloatArray = field(default_factory=partial(np.zeros, 3))
    """The last specific force that was known, m/s², (3,); zero before the first."""
    degc: FloatArray = field(default_factory=partial(np.full, 3, np.nan))
    """The last temperatures that were known, °C, (3,)."""
    motion: Motion = field(default_factory=Motion)
    """Estimates the bias from motion before the first rest."""
    by_motion: Shown = NOTHING
    decided: bool = False
    """Whether a second has been decided on since it was last not quiet."""
    began_turning: bool = False
    """Whether the first mean of the recording is a turn, by the compass."""
    ambiguities: FloatArray = field(default_factory=partial(np.zeros, (2, 3)))
    """By the other hypothesis of the bias, after each of the last two seconds, rad/s, (2, 3)."""
    revision: int = 0
    """Changes with the prediction, but for what time does to it."""

    def __post_init__(self) -> None:
        """Begin where nothing is known of the attitude."""
        self.attitude = self.settings.attitude

    def restarted(self) -> Estimator:
        """Return what holds after a restart of the device: the noise is what it was, the bias is not."""
        self.quiet.begin()
        thermal = ThermalVariance(self.thermal.trust)
        return Estimator(self.settings, thermal, self.quiet, self.jumps, revision=self.revision + 1)

    @property
    def at_rest(self) -> bool:
        """Whether the unit rests; by accelerometers alone where a gyro is absent."""
        if not self.quiet.present[GYRO].all():
            return self.quiet.is_rest
        turning = self.began_turning or (self.hypotheses is not None and self.hypotheses.turning)
        return self.decided and not turning

    def step(self, slot: Slot) -> FloatArray | None:
        """Take a slot; return the normalised innovations of the second that it completes at rest, (3,)."""
        force = slot.mean[ACCEL]
        self.force = np.where(np.isfinite(force), force, self.force)
        self.degc = np.where(np.isfinite(slot.degc), slot.degc, self.degc)
        self.added = self.added + self.thermal.step(slot.degc, slot.power_on_sd)
        self.latest = [*self.latest[1 - TRIAL :], slot]
        if self.settings.rest_given:
            self.quiet.take_given(slot)
        else:
            self.quiet.take(slot, self.settings.rest.drift)
        innovation = None
        if not self.quiet.present[GYRO].all():
            return None
        if self.quiet.run == 0:
            self._move(slot)
        elif self.hypotheses is None:
            self._look_for_beginning()
        elif self.quiet.another:
            self.hypotheses.restart_noise(self._noise()[GYRO])
            self.pending = []
        else:
            self.pending.append(slot)
            if self.hypotheses.turning:
                self._follow(slot)
            if self.quiet.is_rest and sum(one.seconds for one in self.pending) >= SECOND_S:
                innovation = self._decide(self.hypotheses)
        return innovation if self.at_rest else None

    def miss(self, degc: FloatArray, lag_degc: FloatArray, long: bool) -> None:
        """Note a gap: the lag of the gyros' temperatures may have changed by so much (sd), °C, (3,).

        Parameters
        ----------
        degc : array (3,)
            Temperatures behind it; NaN where they are not known.
        long : bool
            Whether rest does not go on over it.
        """
        self.motion.interrupt()
        self.attitude.lost |= long or self.quiet.run == 0
        self.degc = np.where(np.isfinite(degc), degc, self.degc)
        self.added = self.added + self.thermal.step(degc, np.full(3, np.nan)) + self.thermal.lagged(lag_degc)
        if self.hypotheses is not None:
            prediction = self.hypotheses.nominal.bank.prediction
            slope2 = prediction.mean[:, SLOPE] ** 2 + prediction.covariance[:, SLOPE, SLOPE]
            self.added = self.added + slope2 * lag_degc**2
        if long:
            self.quiet.begin()
            self._interrupt()
        self.revision += 1

    def _noise(self) -> FloatArray:
        """Return the variance of the mean of a second, (6,)."""
        covered_s = sum(one.covered_s for one in self.latest) / len(self.latest)
        return np.maximum(self.quiet.noise * covered_s, LEAST_WHITE)

    def _second(self, slots: Sequence[Slot]) -> Second:
        """Return the means of slots, less the earth rate."""
        return second_of(slots, self.attitude.earth, self.force)

    def _interrupt(self) -> None:
        """Drop a second that is not complete: it moves, or nothing is known of it for a while."""
        if self.began_turning:
            self.hypotheses, self.began_turning = None, False
        if self.decided:
            self.revision += 1
        if self.hypotheses is not None:
            self.hypotheses.move(undo=len(self.pending) < UNDO_SLOTS)
        self.pending, self.decided = [], False

    def _move(self, slot: Slot) -> None:
        """Follow a slot in motion."""
        self._interrupt()
        force = slot.mean[ACCEL]
        if self.hypotheses is not None:
            self._follow(slot)
        elif slot.gap_s or np.isnan(force).any():
            self.motion.interrupt()
        elif self.motion.take(slot.turn, force):
            bias, variance = self.motion.bias
            variance = variance + EARTH_RATE**2 + (SENSITIVITY_SD * STANDARD_GRAVITY) ** 2
            self.by_motion = Shown.constant(bias, variance)
            self.revision += 1

    def _follow(self, slot: Slot) -> None:
        """Add a slot to the turn since the attitude was taken."""
        assert self.hypotheses is not None
        self.attitude.follow(slot.turn, self.hypotheses.nominal.bank.prediction.mean[:, WALK] + slot.modelled)
        self.attitude.lost |= slot.gap_s > 0.0

    def _look_for_beginning(self) -> None:
        """Begin with the first second, or the slots of the trial that has found the noise."""
        self.motion.interrupt()
        run = self.quiet.run
        if not self.quiet.known or run < LEAST_SLOTS:
            return
        slots = self.latest[-run:]
        self.attitude = self.settings.attitude
        self.attitude.come_to_rest(self.force, None)
        whole_s = max(round(sum(one.seconds for one in slots)), 1)
        parts = np.array_split(np.arange(len(slots)), min(whole_s, len(slots)))
        seconds = [self._second([slots[k] for k in part]) for part in parts]
        if not np.isfinite([one.rate for one in seconds]).all():
            return
        white, count = self._noise()[GYRO], bank.PRIOR_COUNT
        if self.settings.white_sd is not None:
            white, count = np.maximum(self.settings.white_sd**2, LEAST_WHITE), bank.DECLARED_COUNT
        filters = bank.start(self.settings.modes(white), white, count, seconds[0])
        self.hypotheses = begun(filters, seconds, self.settings.rest, self.settings.rest_given)
        self.decided, self.added = True, np.zeros(3)
        self.revision += 1

    def _come_to_rest(self, hypotheses: Hypotheses, force: FloatArray) -> None:
        """Take the attitude after a turn, and what that adds to the variance of the bias."""
        self.added = self.added + self.attitude.come_to_rest(force, hypotheses.nominal.bank.prediction)

    def _decide(self, hypotheses: Hypotheses) -> FloatArray | None:
        """Decide on a complete second; return its normalised innovations, (3,)."""
        slots, self.pending = self.pending, []
        if hypotheses.moved:
            self._come_to_rest(hypotheses, slots[0].mean[ACCEL])
        now = self._second(slots)
        if not np.isfinite(now.rate).all():
            return None
        prediction = hypotheses.nominal.bank.prediction.wider(self.added).at(now.end_s, now.degc)
        mean, variance = prediction.bias(now.force)
        innovation = (now.rate - mean) / np.sqrt(variance + prediction.white / now.seconds)
        accel_noise = float(self._noise()[ACCEL].max()) if self.quiet.present[ACCEL].all() else math.inf
        first = len(hypotheses.recent) < LEAST_SECONDS
        parts = [self._second([slot]) for slot in slots] if first else []
        self.jumps += hypotheses.decide(now, parts, self.added, accel_noise) == CHANGED_BIAS
        self.added, self.decided = np.zeros(3), True
        _, ambiguity = hypotheses.prediction(now.end_s, self.degc, self.force)
        self.ambiguities = np.stack([self.ambiguities[1], ambiguity])
        self.revision += 1
        self._compare_compass(hypotheses)
        if self.began_turning and hypotheses.changed is not None:
            self.quiet.begin()
            self._interrupt()
        elif self.attitude.turn.seconds and not hypotheses.turning:
            self._come_to_rest(hypotheses, slots[-1].mean[ACCEL])
        return np.asarray(innovation)

    def _compare_compass(self, hypotheses: Hypotheses) -> None:
        """Find whether the recording has begun in a turn, while it may have."""
        possible = hypotheses.first is not None and hypotheses.changed is None
        if possible and not self.settings.rest_given:
            self.began_turning |= by_compass(hypotheses.recent, np.zeros(3)) < -BEGAN_LOG_RATIO

    def shown(self, now_s: float) -> Shown:
        """Return the prediction of the bias from a time on."""
        if self.hypotheses is None:
            return self.by_motion
        prediction, _ = self.hypotheses.prediction(now_s, self.degc, self.force)
        return prediction.shown(self.added + self.attitude.uncertain_earth, self.force)

    @property
    def turn_hypothesis(self) -> FloatArray:
        """The turn that may be a change of the bias, or the largest error by rounding, rad/s, (3,).

        Of the last two seconds the larger one: a single second may fit by chance.
        """
        hypotheses = self.hypotheses
        if hypotheses is None or (hypotheses.moved and hypotheses.changed is None):
            return np.zeros(3)
        if self.began_turning:
            return hypotheses.recent[-1].rate
        before, latest = self.ambiguities
        larger = np.where(np.abs(before) > np.abs(latest), before, latest)
        return np.asarray(np.copysign(np.hypot(larger, self.quiet.rounding_error[GYRO]), larger))
