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
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import hypotheses
from imumon.estimation.gyro_bias.hypotheses import LEAST_WHITE, Evidence
from imumon.estimation.gyro_bias.modes import SENSITIVITY_SD, SLOPE, WALK, Modes, known_modes, unknown_modes
from imumon.estimation.gyro_bias.motion import Motion
from imumon.estimation.gyro_bias.place import Attitude, Place, turned_earth
from imumon.estimation.gyro_bias.prediction import Prediction
from imumon.estimation.gyro_bias.timing import Span
from imumon.estimation.rest import quiet
from imumon.estimation.rest.odds import (
    as_predicted,
    by_compass,
    by_gravity,
    first_was_turn,
    probability_of_turn,
)
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.quiet import ACCEL, GYRO, TRIAL, Second
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE

SECOND_S = 1.0 - 1e-6
LEAST_SLOTS = 4
"""Quiet slots in a row before it is rest."""
UNDO_SLOTS = 2
"""Motion that begins within so many slots after a second takes that second back from the filters."""
CHANGE_LOG_RATIO = 12.0
"""Log likelihood ratio of a changed bias over a turn from which on the bias has changed."""
TURN_LOG_RATIO = 2.0
"""The same of a turn over a changed bias, from which on a mean that fits a wide prediction is no rest."""
BEGAN_LOG_RATIO = 8.0
"""Log likelihood ratio by the compass from which on the recording began in a turn."""
SLOWEST_BEGUN = 2.5e-3
"""rad/s: a slower turn, by 0.04 rad in 16 s, cannot reach that ratio beside the error of a heading."""
LEAST_SECONDS = 3
"""Least number of seconds over which gravity is compared."""
FIRST_S = 4.0
"""How long the mean has been the same before the first mean of the recording is called in question."""
GIVEN_ANOTHER = 4.0
"""Where rest is given, factor of the variance of the white noise that is no chance in 16 slots."""
PATIENCE_S = 60.0
"""Where rest is given, rest at another rate for so long is rest with another bias."""


class Slot(NamedTuple):
    """A slot, and what else is known at its end."""

    span: Span
    readings: quiet.Slot
    modelled: FloatArray
    """What the thermal model has added to the bias, rad/s, (3,)."""
    degc: FloatArray
    growth: FloatArray
    """What an uncertain temperature has added to the variance of the bias meanwhile, (rad/s)², (3,)."""
    heading: FloatArray
    """(3,); NaN without one."""
    turn: Turn
    at_rest: bool | None
    """Whether it was at rest throughout, where that is given."""

    @property
    def force(self) -> FloatArray:
        """Mean specific force, m/s², (3,); NaN without any."""
        return self.readings.mean[ACCEL]


@dataclass(frozen=True, slots=True, eq=False)
class Params:
    """What does not change; declared noise is NaN where it is not declared."""

    white: FloatArray
    """Angle random walk, rad/√s, (3,)."""
    instability: FloatArray
    """B, rad/s, (3,)."""
    walk: FloatArray
    """K, rad/s/√s, (3,)."""
    place: Place
    slopes: tuple[float, ...]
    """Standard deviations of the slope over temperature, over σ, 1/°C."""
    rest: RestParameters

    def modes(self, white: FloatArray) -> Modes:
        """Return the modes of the bank; `white`, (3,), is the variance of the mean of a second."""
        if np.isnan(self.instability).all():
            return unknown_modes(self.slopes)
        return known_modes(self.instability, self.walk, self.slopes, np.sqrt(white))


@dataclass(slots=True, eq=False)
class State:
    """All that is carried from slot to slot."""

    quiet: quiet.State = field(default_factory=quiet.State)
    decision: hypotheses.State = field(default_factory=hypotheses.State)
    latest: list[Slot] = field(default_factory=list)
    """The latest 16 slots."""
    pending: list[Slot] = field(default_factory=list)
    """Quiet slots of a second that is not complete."""
    attitude: Attitude = field(default_factory=Attitude)
    turn: Turn = STILL
    """Since the attitude was taken."""
    lost: bool = False
    """Whether readings were missing since then."""
    added: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Variance that has not been taken into the filters yet, (rad/s)², (3,)."""
    force: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """The last specific force that was known, m/s², (3,)."""
    degc: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """The last temperatures that were known, °C, (3,)."""
    motion: Motion = field(default_factory=Motion)
    """Estimates the bias from motion before the first rest."""
    by_motion: Prediction | None = None
    decided: bool = False
    """Whether a second has been decided on since it was last not quiet."""
    began_turning: bool = False
    """Whether the first mean of the recording is a turn, by the compass."""
    at_rest: bool = False
    """Whether rest is shown."""
    turn_rate: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What is shown of a turn that may be a change of the bias, rad/s, (3,)."""
    ambiguity: FloatArray = field(default_factory=lambda: np.zeros(3))
    """By the other hypothesis of the bias, after the last second, rad/s, (3,): the larger of two is shown,
    for a single second may fit by chance."""
    shown_s: float = -math.inf
    """Time of the prediction that is shown; minus infinity once it is another."""


def restarted(state: State) -> State:
    """Return a state as after a restart of the device: the bias is another, the noise is what it was."""
    quiet.begin(state.quiet)
    return State(quiet=state.quiet, decision=hypotheses.State(jumped=state.decision.jumped))


def step(state: State, params: Params, slot: Slot) -> FloatArray | None:
    """Take a slot; return the normalised innovations of the second that it completes at rest, (3,)."""
    state.force = np.where(np.isfinite(slot.force), slot.force, state.force)
    state.degc = np.where(np.isfinite(slot.degc), slot.degc, state.degc)
    state.added = state.added + slot.growth
    state.latest = [*state.latest[1 - TRIAL :], slot]
    run = quiet.step(state.quiet, slot.readings, params.rest.drift, slot.at_rest)
    innovation = None
    if not state.quiet.present[GYRO].all():
        state.at_rest = run >= LEAST_SLOTS
        return None
    if run == 0:
        _move(state, slot)
    elif state.decision.nominal is None:
        _look_for_beginning(state, params)
    elif state.quiet.another:
        hypotheses.take_noise(state.decision, _noise(state)[GYRO])
        state.pending = []
    else:
        state.pending.append(slot)
        if state.decision.turning:
            _follow_turn(state, slot)
        if run >= LEAST_SLOTS and sum(one.span.seconds for one in state.pending) >= SECOND_S:
            innovation = _decide(state, params)
    turning = state.decision.turning or state.began_turning
    state.at_rest = state.decided and not turning
    return innovation if state.at_rest else None


def miss(state: State, lag_degc: FloatArray, long: bool) -> None:
    """Note a gap: the lag of the gyros' temperatures may have changed by so much (sd), °C, (3,).

    Parameters
    ----------
    long : bool
        Whether rest does not go on over it.
    """
    state.motion.interrupt()
    state.lost |= long or state.quiet.run == 0
    if state.decision.nominal is not None:
        prediction = state.decision.nominal.prediction
        slope2 = prediction.mean[:, SLOPE] ** 2 + prediction.covariance[:, SLOPE, SLOPE]
        state.added = state.added + slope2 * lag_degc**2
    if long:
        quiet.begin(state.quiet)
        _interrupt(state)
    state.shown_s = -math.inf


def _noise(state: State) -> FloatArray:
    """Return the variance of the mean of a second, (6,)."""
    covered_s = sum(one.span.covered_s for one in state.latest) / len(state.latest)
    return np.maximum(state.quiet.noise * covered_s, LEAST_WHITE)


def _interrupt(state: State) -> None:
    """Drop a second that is not complete: it moves, or nothing is known of it for a while."""
    if state.began_turning:
        state.decision, state.began_turning = hypotheses.State(jumped=state.decision.jumped), False
    if state.decided:
        state.shown_s = -math.inf
    if state.decision.nominal is not None:
        hypotheses.move(state.decision, undo=len(state.pending) < UNDO_SLOTS)
        if not state.decision.contradicted:
            state.turn_rate = np.zeros(3)
    state.pending, state.decided, state.at_rest = [], False, False


def _move(state: State, slot: Slot) -> None:
    """Follow a slot in motion."""
    _interrupt(state)
    if state.decision.nominal is not None:
        _follow_turn(state, slot)
        return
    if slot.span.gap_s or np.isnan(slot.force).any():
        state.motion.interrupt()
    elif state.motion.take(slot.turn, slot.force):
        bias, variance = state.motion.bias
        state.by_motion = Prediction.of(
            bias, variance + EARTH_RATE**2, SENSITIVITY_SD**2, state.motion.force, slot.span.end_s
        )
        state.shown_s = -math.inf


def _follow_turn(state: State, slot: Slot) -> None:
    """Add a slot to the turn since the attitude was taken."""
    assert state.decision.nominal is not None
    state.turn = state.turn.then(
        slot.turn.less(state.decision.nominal.prediction.mean[:, WALK] + slot.modelled)
    )
    state.lost |= slot.span.gap_s > 0.0


def _look_for_beginning(state: State, params: Params) -> None:
    """Begin with the first second, or the slots of the trial that has found the noise."""
    state.motion.interrupt()
    if not state.quiet.known or state.quiet.run < LEAST_SLOTS:
        return
    slots = state.latest[-state.quiet.run :]
    parts: list[list[Slot]] = [[]]
    for one in slots:
        if sum(each.span.seconds for each in parts[-1]) >= SECOND_S:
            parts.append([])
        parts[-1].append(one)
    state.attitude = Attitude()
    state.attitude.come_to_rest(state.force, params.place, STILL, None)
    seconds = [_second(state, part) for part in parts]
    if not np.isfinite([one.rate for one in seconds]).all():
        return
    known = bool(np.isfinite(params.white).all())
    white = np.maximum(params.white**2, LEAST_WHITE) if known else _noise(state)[GYRO]
    hypotheses.begin(state.decision, params.modes(white), seconds, white, known)
    state.decided, state.added = True, np.zeros(3)
    state.turn, state.lost, state.shown_s = STILL, False, -math.inf


def _second(state: State, slots: Sequence[Slot]) -> Second:
    """Return the means of some slots; the rate is less the earth rate."""
    seconds = np.array([one.span.covered_s for one in slots])
    total = float(seconds.sum())
    weight = seconds / total
    mean, modelled, degc, heading = (
        weight @ np.array(part)
        for part in zip(
            *((one.readings.mean, one.modelled, one.degc, one.heading) for one in slots), strict=True
        )
    )
    last = slots[-1]
    degc = np.where(np.isfinite(degc), degc, last.degc)
    rate = mean[GYRO] - modelled - state.attitude.earth
    return Second(last.span.end_s, total, rate, mean[ACCEL], degc, heading)


def _come_to_rest(state: State, params: Params, force: FloatArray) -> None:
    """Take the attitude after a turn, and what that adds to the variance of the bias."""
    assert state.decision.nominal is not None
    prediction = None if state.lost else state.decision.nominal.prediction
    state.added = state.added + state.attitude.come_to_rest(force, params.place, state.turn, prediction)
    state.turn, state.lost = STILL, False


def _decide(state: State, params: Params) -> FloatArray | None:
    """Decide on a complete second; return its normalised innovations, (3,)."""
    bias, slots = state.decision, state.pending
    assert bias.nominal is not None
    state.pending = []
    if bias.moved:
        _come_to_rest(state, params, slots[0].force)
    now = _second(state, slots)
    if not np.isfinite(now.rate).all():
        return None
    given = slots[-1].at_rest is not None
    if given:
        _check_noise(state)
    prediction = bias.nominal.prediction.wider(state.added).at(now.end_s, now.degc)
    mean, variance = prediction.bias(now.force)
    innovation = (now.rate - mean) / np.sqrt(variance + prediction.white / now.seconds)

    def test(prediction: Prediction, difference: FloatArray, fits: bool) -> Evidence:
        if given:
            return Evidence(changed=now.end_s - bias.since_s > PATIENCE_S, probability=0.5)
        seconds = _seconds_for_gravity(state, slots, fits)
        noise = float(_noise(state)[ACCEL].max()) / seconds[0].seconds
        return _evidence(bias, params.rest, prediction, difference, seconds, noise)

    hypotheses.decide(bias, now, state.added, test)
    state.added, state.decided, state.shown_s = np.zeros(3), True, -math.inf
    may_have_begun = bias.first is not None and not bias.contradicted and not given
    if may_have_begun and float(now.rate @ now.rate) > SLOWEST_BEGUN**2:
        state.began_turning |= by_compass(bias.recent, np.zeros(3)) < -BEGAN_LOG_RATIO
    if state.began_turning and bias.contradicted:
        quiet.begin(state.quiet)
        _interrupt(state)
    elif state.turn.seconds and not bias.turning:
        _come_to_rest(state, params, slots[-1].force)
    return np.asarray(innovation)


def _seconds_for_gravity(state: State, slots: Sequence[Slot], fits: bool) -> list[Second]:
    """Return over what gravity is compared.

    Seconds of the present rate, where the mean fits the nominal bias and there are enough; else all of this
    rest, as the rate may just have changed; in its beginning the slots.
    """
    bias = state.decision
    if fits and bias.alike >= LEAST_SECONDS:
        return bias.recent[-bias.alike :]
    if len(bias.recent) >= LEAST_SECONDS:
        return bias.recent
    return [_second(state, [one]) for one in slots]


def _check_noise(state: State) -> None:
    """Take the noise of the latest slots at rest that is given, where it is plainly another."""
    bias = state.decision
    if state.quiet.run < TRIAL or bias.nominal is None:
        return
    covered_s = sum(one.span.covered_s for one in state.latest) / TRIAL
    noise = quiet.noise_of(state.quiet.means(TRIAL))[GYRO] * covered_s
    if (noise > GIVEN_ANOTHER * bias.nominal.prediction.white).any():
        hypotheses.take_noise(bias, np.maximum(noise, LEAST_WHITE))


def _evidence(
    bias: hypotheses.State,
    parameters: RestParameters,
    prediction: Prediction,
    difference: FloatArray,
    seconds: list[Second],
    noise: float,
) -> Evidence:
    """Test a difference from the nominal bias by gravity, a compass, the first mean, and time.

    `noise` is the variance of the mean force of a second, (m/s²)².
    """
    now = bias.recent[-1]
    value, variance = prediction.bias(now.force, of_mean=True)
    turn = sum((one.seconds * (one.rate - value) for one in seconds[1:]), np.zeros(3))
    ratio, part = by_gravity(seconds, difference, turn, float(variance.max()), noise, parameters.accel_drift)
    ratio += by_compass(seconds, value)
    others = as_predicted(part, variance)
    if bias.first is not None and bias.fits_s >= FIRST_S:
        others += first_was_turn(bias.first, now.rate)
    small = float(np.linalg.norm(difference)) <= parameters.largest_jump
    steady = small and bias.fits_s > parameters.undecided_s
    return Evidence(
        turns=ratio < -TURN_LOG_RATIO,
        changed=ratio > CHANGE_LOG_RATIO or (steady and ratio > -TURN_LOG_RATIO),
        probability=probability_of_turn(part, ratio, others, parameters.largest_jump, bias.changes),
    )


def shown(state: State, params: Params, now_s: float) -> tuple[Prediction | None, FloatArray]:
    """Return the prediction of the bias at a time, and what is to be added to its variance, (rad/s)², (3,).

    Sets the turn that may be a change of the bias.
    """
    state.shown_s = now_s
    bias = state.decision
    if bias.nominal is None:
        return state.by_motion, np.zeros(3)
    prediction, ambiguity = hypotheses.shown(bias, now_s, state.degc, state.force)
    if state.began_turning:
        state.turn_rate = bias.recent[-1].rate
    elif bias.contradicted or not bias.moved:
        before, state.ambiguity = state.ambiguity, ambiguity
        ambiguity = np.where(np.abs(before) > np.abs(ambiguity), before, ambiguity)
        rounding = state.quiet.rounding_error[GYRO]
        state.turn_rate = np.copysign(np.hypot(ambiguity, rounding), ambiguity)
    added = state.added + state.attitude.uncertain_earth(params.place)
    if state.turn.seconds:
        added = added + turned_earth(state.attitude.up, params.place, state.turn)
    return prediction, added
