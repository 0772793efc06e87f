"""The mean rate of a quiet second: the bias as before, a changed bias, or a turn?

Two sets of filters stand for two hypotheses: the *nominal* bias was known before the present rate began, and
the *present* one has learned that rate.  What lies between both may be a turn; of that the probability is
P(turn), by `imumon.estimation.rest.odds`.  The first row that holds:

=================================  =====================================================
the mean fits the present bias     it learns
it fits the nominal bias           the present bias is the nominal one, and learns
else                               the present bias is any other
=================================  =====================================================

While a turn is unlikely, the nominal bias follows 16 to 32 s behind, so it has not learned the beginning of a
slow turn.  Else it stays, and the sigma contains the turn until it is excluded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
DOUBT, UNLIKELY_TURN = 0.25, 0.05
"""Probability of a turn from which on the nominal bias stays, and up to which it then follows again."""
TURN_LOG_RATIO = 2.0
"""Log likelihood ratio of a turn over a changed bias, from which on time does not exclude a turn."""
LAG_S = 16.0
"""By so much at least, and twice as much at most, the nominal bias follows the present one."""
ONSET_S = 4.0
"""A change that motion follows sooner was its onset; an older one may end a turn in the first rest."""
PATIENCE_S = 60.0
"""Where rest is given, rest at another rate for so long is rest with another bias."""
NEW_POSE = 0.3
"""m/s²: a specific force that differs by more from the first one is that of another pose."""
RECENT = 16
"""Measurements of a rest that are kept: those that gravity and compass are compared over."""


@dataclass(slots=True, eq=False)
class Hypotheses:
    """Both hypotheses, and the evidence between them; rates in rad/s."""

    present: Bank
    nominal: Bank
    newer: Bank
    """The next nominal one."""
    recent: list[Measurement]
    """Of this rest, `RECENT` at most; none in motion."""
    first_rate: FloatArray | None
    """Mean of the first rest, (3,); None once the unit has been in another pose."""
    first_force: FloatArray
    """Specific force at the first rest, m/s², (3,)."""
    limits: RestParameters
    rest_given: bool
    undo: Bank | None = None
    """The present filters before the last second, which is taken back where motion follows at once."""
    changes: int = 0
    """How often the rate has changed since it fitted the nominal bias."""
    alike: int = 0
    """How many of the recent measurements are of the present rate."""
    steady_s: float = 0.0
    """How long the present rate has lasted, s."""
    p_turn: float = 0.0
    """Probability that what lies between both is a turn."""
    doubted: bool = False
    """Whether the nominal bias stays, as the present rate may be a turn."""

    @property
    def moved(self) -> bool:
        """Whether the unit has moved since the last measurement."""
        return not self.recent

    @property
    def turning(self) -> bool:
        """Whether a turn is more likely than a changed bias."""
        return self.p_turn > 0.5

    @property
    def shown(self) -> Bank:
        """The filters of the more likely hypothesis."""
        return self.nominal if self.turning else self.present

    def decide(
        self, now: Measurement, parts: Sequence[Measurement], added: FloatArray, accel_noise: float
    ) -> bool:
        """Take a measurement; return whether a changed bias has become the nominal one.

        `parts` are its slots one by one, needed in the first seconds of a rest.  `added` is the variance by
        which the bias may have changed since the one before, (rad/s)², (3,).  `accel_noise` is the variance
        of the mean force of a second, (m/s²)².
        """
        if added.any():
            self.map(lambda bank: bank.wider(added))
        if self.moved and np.linalg.norm(now.force - self.first_force) > NEW_POSE:
            self.first_rate = None  # it was in a hand, and not on a turntable
        if self.moved and not self.doubted:
            self.nominal = self.newer = self.present
        self.recent = [*self.recent[1 - RECENT :], now]
        self._learn(now)
        self.p_turn = self._probability_of_turn(now, parts, accel_noise)
        return self._follow(now)

    def _learn(self, now: Measurement) -> None:
        """Update the present bias."""
        self.undo = None
        if _fits(self.newer, now):
            self.undo, self.present = self.present, self.present.after(now)
            self.steady_s += now.covered_s
            self.alike = min(self.alike + 1, len(self.recent))
            return
        if _fits(self.nominal, now):
            self.present, self.changes = self.nominal.after(now), 0
        else:
            any_bias = self.nominal.with_noise_of(self.present)
            self.present, self.changes = any_bias.after(now, jumped=True), self.changes + 1
        self.newer, self.steady_s, self.alike = self.present, now.covered_s, 1

    def _follow(self, now: Measurement) -> bool:
        """Let the nominal bias follow if a turn is unlikely; return whether it has changed."""
        self.doubted = self.p_turn > (UNLIKELY_TURN if self.doubted else DOUBT)
        if self.doubted:
            self.nominal = self.nominal.with_noise_of(self.present)
        elif self.changes and self.steady_s > LAG_S:
            self.nominal = self.newer = self.present
            self.changes, self.first_rate = 0, None
            return True
        if now.end_s - self.newer.time_s >= LAG_S:
            if not (self.doubted or self.changes):
                self.nominal = self.newer
            self.newer = self.present
        return False

    def _probability_of_turn(
        self, now: Measurement, parts: Sequence[Measurement], accel_noise: float
    ) -> float:
        """Return the probability of a turn that is not in the nominal bias."""
        if self.rest_given:
            return 0.5 if self.changes and self.steady_s <= PATIENCE_S else 0.0
        evidence: Sequence[Measurement] = self.recent[-self.alike :]
        if self.alike < LEAST_MEASUREMENTS:  # the rate may just have changed
            evidence = self.recent if len(self.recent) >= LEAST_MEASUREMENTS else parts
        nominal = self.nominal.prediction.at(now.end_s, now.degc)
        bias, variance = nominal.bias(now.force, of_mean=True)
        present, own = self.present.prediction.bias(now.force, of_mean=True)
        change, limits = present - bias, self.limits
        largest, noise = float(variance.max()), accel_noise / evidence[0].covered_s
        ratio = gravity_log_ratio(evidence, bias, change, largest, noise, limits.accel_drift)
        ratio += compass_log_ratio(evidence, bias)
        others = nominal_odds(change, variance + own)
        if self.first_rate is not None and self.changes and self.steady_s >= ONSET_S:
            others += first_turn_odds(self.first_rate, now.rate)
        within = math.sqrt(change @ change) <= limits.largest_jump
        if self.steady_s > limits.undecided_s and within and ratio >= -TURN_LOG_RATIO:
            return 0.0
        before = max(self.changes - 1, 0)
        return probability_of_turn(change, ratio, others, limits.largest_jump, before)

    def move(self, undo: bool) -> None:
        """Coast while the unit moves: a change of a few seconds was how the motion began.

        With `undo` the last measurement is taken back: motion may begin before it is detected.
        """
        if undo and self.undo is not None:
            self.present = self.undo
        self.undo = None
        if self.changes == 1 and self.steady_s < ONSET_S:
            self.present, self.changes, self.doubted = self.nominal, 0, False
        if not self.doubted:
            self.p_turn = 0.0
        self.recent, self.alike = [], 0

    def map(self, function: Callable[[Bank], Bank]) -> None:
        """Apply a function to all filters."""
        self.present, self.nominal, self.newer = map(function, (self.present, self.nominal, self.newer))
        self.undo = None if self.undo is None else function(self.undo)

    def prediction(self, now_s: float, degc: FloatArray, force: FloatArray) -> tuple[Prediction, FloatArray]:
        """Return the more likely prediction at a time, and what the other adds to sigma, rad/s, (3,)."""
        present, nominal = (one.prediction.at(now_s, degc) for one in (self.present, self.nominal))
        (bias, variance), (before, vague) = present.bias(force), nominal.bias(force)
        difference = bias - before
        if self.turning:
            return nominal, math.sqrt(1.0 - self.p_turn) * difference
        # The variance of the mixture: that of the nominal bias, which may be vague by then, counts as well.
        excess = np.maximum(vague - variance, 0.0)
        return present, np.copysign(np.sqrt(self.p_turn * (difference**2 + excess)), difference)


def begun(
    bank: Bank, measurements: Sequence[Measurement], limits: RestParameters, rest_given: bool
) -> Hypotheses:
    """Return the hypotheses after the first measurements, by filters that know nothing of the bias."""
    for now in measurements:
        bank = bank.after(now)
    rate, force = np.mean([one.rate for one in measurements], axis=0), measurements[0].force
    return Hypotheses(bank, bank, bank, list(measurements), rate, force, limits, rest_given)


def _fits(bank: Bank, now: Measurement) -> bool:
    """Return whether a mean fits the prediction of filters in each axis."""
    prediction = bank.prediction.at(now.end_s, now.degc)
    bias, variance = prediction.bias(now.force)
    variance = variance + prediction.white / now.covered_s
    return bool(((now.rate - bias) ** 2 <= FIT_SIGMAS**2 * variance).all())
