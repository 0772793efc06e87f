"""Slot by slot: is the unit at rest, and what is the bias?  `imumon.estimation.rest` explains the words."""

from collections.abc import Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest import odds
from imumon.estimation.rest.parameters import GyroBiasParameters, RestParameters
from imumon.estimation.rest.quiet import QUIET_TOO_SHORT, SECOND_SLOTS, QuietDetector
from imumon.estimation.rest.slots import ACCEL, DEGC, GYRO, HEADING, MODELLED, POWER_ON_SD, Measurement, Slot
from imumon.filters.turns import STILL
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY

from .bank import LEAST_WHITE, SENSITIVITY_SD, Bank, LinearBias
from .hypotheses import Hypotheses
from .motion import Motion
from .place import Attitude
from .thermal import Thermal

SECOND_S = 1.0 - 1e-6  # length of a measurement; slots of 0.25 s add up to it in spite of rounding
UNDO_SLOTS = 2  # motion that begins within so many slots after a measurement takes it back from the filters


class Estimator:
    """Rest and bias; `slopes` are standard deviations of the slope over temperature, over σ, 1/°C."""

    def __init__(
        self,
        parameters: GyroBiasParameters,
        slopes: Sequence[float],
        limits: RestParameters,
        thermal: Thermal,
        attitude: Attitude,
    ) -> None:
        self.parameters, self.slopes, self.limits = parameters, slopes, limits
        self.thermal, self.attitude, self.quiet = thermal, attitude, QuietDetector()
        self.drift = np.repeat([limits.gyro_drift, limits.accel_drift], 3)  # permitted at rest, (6,)
        self.jumps = 0  # how often the bias has jumped, other than by a restart
        self.restart()

    def restart(self) -> None:
        """Begin after a restart of the device: the noise is what it was, the bias is not."""
        self.quiet.restart()
        self.thermal.restart()
        self.attitude.restart()
        self.hypotheses: Hypotheses | None = None  # of the bias, from the first rest on
        self.pending: list[Slot] = []  # quiet slots of a measurement that is not complete
        self.degc_and_sd = np.full((2, 3), np.nan)  # the last temperatures that were known, and their sd
        self.motion = Motion()  # estimates the bias before the first rest

    @property
    def force(self) -> FloatArray:
        """The last specific force that was known, m/s², (3,); zero before the first."""
        return self.quiet.mean[-1, ACCEL]

    @property
    def unrest(self) -> str:
        """Why the unit does not rest; empty where it does.

        There is no rest from an unquiet slot until a quiet second is decided on, while a turn is more likely
        than a changed bias, or while known gyros are silent.  Within a slot the stage ends rest by samples.
        """
        if self.quiet.unrest:
            return self.quiet.unrest
        if not self.quiet.present[GYRO].all():
            return "a gyro is silent" if np.isfinite(self.quiet.unread[GYRO]).any() else ""
        if self.hypotheses is None or self.hypotheses.moved:
            return QUIET_TOO_SHORT
        return "a turn is more likely than a changed bias" if self.hypotheses.turning else ""

    def step(self, slot: Slot) -> FloatArray | float:
        """Take a slot; return normalised innovations, (3,), or NaN if it completes no measurement at rest."""
        innovation: FloatArray | float = np.nan
        degc_and_sd = slot.mean[DEGC].reshape(2, 3)
        self.degc_and_sd = np.where(np.isfinite(degc_and_sd[0]), degc_and_sd, self.degc_and_sd)
        self._widen(self.thermal.take_temperature(degc_and_sd[0], slot.mean[POWER_ON_SD], 0.0))
        self.quiet.update(slot, self.drift)
        if not self.quiet.present[GYRO].all():
            self.attitude.lost = True
            return innovation
        if self.quiet.quiet_slots == 0:
            self._coast(slot)
        elif self.hypotheses is None:
            self._begin(slot)
        else:
            if self.hypotheses.moved or self.hypotheses.turning:  # quiet, but it may be a steady turn
                self._turn_attitude(slot, self.hypotheses)
            self.pending.append(slot)
            if self.quiet.noise_changed:
                white = self._noise()[GYRO]  # as of a fan that starts
                self.hypotheses.replace_each(lambda bank: bank.with_white(white))
                self.pending = []
            elif self.quiet.is_rest and sum(one.length_s for one in self.pending) >= SECOND_S:
                innovation = self._decide(self.hypotheses)
        return np.nan if self.unrest else innovation

    def bridge_gap(self, degc: FloatArray, lag_degc: FloatArray, long: bool) -> None:
        """Widen the bias by a gap; a `long` one ends rest.

        Behind it `degc`, °C, (3,), is NaN where not known, and the lag has changed by `lag_degc`, °C (sd).
        """
        self.motion.interrupt(0.0)
        unseen = long and not self.parameters.assume_at_rest  # given rest does not turn
        self.attitude.lost |= unseen or self.quiet.quiet_slots == 0
        self.degc_and_sd[0] = np.where(np.isfinite(degc), degc, self.degc_and_sd[0])
        self._widen(self.thermal.take_temperature(degc, np.full(3, np.nan), lag_degc))
        if self.hypotheses is not None:
            self._widen(self.hypotheses.shown.prediction.slope_square * lag_degc**2)
        if long:
            self.quiet.restart()
            self._end_rest()

    def _widen(self, variance: FloatArray) -> None:
        """Let the bias have changed by an unknown amount of this variance, (rad/s)², (3,)."""
        if self.hypotheses is not None and variance.any():
            self.hypotheses.replace_each(lambda bank: bank.wider(variance))

    def _noise(self) -> FloatArray:
        """Return the variance of the mean of a second, (rad/s)² and (m/s²)², (6,)."""
        covered_s = sum(one.covered_s for one in self.quiet.latest) / len(self.quiet.latest)
        return np.maximum(self.quiet.noise * covered_s, LEAST_WHITE)  # of accelerometers: so that it is not 0

    def _accel_noise(self) -> float:
        """Return the variance of the mean force of a second, (m/s²)²; ∞ if any of 16 slots lacks it."""
        known = np.isfinite([one.mean[ACCEL] for one in self.quiet.latest]).all()
        return float(self._noise()[ACCEL].max()) if known else np.inf

    def _measurement(self, slots: Sequence[Slot]) -> Measurement:
        covered = np.array([one.covered_s for one in slots])
        covered_s = float(covered.sum())
        mean = covered / covered_s @ np.array([one.mean for one in slots])
        degc_and_sd = np.where(np.isfinite(mean[DEGC]), mean[DEGC], slots[-1].mean[DEGC])
        headings = np.array([one.mean[HEADING] for one in slots if np.isfinite(one.mean[HEADING]).all()])
        return Measurement(
            end_s=slots[-1].end_s,
            length_s=sum(one.length_s for one in slots),
            covered_s=covered_s,
            rate=mean[GYRO] - mean[MODELLED] - self.attitude.earth,
            force=np.where(np.isfinite(mean[ACCEL]), mean[ACCEL], self.force),
            degc_and_sd=degc_and_sd.reshape(2, 3),
            heading=headings.mean(0) if len(headings) else mean[HEADING],  # it may be missing in some slots
            rounding_sd=0.5 * self.quiet.rounding_error[GYRO],  # as is explained there
        )

    def _end_rest(self) -> None:
        """End a rest, if there is one: slots that may be motion are dropped, and a bias that is a turn."""
        if self.hypotheses is not None:
            self.hypotheses.move(undo=len(self.pending) < UNDO_SLOTS)
            if self.hypotheses.began_turning:
                self.hypotheses = None
        self.pending = []

    def _coast(self, slot: Slot) -> None:
        """Follow the turn of an unquiet slot; before the first rest estimate the bias from this turn."""
        self._end_rest()
        if self.hypotheses is not None:
            self._turn_attitude(slot, self.hypotheses)
        elif slot.gap_s or np.isnan(slot.mean[ACCEL]).any():
            self.motion.interrupt(slot.length_s + slot.gap_s)
        else:
            self.motion.take(slot.turn.less(slot.mean[MODELLED]), slot.mean[ACCEL])

    def _turn_attitude(self, slot: Slot, hypotheses: Hypotheses) -> None:
        """Add a slot to the turn since the attitude was taken."""
        bias, _ = hypotheses.shown.prediction.ahead_to(slot.end_s, self.degc_and_sd).bias(self.force)
        self.attitude.turn = self.attitude.turn.then(slot.turn.less(bias + slot.mean[MODELLED]))
        self.attitude.lost |= (slot.gap_s > 0.0 or slot.lacks_gyro) and not slot.rest_given

    def _come_to_rest(self, slots: Sequence[Slot], hypotheses: Hypotheses) -> None:
        """Take the attitude of a rest by the first of these slots whose force is known."""
        force = next((one.mean[ACCEL] for one in slots if np.isfinite(one.mean[ACCEL]).all()), np.zeros(3))
        prediction = hypotheses.shown.prediction.ahead_to(self.quiet.latest[-1].end_s, self.degc_and_sd)
        self._widen(self.attitude.come_to_rest(force, prediction))

    def _begin(self, slot: Slot) -> None:
        """Begin the filters with the quiet slots there are, a second at least."""
        self.motion.interrupt(slot.length_s + slot.gap_s)
        if not self.quiet.noise_slots or self.quiet.quiet_slots < SECOND_SLOTS:
            return
        slots = self.quiet.latest[-self.quiet.quiet_slots :]
        self.attitude.restart()
        self.attitude.come_to_rest(self.force, None)
        seconds = range(0, len(slots), SECOND_SLOTS)
        measurements = [self._measurement(slots[k : k + SECOND_SLOTS]) for k in seconds]
        if not np.isfinite([one.rate for one in measurements]).all():
            return
        first, *others = measurements  # the others count in σ² once more, which weighs little yet (its shape)
        bank = Bank.begin(self.parameters.declared_noise, self.slopes, self._noise()[GYRO], first)
        for now in others:
            bank = bank.after(now)
        given, hidden = self.parameters.assume_at_rest, np.zeros(3)
        if not given:
            parts = [self._measurement([slot]) for slot in slots]
            hidden = odds.hidden_turn(parts, self._accel_noise() / parts[0].covered_s)
        self.hypotheses = Hypotheses(bank, measurements, self.limits, given, hidden)

    def _decide(self, hypotheses: Hypotheses) -> FloatArray | float:
        """Decide on a complete measurement; return normalised innovations, (3,), or NaN without a rate."""
        slots, self.pending = self.pending, []
        if hypotheses.moved:
            self._come_to_rest(slots, hypotheses)
        now = self._measurement(slots)
        if not np.isfinite(now.rate).all():
            return np.nan
        innovation, variance = hypotheses.shown.prediction.innovation(now)
        parts = (self._measurement([slot]) for slot in slots)
        jumped = hypotheses.decide(now, parts, self._accel_noise())
        self.jumps += jumped
        if jumped:  # what seemed to be a turn was the bias
            self.attitude.turn = STILL
        if hypotheses.began_turning and hypotheses.changes:  # the turn that the recording began in is over
            self.quiet.restart()
            self._end_rest()
        elif self.attitude.turn.seconds and not hypotheses.turning:
            self._come_to_rest(slots[::-1], hypotheses)  # the latest first
        return innovation / np.sqrt(variance)

    def output(self, now_s: float) -> LinearBias:
        """Return the bias from a time on, its variance with the parts that `imumon.estimation.rest` lists."""
        if self.hypotheses is None:
            terms, covariance = np.zeros((3, 4)), np.zeros((3, 4, 4))
            terms[:, 0], variance = self.motion.bias
            any_pose = EARTH_RATE**2 + (SENSITIVITY_SD * STANDARD_GRAVITY) ** 2
            covariance[:, 0, 0] = variance + any_pose
            return LinearBias(terms, covariance, np.zeros(3), np.zeros(3))
        prediction = self.hypotheses.shown.prediction.ahead_to(now_s, self.degc_and_sd)
        before, latest = self.hypotheses.ambiguities  # a single measurement may fit by chance
        ambiguity = np.where(np.abs(before) > np.abs(latest), before, latest)
        # Rounding is added to it and not to the covariance, so that it is in the column of the turn as well.
        with_rounding = np.hypot(ambiguity, self.quiet.rounding_error[GYRO])
        added = self.attitude.uncertain_earth + self.hypotheses.hidden
        return prediction.output(added, self.force, np.copysign(with_rounding, ambiguity))
