"""What the mean of a quiet second is: the bias as before, a changed bias, or a turn.

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
    as_predicted,
    by_compass,
    by_gravity,
    first_was_turn,
    probability_of_turn,
)
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.slots import Second

FIT_SIGMAS = 4.5
"""Sigmas of an axis within which a mean fits; with 4, drifts of a warm-up contradicted the bias."""
RETURN_SIGMAS = 2.0
"""The same for a return to the nominal bias where the changed one fits as well."""
SPANS = (1, 4, 16)
"""Seconds whose means are compared."""
SETTLED_S = 16
"""Seconds of one rate before it may be rest again; with 3, the slow end of a turn was 30 sigma off."""
LIKELY_TURN = 0.75
"""Probability of a turn above which it is not rest again: with 1, the slow end of a turn was off by 62 sigma;
with 0.5, a tactical gyro was found at rest after one for 63 to 73 % of the time, not 92 %."""
CHANGE_LOG_RATIO = 12.0
"""Log likelihood ratio of a changed bias over a turn from which on the bias has changed."""
TURN_LOG_RATIO = 2.0
"""The same of a turn over a changed bias, from which on a mean that fits a wide prediction is no rest."""
LAG_S = 16.0
"""Age of the nominal prediction that is compared, at least; twice as much at most."""
ONSET_S = 4.0
"""A contradiction that motion follows sooner was how the motion began; a rate is as old when the first mean
of the recording is called in question."""
PATIENCE_S = 60.0
"""Where rest is given, rest at another rate for so long is rest with another bias."""
NEW_POSE = 0.3
"""m/s²: a specific force that differs by more from the first one is that of another pose."""
LEAST_SECONDS = 3
"""Least number of seconds over which gravity is compared."""


class Facts(NamedTuple):
    """The predicates of the table, and the probability of a turn while none is certain."""

    fits_nominal: bool
    """And gravity and compass show no turn, however wide the prediction is."""
    fits_changed: bool
    contradicted: bool
    settled: bool
    """Whether the last 16 s are of one rate: that of a turn which comes to its end goes on changing."""
    accepted: bool
    """Whether it does not turn: the bias has changed."""
    probability: float

    @property
    def likely_turn(self) -> bool:
        """Whether a turn is likely."""
        return self.probability > LIKELY_TURN


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Filters, as they are and as they were."""

    bank: Bank
    older: Bank
    newer: Bank
    """`older` is from once to twice the lag ago, `newer` is the next one to be compared."""

    @classmethod
    def of(cls, bank: Bank) -> Track:
        """Return a track that begins."""
        return cls(bank, bank, bank)

    def after(self, now: Second, lag_s: float) -> Track:
        """Return the track after a second at rest."""
        bank = self.bank.after(now)
        if now.end_s - self.newer.time_s < lag_s:
            return Track(bank, self.older, self.newer)
        return Track(bank, self.newer, bank)

    def changed(self, change: Callable[[Bank], Bank]) -> Track:
        """Return the track with another variance or noise."""
        return Track(change(self.bank), change(self.older), change(self.newer))


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
    probability: float = 0.0
    """That the present rate is a turn."""


@dataclass(slots=True, eq=False)
class Hypotheses:
    """Both hypotheses, and what is known about the choice between them."""

    nominal: Track
    """H0; compared as 16 to 32 s ago, and while it is contradicted as it was then."""
    undo: Track | None
    """Nominal before the last second, which is taken back where motion follows at once."""
    recent: list[Second]
    """Seconds of this rest, 16 at most."""
    alike: int
    """How many of them are of the present rate.  At the first contradiction it goes on, as the onset is not
    known; it begins anew when the rate changes once more."""
    first: FloatArray | None
    """Mean rate of the first rest, (3,); None once the unit has been in another pose."""
    pose: FloatArray
    """Specific force at the first rest, (3,)."""
    limits: RestParameters
    rest_given: bool
    changed: Changed | None = None
    moved: bool = False
    """Whether it has moved since the last second that was decided on."""

    @property
    def turning(self) -> bool:
        """Whether a turn is more likely than a changed bias."""
        return self.changed is not None and self.changed.probability > 0.5

    def decide(self, now: Second, slots: Sequence[Second], added: FloatArray, accel_noise: float) -> str:
        """Decide on a quiet second; return the name of the row.

        Parameters
        ----------
        slots : sequence of Second
            Of which the second consists; needed in the first seconds of a rest.
        added : array (3,)
            What has been added to the variance of the bias meanwhile, (rad/s)².
        accel_noise : float
            Variance of the mean force of a second, (m/s²)².
        """
        if added.any():
            self._change(lambda bank: bank.wider(added))
        if self.moved and np.linalg.norm(now.force - self.pose) > NEW_POSE:
            self.first = None  # it was in a hand, and not on a turntable
        if self.moved and self.changed is None:
            self.nominal = Track.of(self.nominal.bank)
        self.recent = [*self.recent[1 - SPANS[-1] :], now]
        self.alike = min(self.alike + 1, len(self.recent))
        facts = self._facts(now, slots, accel_noise)
        name, _, action = next(row for row in ROWS if row[1](facts))
        action(self, now)
        if self.changed is not None:
            self.changed.probability = facts.probability
        self.moved = False
        return name

    def _facts(self, now: Second, slots: Sequence[Second], accel_noise: float) -> Facts:
        prediction = self.nominal.older.prediction.at(now.end_s, now.degc)
        alike = self.recent[-self.alike :]
        changed, fits_changed, limits, sigmas = self.changed, False, prediction, FIT_SIGMAS
        if changed is not None:
            older = changed.track.older.prediction.at(now.end_s, now.degc)
            # The first of this rate were before it began, as the onset is not known.
            learned = alike[-max(int(changed.fits_s), 1) - 1 :]
            fits_changed, _ = _fit(FIT_SIGMAS, older, learned)
            if fits_changed:
                limits, sigmas = replace(prediction, covariance=changed.at_onset.covariance), RETURN_SIGMAS
        fits, difference = _fit(sigmas, limits, alike)
        facts = Facts(fits, fits_changed, changed is not None, self.alike >= SETTLED_S, False, 0.0)
        # In the first seconds of a rest a wide prediction fits a turn as well.
        if fits and changed is None and len(self.recent) > SPANS[1]:
            return facts
        if self.rest_given:
            impatient = changed is not None and changed.fits_s > PATIENCE_S
            return facts._replace(accepted=impatient, probability=0.5)
        if fits and self.alike >= LEAST_SECONDS:
            seconds: Sequence[Second] = alike
        else:  # the rate may just have changed
            seconds = self.recent if len(self.recent) >= LEAST_SECONDS else slots
        return self._weigh(facts, prediction, difference, seconds, accel_noise)

    def _weigh(
        self,
        facts: Facts,
        prediction: Prediction,
        change: FloatArray,
        seconds: Sequence[Second],
        accel_noise: float,
    ) -> Facts:
        """Weigh a turn against a changed bias: a rate that differs by `change`, rad/s, (3,)."""
        now, limits = self.recent[-1], self.limits
        bias, variance = prediction.bias(now.force, of_mean=True)
        largest, noise = float(variance.max()), accel_noise / seconds[0].seconds
        ratio = by_gravity(seconds, bias, change, largest, noise, limits.accel_drift)
        ratio += by_compass(seconds, bias)
        others, fits_s, changes = as_predicted(change, variance), 0.0, 0
        if self.changed is not None:
            fits_s, changes = self.changed.fits_s, self.changed.changes
        if self.first is not None and fits_s >= ONSET_S:
            others += first_was_turn(self.first, now.rate)
        steady = fits_s > limits.undecided_s and math.sqrt(change @ change) <= limits.largest_jump
        turns = ratio < -TURN_LOG_RATIO
        return facts._replace(
            fits_nominal=facts.fits_nominal and not turns,
            accepted=ratio > CHANGE_LOG_RATIO or (steady and not turns),
            probability=probability_of_turn(change, ratio, others, limits.largest_jump, changes),
        )

    def learn(self, now: Second) -> None:
        """H0 holds, or holds again: nominal learns."""
        anew = self.moved or self.changed is not None
        self.undo, self.nominal, self.changed = self.nominal, self.nominal.after(now, LAG_S), None
        if anew:
            self.nominal = Track.of(self.nominal.bank)

    def accept(self, now: Second) -> None:
        """H1 holds: the changed bias becomes the nominal one."""
        assert self.changed is not None
        self.nominal, self.first = self.changed.track, None
        self.learn(now)

    def go_on(self, now: Second) -> None:
        """The rate is the same since it changed; H1 or a turn is not decided."""
        assert self.changed is not None
        self.changed.track = self.changed.track.after(now, ONSET_S)
        self.changed.fits_s += now.seconds

    def begin(self, now: Second) -> None:
        """The rate is another: H1 begins, or begins anew with what it has learned of the noise."""
        bank, before, changes = self.nominal.older, self.changed, 0
        at_onset = bank.prediction.at(now.end_s, now.degc)
        if before is None:
            self.nominal, self.undo = Track.of(bank), None
        else:
            changes, self.alike = before.changes + 1, 1
            bank = bank.with_noise_of(before.track.bank)
        track = Track.of(bank.after(now, jumped=True))
        self.changed = Changed(track, at_onset, now.seconds, changes)

    def move(self, undo: bool) -> None:
        """Note that the unit moves: a contradiction of a few seconds was how the motion began.

        Parameters
        ----------
        undo : bool
            Whether the last second is taken back: what moves the unit may begin before it is noticed.
        """
        if undo and self.undo is not None:
            self.nominal = self.undo
        self.undo = None
        changed = self.changed
        if changed is not None and changed.changes == 0 and changed.fits_s < ONSET_S:
            self.changed = None
        self.moved, self.recent, self.alike = True, [], 0

    def _change(self, change: Callable[[Bank], Bank]) -> None:
        """Give all filters another variance or noise."""
        self.nominal = self.nominal.changed(change)
        self.undo = None if self.undo is None else self.undo.changed(change)
        if self.changed is not None:
            self.changed.track = self.changed.track.changed(change)

    def restart_noise(self, white: FloatArray) -> None:
        """Take another white noise of a second, (3,), as of a fan that starts."""
        self._change(lambda bank: bank.with_white(white))

    def prediction(self, now_s: float, degc: FloatArray, force: FloatArray) -> tuple[Prediction, FloatArray]:
        """Return the more likely prediction at a time, and what the other adds to sigma, rad/s, (3,)."""
        nominal = self.nominal.bank.prediction.at(now_s, degc)
        if self.changed is None:
            return nominal, np.zeros(3)
        changed, probability = self.changed.track.bank.prediction.at(now_s, degc), self.changed.probability
        bias, variance = changed.bias(force)
        nominal_bias, nominal_variance = nominal.bias(force)
        difference = bias - nominal_bias
        if self.turning:
            return nominal, math.sqrt(1.0 - probability) * difference
        # The variance of the mixture: that of the nominal bias, which may be vague by then, counts as well.
        excess = np.maximum(nominal_variance - variance, 0.0)
        return changed, np.copysign(np.sqrt(probability * (difference**2 + excess)), difference)


CHANGED_BIAS = "changed bias"
ROWS: tuple[tuple[str, Callable[[Facts], bool], Callable[[Hypotheses, Second], None]], ...] = (
    ("rest", lambda f: f.fits_nominal and not f.contradicted, Hypotheses.learn),
    ("rest again", lambda f: f.fits_nominal and f.settled and not f.likely_turn, Hypotheses.learn),
    (CHANGED_BIAS, lambda f: f.fits_changed and f.accepted, Hypotheses.accept),
    ("undecided", lambda f: f.fits_changed, Hypotheses.go_on),
    ("another rate", lambda _: True, Hypotheses.begin),
)
"""Name, condition and action; the first that holds.  In the last two the probability of a turn sets which
bias is shown, and whether it is rest."""


def begun(bank: Bank, seconds: Sequence[Second], limits: RestParameters, rest_given: bool) -> Hypotheses:
    """Return the hypotheses after the first seconds at rest, by filters that know nothing of the bias."""
    for now in seconds:
        bank = bank.after(now)
    first = np.mean([one.rate for one in seconds], axis=0)
    return Hypotheses(
        Track.of(bank), None, list(seconds), len(seconds), first, seconds[0].force, limits, rest_given
    )


def _fit(sigmas: float, prediction: Prediction, recent: Sequence[Second]) -> tuple[bool, FloatArray]:
    """Compare the means of the last seconds with a prediction; the difference is that of up to 4 s."""
    force = recent[-1].force
    bias, of_second = prediction.bias(force)
    _, of_mean = prediction.bias(force, of_mean=True)
    fits, difference = True, np.zeros(3)
    for span in SPANS:
        part = recent[-span:]
        if len(part) < span > SPANS[1]:
            break
        seconds = sum(one.seconds for one in part)
        off = sum((one.seconds * one.rate for one in part), np.zeros(3)) / seconds - bias
        spread = (of_second if len(part) == 1 else of_mean) + prediction.white / seconds
        fits &= bool((off * off <= sigmas**2 * spread).all())
        if span <= SPANS[1]:
            difference = off
    return fits, difference
