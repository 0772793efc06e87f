"""The mean rate of a quiet second: the bias as before, a changed bias, or a turn?

Two hypotheses of the bias are filtered side by side: H0, *nominal*, the bias as predicted, which learns
while no mean contradicts it, and H1, *changed*, a bias that is another since a mean did.  A mean fits one of
them if the means of the last 1, 4 and 16 s lie within `FIT_SIGMAS` of its prediction on each axis.  Nominal
is compared as it was 16 to 32 s ago, when it had not learned the beginning of a slow turn.  `ROWS` is the
decision, first match; the docs print the same table.  Between H1 and a turn decide gravity, a compass, the
first mean and time (`imumon.estimation.rest.odds`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.bank import Bank
from imumon.estimation.gyro_bias.prediction import Prediction
from imumon.estimation.rest.odds import (
    LEAST_MEASUREMENTS,
    compass_log_ratio,
    first_turn_odds,
    gravity_log_ratio,
    nominal_odds,
    probability_of_turn,
)
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.slots import Measurement

FIT_SIGMAS = 4.5
"""Sigmas of an axis within which a mean fits; with 4, drifts of a warm-up contradicted the bias."""
RETURN_SIGMAS = 2.0
"""The same for a return to the nominal bias where the changed one fits as well."""
SPANS = (1, 4, 16)
"""Seconds whose means are compared."""
SETTLED_S = 16
"""Seconds of one rate before it may be rest again; with 3, the slow end of a turn was 30 sigma off."""
LIKELY_TURN = 0.75
"""Probability of a turn above which it is not rest again; with 0.5, a tactical gyro rested 63 %, not 92 %."""
CHANGE_LOG_RATIO = 12.0
"""Log likelihood ratio of a changed bias over a turn from which on the bias has changed."""
TURN_LOG_RATIO = 2.0
"""The same of a turn over a changed bias, from which on a mean that fits a wide prediction is no rest."""
LAG_S = 16.0
"""Age of the nominal prediction that is compared, at least; twice as much at most."""
ONSET_S = 4.0
"""A contradiction that motion follows sooner was its onset; one as old may be of a turn in the first rest."""
PATIENCE_S = 60.0
"""Where rest is given, rest at another rate for so long is rest with another bias."""
NEW_POSE = 0.3
"""m/s²: a specific force that differs by more from the first one is that of another pose."""


class Facts(NamedTuple):
    """The predicates of the table."""

    fits_nominal: bool
    """And gravity and compass show no turn, however wide the prediction is."""
    fits_changed: bool
    contradicted: bool
    """Whether a mean has contradicted the nominal bias, so that H1 exists."""
    settled: bool
    """Whether the last 16 s are of one rate: that of a turn which comes to its end goes on changing."""
    no_turn: bool = False
    """Whether gravity, a compass or time has excluded a turn."""
    p_turn: float = 0.0
    """Probability that the rate is a turn; 0 where that has not been weighed."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Filters of one hypothesis, as they are and as they were."""

    bank: Bank
    older: Bank
    """From once to twice the lag ago: a mean is compared with its prediction."""
    newer: Bank
    """The next `older`."""

    @classmethod
    def of(cls, bank: Bank) -> Track:
        """Return a track without a past."""
        return cls(bank, bank, bank)

    def after(self, now: Measurement, lag_s: float) -> Track:
        """Return the track updated with a measurement."""
        bank = self.bank.after(now)
        if now.end_s - self.newer.time_s < lag_s:
            return Track(bank, self.older, self.newer)
        return Track(bank, self.newer, bank)

    def map(self, function: Callable[[Bank], Bank]) -> Track:
        """Return the track with a function applied to all its filters."""
        return Track(function(self.bank), function(self.older), function(self.newer))


@dataclass(slots=True, eq=False)
class Changed:
    """H1, since the rate contradicts the nominal bias."""

    track: Track
    """Compared as 4 to 8 s ago: a rate that drifts on does not fit it."""
    at_onset: Prediction
    """Of nominal, when this rate began: as time goes on it becomes vague, and would fit a steady turn."""
    fits_s: float
    """How long this rate has lasted, s."""
    changes: int
    """How often the rate has changed since the nominal bias was contradicted."""
    p_turn: float = 0.0
    """Probability that the rate is a turn; 0 where that has not been weighed."""


@dataclass(slots=True, eq=False)
class Hypotheses:
    """Both hypotheses, and the evidence between them; rates in rad/s."""

    nominal: Track
    """H0; compared as 16 to 32 s ago, and while it is contradicted as it was then."""
    undo: Track | None
    """Nominal before the last second, which is taken back where motion follows at once."""
    recent: list[Measurement]
    """Of this rest, 16 at most; none in motion."""
    alike: int
    """How many of them are of the present rate.  At the first contradiction it goes on, as the onset is not
    known; it begins anew when the rate changes once more."""
    first_rate: FloatArray | None
    """Mean of the first rest, (3,); None once the unit has been in another pose."""
    first_force: FloatArray
    """Specific force at the first rest, m/s², (3,)."""
    limits: RestParameters
    rest_given: bool
    changed: Changed | None = None

    @property
    def moved(self) -> bool:
        """Whether the unit has moved since the last measurement."""
        return not self.recent

    @property
    def turning(self) -> bool:
        """Whether a turn is more likely than a changed bias."""
        return self.changed is not None and self.changed.p_turn > 0.5

    def decide(
        self, now: Measurement, parts: Sequence[Measurement], added: FloatArray, accel_noise: float
    ) -> str:
        """Decide on a measurement by `ROWS`; return the name of the row.

        `parts` are its slots one by one, needed in the first seconds of a rest.  `added` is the variance by
        which the bias may have changed since the one before, (rad/s)², (3,).  `accel_noise` is the variance
        of the mean force of a second, (m/s²)².
        """
        if added.any():
            self.map(lambda bank: bank.wider(added))
        if self.moved and np.linalg.norm(now.force - self.first_force) > NEW_POSE:
            self.first_rate = None  # it was in a hand, and not on a turntable
        if self.moved and self.changed is None:
            self.nominal = Track.of(self.nominal.bank)
        self.recent = [*self.recent[1 - SPANS[-1] :], now]
        self.alike = min(self.alike + 1, len(self.recent))
        facts = self._facts(now, parts, accel_noise)
        name, _, action = next(row for row in ROWS if row[1](facts))
        action(self, now)
        if self.changed is not None:
            self.changed.p_turn = facts.p_turn
        return name

    def _facts(self, now: Measurement, parts: Sequence[Measurement], accel_noise: float) -> Facts:
        prediction = self.nominal.older.prediction.at(now.end_s, now.degc)
        alike = self.recent[-self.alike :]
        changed, fits_changed, limits, sigmas = self.changed, False, prediction, FIT_SIGMAS
        if changed is not None:
            older = changed.track.older.prediction.at(now.end_s, now.degc)
            # The first of this rate were before it began, as the onset is not known.
            fits_changed, _ = _fit(FIT_SIGMAS, older, alike[-max(int(changed.fits_s), 1) - 1 :])
            if fits_changed:
                limits, sigmas = replace(prediction, covariance=changed.at_onset.covariance), RETURN_SIGMAS
        fits, change = _fit(sigmas, limits, alike)
        facts = Facts(fits, fits_changed, changed is not None, self.alike >= SETTLED_S)
        # In the first seconds of a rest a wide prediction fits a turn as well.
        if fits and changed is None and len(self.recent) > SPANS[1]:
            return facts
        if self.rest_given:
            impatient = changed is not None and changed.fits_s > PATIENCE_S
            return facts._replace(no_turn=impatient, p_turn=0.5)
        evidence: Sequence[Measurement] = alike
        if not fits or self.alike < LEAST_MEASUREMENTS:  # the rate may just have changed
            evidence = self.recent if len(self.recent) >= LEAST_MEASUREMENTS else parts
        return self._weigh(facts, prediction, change, evidence, accel_noise)

    def _weigh(
        self,
        facts: Facts,
        prediction: Prediction,
        change: FloatArray,
        evidence: Sequence[Measurement],
        accel_noise: float,
    ) -> Facts:
        """Weigh a turn against a bias that has changed by `change`, rad/s, (3,)."""
        now, limits, changed = self.recent[-1], self.limits, self.changed
        bias, variance = prediction.bias(now.force, of_mean=True)
        largest, noise = float(variance.max()), accel_noise / evidence[0].covered_s
        ratio = gravity_log_ratio(evidence, bias, change, largest, noise, limits.accel_drift)
        ratio += compass_log_ratio(evidence, bias)
        others = nominal_odds(change, variance)
        fits_s, changes = (0.0, 0) if changed is None else (changed.fits_s, changed.changes)
        if self.first_rate is not None and fits_s >= ONSET_S:
            others += first_turn_odds(self.first_rate, now.rate)
        steady = fits_s > limits.undecided_s and math.sqrt(change @ change) <= limits.largest_jump
        turns = ratio < -TURN_LOG_RATIO
        return facts._replace(
            fits_nominal=facts.fits_nominal and not turns,
            no_turn=ratio > CHANGE_LOG_RATIO or (steady and not turns),
            p_turn=probability_of_turn(change, ratio, others, limits.largest_jump, changes),
        )

    def learn(self, now: Measurement) -> None:
        """H0 holds, or holds again: nominal learns."""
        anew = len(self.recent) == 1 or self.changed is not None
        self.undo, self.nominal, self.changed = self.nominal, self.nominal.after(now, LAG_S), None
        if anew:
            self.nominal = Track.of(self.nominal.bank)

    def accept(self, now: Measurement) -> None:
        """H1 holds: the changed bias becomes the nominal one."""
        assert self.changed is not None
        self.nominal, self.first_rate = self.changed.track, None
        self.learn(now)

    def go_on(self, now: Measurement) -> None:
        """The rate is the same since it changed; H1 or a turn is not decided."""
        assert self.changed is not None
        self.changed.track = self.changed.track.after(now, ONSET_S)
        self.changed.fits_s += now.covered_s

    def begin(self, now: Measurement) -> None:
        """The rate is another: H1 begins, or begins anew with what it has learned of the noise."""
        bank, before, changes = self.nominal.older, self.changed, 0
        at_onset = bank.prediction.at(now.end_s, now.degc)
        if before is None:
            self.nominal, self.undo = Track.of(bank), None
        else:
            changes, self.alike = before.changes + 1, 1
            bank = bank.with_noise_of(before.track.bank)
        track = Track.of(bank.after(now, jumped=True))
        self.changed = Changed(track, at_onset, now.covered_s, changes)

    def move(self, undo: bool) -> None:
        """Coast while the unit moves: a contradiction of a few seconds was how the motion began.

        With `undo` the last measurement is taken back: motion may begin before it is detected.
        """
        if undo and self.undo is not None:
            self.nominal = self.undo
        self.undo = None
        if self.changed is not None and self.changed.changes == 0 and self.changed.fits_s < ONSET_S:
            self.changed = None
        self.recent, self.alike = [], 0

    def map(self, function: Callable[[Bank], Bank]) -> None:
        """Apply a function to the filters of both hypotheses."""
        self.nominal = self.nominal.map(function)
        self.undo = None if self.undo is None else self.undo.map(function)
        if self.changed is not None:
            self.changed.track = self.changed.track.map(function)

    def prediction(self, now_s: float, degc: FloatArray, force: FloatArray) -> tuple[Prediction, FloatArray]:
        """Return the more likely prediction at a time, and what the other adds to sigma, rad/s, (3,)."""
        nominal = self.nominal.bank.prediction.at(now_s, degc)
        if self.changed is None:
            return nominal, np.zeros(3)
        changed = self.changed.track.bank.prediction.at(now_s, degc)
        bias, variance = changed.bias(force)
        nominal_bias, nominal_variance = nominal.bias(force)
        difference = bias - nominal_bias
        if self.turning:
            return nominal, math.sqrt(1.0 - self.changed.p_turn) * difference
        # The variance of the mixture: that of the nominal bias, which may be vague by then, counts as well.
        excess = np.maximum(nominal_variance - variance, 0.0)
        return changed, np.copysign(np.sqrt(self.changed.p_turn * (difference**2 + excess)), difference)


CHANGED_BIAS = "changed bias"
ROWS: tuple[tuple[str, Callable[[Facts], bool], Callable[[Hypotheses, Measurement], None]], ...] = (
    ("rest", lambda f: f.fits_nominal and not f.contradicted, Hypotheses.learn),
    ("rest again", lambda f: f.fits_nominal and f.settled and f.p_turn <= LIKELY_TURN, Hypotheses.learn),
    (CHANGED_BIAS, lambda f: f.fits_changed and f.no_turn, Hypotheses.accept),
    ("undecided", lambda f: f.fits_changed, Hypotheses.go_on),
    ("another rate", lambda _: True, Hypotheses.begin),
)
"""Name, condition and action; the first that holds.  In the last two the probability of a turn sets which
bias is shown, and whether it is rest."""


def begun(
    bank: Bank, measurements: Sequence[Measurement], limits: RestParameters, rest_given: bool
) -> Hypotheses:
    """Return the hypotheses after the first measurements, by filters that know nothing of the bias."""
    for now in measurements:
        bank = bank.after(now)
    rate, force = np.mean([one.rate for one in measurements], axis=0), measurements[0].force
    recent = list(measurements)
    return Hypotheses(Track.of(bank), None, recent, len(recent), rate, force, limits, rest_given)


def _fit(sigmas: float, prediction: Prediction, recent: Sequence[Measurement]) -> tuple[bool, FloatArray]:
    """Return whether the means over `SPANS` fit a prediction, and by how much that of 4 s differs, rad/s."""
    force = recent[-1].force
    bias, of_second = prediction.bias(force)
    _, of_mean = prediction.bias(force, of_mean=True)
    fits, difference = True, np.zeros(3)
    for span in SPANS:
        part = recent[-span:]
        if len(part) < span > SPANS[1]:
            break
        seconds = sum(one.covered_s for one in part)
        off = sum((one.covered_s * one.rate for one in part), np.zeros(3)) / seconds - bias
        spread = (of_second if len(part) == 1 else of_mean) + prediction.white / seconds
        fits &= bool((off * off <= sigmas**2 * spread).all())
        if span <= SPANS[1]:
            difference = off
    return fits, difference
