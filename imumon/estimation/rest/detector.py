"""Slot by slot: is the unit at rest?

`quiet` tests whether anything moves, without a bias; of each quiet second
`imumon.estimation.gyro_bias.hypotheses` decides what its mean is.  At rest is what is quiet for a second, has
been decided on since it was last not, and is not rather a turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import hypotheses
from imumon.estimation.gyro_bias.hypotheses import LEAST_WHITE, Evidence, Second
from imumon.estimation.gyro_bias.law import Law
from imumon.estimation.gyro_bias.modes import SLOPE_PER_SIGMA, WALK, unknown_modes
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
from imumon.estimation.rest.quiet import ACCEL, GYRO, TRIAL
from imumon.geodesy import EARTH_RATE

MODES = unknown_modes((0.0, SLOPE_PER_SIGMA))
SECOND_S = 1.0 - 1e-6
LEAST_SLOTS = 4
"""Quiet slots in a row before it is rest."""
CHANGE_LOG_RATIO = 12.0
"""Log likelihood ratio of a changed bias over a turn from which on the bias has changed."""
TURN_LOG_RATIO = 2.0
"""The same of a turn over a changed bias, from which on a mean that fits a wide law is no rest."""
BEGAN_LOG_RATIO = 8.0
"""Log likelihood ratio by the compass from which on the recording began in a turn."""
LEAST_SECONDS = 3
"""Seconds over which gravity is compared; in the first ones of a rest its slots are, and where the rate has
just changed also the seconds before."""
FIRST_S = 4.0
"""How long the mean has been the same before the first mean of the recording is called in question."""


class Reading(NamedTuple):
    """A slot, and what else is known at its end."""

    span: Span
    slot: quiet.Slot
    degc: float
    heading: FloatArray
    """(3,); NaN without one."""


@dataclass(slots=True, eq=False)
class State:
    """All that is carried from slot to slot."""

    quiet: quiet.State = field(default_factory=quiet.State)
    bias: hypotheses.State = field(default_factory=hypotheses.State)
    pending: list[Reading] = field(default_factory=list)
    """Quiet slots of a second that is not complete."""
    path: float = 0.0
    """Angle turned since the last rest, rad: the earth rate in the bias has turned by as much."""
    decided: bool = False
    """Whether a second has been decided on since it was last not quiet."""
    began_turning: bool = False
    """Whether the first mean of the recording is a turn, by the compass."""
    at_rest: bool = False
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What is shown: whether it is at rest, and the turn that may be a change of the bias, rad/s, (3,)."""


def begin(state: State, other: bool) -> None:
    """Begin anew after a gap, or in another run of the unit: its bias is another, the noise is what it
    was."""
    quiet.begin(state.quiet)
    if other:
        state.bias, state.began_turning, state.turn = hypotheses.State(), False, np.zeros(3)
    _move(state)


def step(state: State, parameters: RestParameters, reading: Reading) -> None:
    """Take a slot."""
    run = quiet.step(state.quiet, reading.slot, parameters.drift)
    if not state.quiet.present[GYRO].all():
        state.at_rest = run >= LEAST_SLOTS
        return
    if run == 0:
        _turn_on(state, reading)
        _move(state)
    elif state.bias.nominal is None:
        _look_for_beginning(state, reading)
    elif state.quiet.another:
        hypotheses.take_noise(state.bias, _noise(state)[GYRO])
        state.pending = []
    else:
        state.pending.append(reading)
        if run >= LEAST_SLOTS and sum(one.span.seconds for one in state.pending) >= SECOND_S:
            _decide(state, parameters)
    turning = state.bias.turning or state.began_turning
    state.at_rest = run >= LEAST_SLOTS and state.decided and not turning


def _noise(state: State) -> FloatArray:
    """Return the variance of the mean of a second, (6,)."""
    return np.maximum(state.quiet.noise * state.quiet.seconds, LEAST_WHITE)


def _turn_on(state: State, reading: Reading) -> None:
    """Add a slot in motion to the path."""
    nominal = state.bias.nominal
    rate = reading.slot.mean[GYRO] - (0.0 if nominal is None else nominal.law.mean[:, WALK])
    turned = float(np.sqrt(rate @ rate)) * reading.span.seconds
    state.path += turned if np.isfinite(turned) else 0.0


def _move(state: State) -> None:
    """Note that the unit moves: a second that is not complete is dropped."""
    if state.began_turning:
        state.bias, state.began_turning = hypotheses.State(), False
    if state.bias.nominal is not None:
        hypotheses.move(state.bias)
        if not state.bias.contradicted:
            state.turn = np.zeros(3)
    state.pending, state.decided, state.at_rest = [], False, False


def _look_for_beginning(state: State, reading: Reading) -> None:
    """Begin with the first second, or the slots of the trial that has found the noise."""
    state.pending = [*state.pending[1 - TRIAL :], reading]
    if state.quiet.run < LEAST_SLOTS:
        return
    count = min(state.quiet.run, TRIAL)
    means = state.quiet.means(count)
    each = max(round(1.0 / state.quiet.seconds), 1)
    seconds, end_s = [], reading.span.end_s
    for last in range(count, 0, -each):
        part = means[max(last - each, 0) : last]
        force = part[:, ACCEL].mean(0) if state.quiet.present[ACCEL].all() else np.full(3, np.nan)
        covered = len(part) * state.quiet.seconds
        degc = np.full(3, reading.degc)
        seconds.append(Second(end_s, covered, part[:, GYRO].mean(0), force, degc))
        end_s -= covered
    hypotheses.begin(state.bias, MODES, seconds[::-1], _noise(state)[GYRO])
    state.pending, state.decided, state.path = [], True, 0.0


def _second(readings: list[Reading], with_force: bool) -> Second:
    """Return the means of some slots."""
    seconds = [one.span.covered_s for one in readings]
    total = sum(seconds)
    weight = np.array(seconds) / total
    mean, heading = (
        weight @ np.array(part)
        for part in zip(*((one.slot.mean, one.heading) for one in readings), strict=True)
    )
    last = readings[-1]
    force = mean[ACCEL] if with_force else np.full(3, np.nan)
    return Second(last.span.end_s, total, mean[GYRO], force, np.full(3, last.degc), heading)


def _decide(state: State, parameters: RestParameters) -> None:
    """Decide on a complete second."""
    bias, slots = state.bias, state.pending
    with_force = bool(state.quiet.present[ACCEL].all())
    now = _second(slots, with_force)
    state.pending = []
    if not np.isfinite(now.rate).all():
        return
    earth = EARTH_RATE**2 * 2.0 / 3.0 * min(1.0, state.path**2) if bias.moved else 0.0

    def test(law: Law, difference: FloatArray, fits: bool) -> Evidence:
        seconds = bias.recent[-bias.alike :] if fits and bias.alike >= LEAST_SECONDS else bias.recent
        if len(seconds) < LEAST_SECONDS:
            seconds = [_second([one], with_force) for one in slots]
        return _evidence(state, parameters, law, difference, seconds)

    hypotheses.decide(bias, now, np.full(3, earth), test)
    state.decided, state.path = True, 0.0
    if bias.first is not None and not bias.contradicted:
        state.began_turning |= by_compass(bias.recent, np.zeros(3)) < -BEGAN_LOG_RATIO
    if state.began_turning:
        if bias.contradicted:
            begin(state, other=True)
        else:
            state.turn = now.rate
        return
    _, ambiguity = hypotheses.shown(bias, now.end_s, now.degc, now.force)
    rounding = state.quiet.rounding_error[GYRO]
    state.turn = np.where(rounding > 0.0, np.copysign(np.hypot(ambiguity, rounding), ambiguity), ambiguity)


def _evidence(
    state: State,
    parameters: RestParameters,
    law: Law,
    difference: FloatArray,
    seconds: list[Second],
) -> Evidence:
    """Test a difference from the nominal bias by gravity, a compass, the first mean, and time."""
    bias = state.bias
    now = bias.recent[-1]
    value, variance = law.bias(now.force, of_mean=True)
    turn = sum((one.seconds * (one.rate - value) for one in seconds[1:]), np.zeros(3))
    noise = float(_noise(state)[ACCEL].max()) / seconds[0].seconds
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
