"""Slot by slot: is the unit at rest?

`quiet` tests whether anything moves, without a bias; of each quiet second the table of
`imumon.estimation.gyro_bias.table` decides what its mean is.  At rest is what is quiet for a second, has been
decided on since it was last not, and is not rather a turn.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import table
from imumon.estimation.gyro_bias.modes import SLOPE_PER_SIGMA, unknown_modes
from imumon.estimation.gyro_bias.odds import Second, at_first, by_compass
from imumon.estimation.gyro_bias.table import LEAST_WHITE, Limits
from imumon.estimation.gyro_bias.timing import Span
from imumon.estimation.rest import quiet
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.quiet import ACCEL, GYRO, TRIAL
from imumon.geodesy import EARTH_RATE

MODES = unknown_modes((0.0, SLOPE_PER_SIGMA))
CERTAIN = 8.0
"""Log likelihood ratio from which on a compass decides whether the recording began in a turn."""
SECOND_S = 1.0 - 1e-6
LEAST_SLOTS = 4
"""Quiet slots in a row before it is rest."""


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
    beliefs: table.State = field(default_factory=table.State)
    pending: list[Reading] = field(default_factory=list)
    """Quiet slots of a second that is not complete."""
    path: float = 0.0
    """Angle turned since the last rest, rad: the earth rate in the bias has turned by as much."""
    decided: bool = False
    """Whether the table has decided on a second since it was last not quiet."""
    first_is_turn: bool = False
    """Whether a compass shows that the first mean is a turn."""
    at_rest: bool = False
    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    """What is shown: whether it is at rest, and the turn that may be a change of the bias, rad/s, (3,)."""


def begin(state: State, other: bool) -> None:
    """Begin anew after a gap, or in another run of the unit: its bias is another, the noise is what it
    was."""
    quiet.begin(state.quiet)
    if other:
        state.beliefs, state.first_is_turn, state.turn = table.State(), False, np.zeros(3)
    _move(state)


def step(state: State, parameters: RestParameters, reading: Reading) -> None:
    """Take a slot."""
    run = quiet.step(state.quiet, reading.slot, parameters.drift)
    if not state.quiet.present[GYRO].all():
        state.at_rest = run >= LEAST_SLOTS
        return
    beliefs = state.beliefs
    if state.quiet.run == 0:
        _turn_on(state, reading)
        _move(state)
    elif beliefs.believed is None:
        _look_for_beginning(state, reading)
    elif state.quiet.another:
        table.take_noise(beliefs, _noise(state))
        state.pending = []
    else:
        state.pending.append(reading)
        if run >= LEAST_SLOTS and sum(one.span.seconds for one in state.pending) >= SECOND_S:
            _decide(state, parameters)
    state.at_rest = run >= LEAST_SLOTS and state.decided and not beliefs.turning and not state.first_is_turn


def _noise(state: State) -> FloatArray:
    """Return the variance of the mean of a second, (6,)."""
    return np.maximum(state.quiet.noise * state.quiet.seconds, LEAST_WHITE)


def _turn_on(state: State, reading: Reading) -> None:
    """Add a slot in motion to the path."""
    law = state.beliefs.law
    rate = reading.slot.mean[GYRO] - (0.0 if law is None else law.mean[:, 0])
    turned = float(np.sqrt(rate @ rate)) * reading.span.seconds
    state.path += turned if np.isfinite(turned) else 0.0


def _move(state: State) -> None:
    """Note that the unit moves: a second that is not complete is dropped."""
    if state.first_is_turn:
        state.beliefs, state.first_is_turn = table.State(), False
    if state.beliefs.believed is not None:
        table.move(state.beliefs)
        if not state.beliefs.disputed:
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
        seconds.append(Second(end_s, covered, part[:, GYRO].mean(0), force, degc, reading.heading))
        end_s -= covered
    table.begin(state.beliefs, MODES, seconds[::-1], _noise(state))
    state.beliefs.history = []
    state.pending, state.decided, state.path = [], True, 0.0


def second_of(readings: list[Reading], with_force: bool) -> Second:
    """Return the means of some slots."""
    seconds = [one.span.covered_s for one in readings]
    total = sum(seconds)
    weight = np.array(seconds) / total
    mean = weight @ np.array([one.slot.mean for one in readings])
    last = readings[-1]
    heading = weight @ np.array([one.heading for one in readings])
    force = mean[ACCEL] if with_force else np.full(3, np.nan)
    return Second(last.span.end_s, total, mean[GYRO], force, np.full(3, last.degc), heading)


def _decide(state: State, parameters: RestParameters) -> None:
    """Decide on a complete second."""
    beliefs = state.beliefs
    with_force = bool(state.quiet.present[ACCEL].all())
    now = second_of(state.pending, with_force)
    parts = (
        [second_of([one], with_force) for one in state.pending]
        if beliefs.disputed or len(beliefs.history) < 2
        else []
    )
    state.pending = []
    if not np.isfinite(now.rate).all():
        return
    beliefs.noise = _noise(state)
    arrived = np.full(3, EARTH_RATE**2 * 2.0 / 3.0 * min(1.0, state.path**2) if beliefs.moved else 0.0)
    limits = Limits(parameters.largest_jump, parameters.undecided_s, parameters.accel_drift)
    row = table.decide(beliefs, limits, now, arrived, parts=parts)
    state.decided, state.path = True, 0.0
    if state.first_is_turn and row == "another rate":
        begin(state, other=True)
        return
    _, ambiguity = table.shown(beliefs, now.end_s, now.degc, now.force)
    state.turn = _with_first_and_rounding(state, parameters, now, ambiguity)


def _with_first_and_rounding(
    state: State, parameters: RestParameters, now: Second, ambiguity: FloatArray
) -> FloatArray:
    """Return the ambiguity, with the largest error by rounding, and with a turn in which the recording may
    have begun, rad/s, (3,)."""
    beliefs = state.beliefs
    rounding = state.quiet.rounding_error[GYRO]
    if beliefs.first is not None and not beliefs.disputed:
        up = now.force / np.sqrt(now.force @ now.force)
        along = (beliefs.first @ up) * up
        evidence = by_compass(beliefs.history, along) if np.isfinite(up).all() else 0.0
        state.first_is_turn |= evidence < -CERTAIN
        if state.first_is_turn:
            return beliefs.first
        if evidence > CERTAIN:
            beliefs.first = None
        elif parameters.begins_turning > 0.0:
            ambiguity = np.hypot(ambiguity, at_first(beliefs.first, up, parameters.begins_turning))
    return np.where(rounding > 0.0, np.copysign(np.hypot(ambiguity, rounding), ambiguity), ambiguity)
