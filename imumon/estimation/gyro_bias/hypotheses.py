"""The mean rate of a quiet second: the bias as before, a changed bias, or a turn?

Of three copies of the filters the *present* one has learned everything up to now, the *test copy* up to 16 s
ago, the *nominal* one up to 16 to 32 s ago or a change that may be a turn.  The first row that holds decides:

=================  =================================  ================================================
the mean fits      that is                            what follows
=================  =================================  ================================================
the test copy      the rate is as before              the present bias learns; so it may creep
the nominal bias   the turn, or the change, is over   the present bias is the nominal one, and learns
neither            the rate has changed               the present bias may be any, and learns the mean
=================  =================================  ================================================

The present less the nominal bias is a turn with a probability P(turn), by `imumon.estimation.rest.odds`.  Up
to 1/2 it is rest, and the present bias is reported; above it is a turn, and the nominal one is.  The sigma of
the reported one contains the difference, times the root of the probability of the other.

What becomes of the nominal bias:

====================  ================================================  =====================================
event                 first row that holds                              the nominal bias
====================  ================================================  =====================================
rest, `_begin_rest`   the last rate was no turn (not `doubted`)         becomes the present one
a mean, `_follow`     `doubted`: P(turn) above 1/4 (1/10 if the rate    stays
                      has changed), until below 1/20
a mean                the rate has changed up to 16 s ago               stays
a mean                the rate has changed before that                  becomes the present one: a jump
a mean                else                                              becomes that of 16 to 32 s ago
motion, `move`        the rate has changed once, up to 4 s ago          replaces the present one: an onset
====================  ================================================  =====================================

In the first rest both biases may contain the same turn, which P(turn) cannot show.  If the heading turns as
it would without any bias, the recording began in a turn (`began_turning`): it is no rest, and the whole rate
is in sigma.  Another rate or motion ends it: then `Estimator` drops these hypotheses and begins anew.
"""

import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.rest import odds
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.slots import Measurement

from .bank import Bank

FIT_SIGMAS = 4.5  # of an axis, within which a mean fits; with 4, drifts of a warm-up contradicted the bias
# P(turn) above which the nominal bias stays while the rate creeps, as the bias of a unit that warms up;
# above which it stays where the rate has changed: by the gyros alone a turn of 36 °/h, the slowest, has 0.14;
# and up to which it then follows again.
DOUBT, DOUBT_OF_CHANGE, UNLIKELY_TURN = 0.25, 0.1, 0.05
EVEN = 0.5  # P(turn) up to which it is rest, and the present bias is reported; of a new rate in given rest
LAG_S = 16.0  # by so much at least, and twice as much at most, the nominal bias lags behind the present one
ONSET_S = 4.0  # a younger change is the onset of a motion; an older one may end a first turn.  Assumed.
NEW_POSE = 0.3  # m/s²: a specific force that differs more from the first one is of another pose.  Assumed.
BEGAN_LOG_RATIO = -8.0  # ln Λ by the heading up to which the recording began in a turn.  Assumed.
UNDECIDED_GIVEN_S = 60.0  # if rest is given, a new rate is bias at once; the difference is in sigma so long
RECENT = 16  # measurements of a rate that are kept: those that gravity and heading are compared over


class Hypotheses:
    """Present and nominal bias, and whether their difference is a turn; rates in rad/s.

    They begin with the filters after the `recent` measurements of the first rest, in which a turn of variance
    `hidden`, (rad/s)², (3,), may hide.  Where rest is `given`, a new rate is bias at once.
    """

    def __init__(
        self, bank: Bank, recent: list[Measurement], limits: RestParameters, given: bool, hidden: FloatArray
    ) -> None:
        self.limits, self.rest_given = limits, given
        self.recent = recent  # measurements of this rest, `RECENT` at most; none in motion
        self.first: Measurement | None = recent[0]  # till another pose or bias, as this one may be a turn
        self.present = self.nominal = self.test_copy = bank  # the test copy is the next nominal bias, too
        self.undo: Bank | None = None  # the present filters before the last second, for motion that follows
        self.changes = 0  # how often the rate has changed since it fitted the nominal bias
        self.steady_s = 0.0  # how long the present rate has lasted; whole seconds are compared with `LAG_S`
        self.steady_count = 0  # how many of the recent measurements are of the present rate
        self.p_turn = 0.0  # probability that the difference of both biases is a turn
        # What the less likely hypothesis adds to sigma, rad/s, by the last two measurements.
        self.ambiguities = np.zeros((2, 3))
        self.doubted = False  # whether the nominal bias stays, as the present rate may be a turn
        self.began_turning = False  # whether the recording did, by the heading
        self.hidden = hidden  # zero after the first rest: `move` gives it to the filters

    @property
    def moved(self) -> bool:
        """Whether the unit has moved since the last measurement."""
        return not self.recent

    @property
    def turning(self) -> bool:
        """Whether a turn is more likely than a changed bias."""
        return self.p_turn > EVEN or self.began_turning

    @property
    def shown(self) -> Bank:
        """The filters of the more likely hypothesis."""
        return self.nominal if self.turning else self.present

    def decide(self, now: Measurement, parts: Iterable[Measurement], accel_noise: float) -> bool:
        """Take a measurement; return whether a changed bias has become the nominal one.

        `parts` are its slots one by one: in the first seconds of a rest they show a tilt.  `accel_noise` is
        the variance of the mean force of a second, (m/s²)².
        """
        if self.moved:
            self._begin_rest(now)
        self.recent = [*self.recent[1 - RECENT :], now]
        self._learn(now)
        evidence = self.recent[-self.steady_count :]
        # Too few to show a tilt: then from before the change on, as angles are summed, or slot by slot.
        if self.steady_count < odds.LEAST_MEASUREMENTS:
            evidence = self.recent if len(self.recent) >= odds.LEAST_MEASUREMENTS else [*parts]
        self._weigh(now, evidence, accel_noise)
        # In the first rest, all of which is kept: no motion, jump or other pose since the first measurement.
        may_hide = self.recent[0] is self.first and not self.rest_given
        self.hidden = odds.hidden_turn(self.recent, accel_noise / now.covered_s) if may_hide else np.zeros(3)
        return self._follow(now)

    def _begin_rest(self, now: Measurement) -> None:
        if self.first and np.linalg.norm(now.force - self.first.force) > NEW_POSE:
            self.first = None  # it was in a hand, and not on a turntable
        if not self.doubted:
            self.nominal = self.test_copy = self.present
            self.changes, self.steady_s = 0, 0.0

    def _learn(self, now: Measurement) -> None:
        """Update the present bias by the first table."""
        self.undo = None
        if self.test_copy.fits(now, FIT_SIGMAS):
            self.undo, self.present = self.present, self.present.after(now)
            self.steady_s += now.length_s
            self.steady_count += 1
            return
        if self.nominal.fits(now, FIT_SIGMAS):
            self.present = self.nominal.after(now)
            self.changes = 0
        else:
            self.present = self.nominal.with_learned_noise(self.present).after(now, jumped=True)
            self.changes += 1
        self.test_copy = self.present
        self.steady_s, self.steady_count = now.length_s, 1

    def _weigh(self, now: Measurement, evidence: Sequence[Measurement], accel_noise: float) -> None:
        """Update P(turn), and what the less likely hypothesis adds to sigma."""
        # A rate that lasts is no flicker of a second, so that is not in the variance.
        prediction = self.nominal.prediction.ahead_to(now.end_s, now.degc_and_sd)
        nominal, nominal_variance = prediction.bias(now.force, of_mean=True)
        present, present_variance = self.present.prediction.bias(now.force, of_mean=True)
        change = present - nominal
        if self.rest_given:  # no sensor is compared
            self.p_turn = EVEN if self.changes and self.steady_s <= UNDECIDED_GIVEN_S else 0.0
        else:
            noise, drift = accel_noise / evidence[0].covered_s, self.limits.accel_drift
            by_gravity = odds.log_ratio_by_gravity(evidence, nominal, nominal_variance, change, noise, drift)
            by_heading, if_no_bias = odds.log_ratio_by_heading(evidence, np.stack([nominal, np.zeros(3)]))
            # Of the change: after a jump both errors are independent.  Else the present bias has all data of
            # the nominal one, the variance is the difference (Hausman), and this is a bound.
            variance = nominal_variance + present_variance
            self.p_turn = self._p_turn(now, change, variance, by_gravity + by_heading)
            if self.first and not self.changes:
                self.began_turning |= bool(if_no_bias < BEGAN_LOG_RATIO)
        # If bias 2 holds with probability p, the mean square error of bias 1, which is reported, is
        # (1 - p) P1 + p (d² + P2) = P1 + p (d² + P2 - P1).
        if self.turning:  # the present bias is bias 2, and d² is far above P2 - P1
            square = (1.0 - self.p_turn) * change**2
        else:
            square = self.p_turn * (change**2 + np.maximum(nominal_variance - present_variance, 0.0))
        self.ambiguities = np.stack([self.ambiguities[1], np.copysign(np.sqrt(square), change)])
        if self.began_turning:  # what the rate is if there is no bias
            self.ambiguities[:] = now.rate

    def _p_turn(self, now: Measurement, change: FloatArray, variance: FloatArray, log_ratio: float) -> float:
        """Return P(turn), by the change, its variance, and ln Λ of gravity and heading together."""
        size = max(math.hypot(*change), 1e-12)  # rad/s: it is a divisor
        too_long = self.steady_s > self.limits.undecided_s and size <= self.limits.largest_jump
        if too_long and log_ratio >= odds.EVIDENT_LOG_RATIO:
            return 0.0
        explained = odds.of_changed_bias(size, max(self.changes - 1, 0), self.limits.largest_jump)
        explained += odds.of_nominal_bias(size, float((change / size) ** 2 @ variance))
        if self.first and self.changes and round(self.steady_s) > ONSET_S:
            explained += odds.of_first_turn(self.first.rate, now.rate)
        ratio = math.exp(max(min(log_ratio, odds.EXCLUDED_LOG_RATIO), -odds.EXCLUDED_LOG_RATIO))
        return 1.0 / (1.0 + explained * ratio)

    def _follow(self, now: Measurement) -> bool:
        """Update the nominal bias by the second table; return whether it has jumped."""
        threshold = DOUBT_OF_CHANGE if self.changes else DOUBT
        self.doubted = self.p_turn > (UNLIKELY_TURN if self.doubted else threshold)
        if self.doubted:  # it learns the noise alone, which is the same in a turn
            self.nominal = self.nominal.with_learned_noise(self.present)
        elif self.changes and round(self.steady_s) > LAG_S:
            self.nominal = self.test_copy = self.present
            self.changes, self.first = 0, None
            return True
        if now.end_s - self.test_copy.time_s >= LAG_S:
            if not (self.doubted or self.changes):
                self.nominal = self.test_copy
            self.test_copy = self.present
        return False

    def move(self, undo: bool) -> None:
        """Coast while the unit moves: a change of a few seconds was how the motion began.  With `undo` the
        last measurement is taken back: motion may begin before it is detected."""
        if undo and self.undo is not None:
            self.present = self.undo
        self.undo = None
        if self.changes == 1 and round(self.steady_s) <= ONSET_S:  # after two it is no onset
            self.present = self.nominal
            self.changes, self.doubted = 0, False
        if not self.doubted:
            self.p_turn, self.ambiguities = 0.0, np.zeros((2, 3))
        if self.hidden.any():
            self.replace_each(lambda bank: bank.wider(self.hidden))
            self.hidden = np.zeros(3)
        self.recent, self.steady_count = [], 0

    def replace_each(self, function: Callable[[Bank], Bank]) -> None:
        """Replace each bank by a function of it."""
        banks = self.present, self.nominal, self.test_copy
        self.present, self.nominal, self.test_copy = map(function, banks)
        self.undo = None if self.undo is None else function(self.undo)
