"""The bias from slot to slot: rests come and go, and what moves the bias meanwhile is in its variance.

A second at rest counts once the unit has been at rest for half a second more: what moves it may begin
before it is noticed.  All rates are less what the thermal model has added since the start.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import hypotheses
from imumon.estimation.gyro_bias.hypotheses import LEAST_WHITE, Evidence, Second
from imumon.estimation.gyro_bias.law import Law
from imumon.estimation.gyro_bias.modes import SENSITIVITY_SD, SLOPE, WALK, Modes, known_modes, unknown_modes
from imumon.estimation.gyro_bias.motion import Motion
from imumon.estimation.gyro_bias.place import Attitude, Place, turned_earth
from imumon.estimation.gyro_bias.timing import Span
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE

SLOT_S = 0.25
SECOND_S = 1.0 - 1e-6
HELD_BACK = 2
"""Slots at rest behind a second before it counts."""
FIRST_SLOTS = 16
"""Slots at rest that show the noise."""
ANOTHER = 4.0
"""Factor of the variance of the white noise that is no chance in so many slots."""
PATIENCE_S = 60.0
"""Without a rest detector of ours, rest at another rate for so long is rest with another bias."""


class Slot(NamedTuple):
    """Means over a slot, (3,) each."""

    span: Span
    rest: bool
    """Whether it was at rest throughout."""
    rate: FloatArray
    """Mean of the gyros less what the thermal model has added, rad/s."""
    force: FloatArray
    """Mean specific force, m/s²; NaN without any."""
    degc: FloatArray
    growth: FloatArray
    """What an uncertain temperature has added to the variance of the bias meanwhile, (rad/s)²."""
    reported: FloatArray | None
    """A turn that may be a change of the bias, by the rest detector, rad/s; None without a detector."""
    turn: Turn


@dataclass(frozen=True, slots=True, eq=False)
class Params:
    """What does not change; declared noise is NaN where it is not declared."""

    white: FloatArray
    """Angle random walk, rad/√s, (3,)."""
    instability: FloatArray
    walk: FloatArray
    """B and K, rad/s and rad/s/√s, (3,)."""
    place: Place
    slopes: tuple[float, ...]
    """Standard deviations of the slope over temperature, over σ, 1/°C."""

    def modes(self, white: FloatArray) -> Modes:
        """Return the modes of the bank; `white`, (3,), is the variance of the mean of a second."""
        if np.isnan(self.instability).all():
            return unknown_modes(self.slopes)
        return known_modes(self.instability, self.walk, self.slopes, np.sqrt(white))


@dataclass(slots=True, eq=False)
class State:
    """All that is carried from slot to slot."""

    beliefs: hypotheses.State = field(default_factory=hypotheses.State)
    pending: list[Slot] = field(default_factory=list)
    """Slots at rest that do not count yet."""
    latest: list[Slot] = field(default_factory=list)
    """The latest slots of this rest, for their noise."""
    noise: FloatArray | None = None
    """Variance of the mean of a second, (3,), once it is known: it survives a restart."""
    attitude: Attitude = field(default_factory=Attitude)
    turn: Turn = STILL
    lost: bool = False
    """Since the last rest, and whether readings were missing meanwhile."""
    added: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Variance that has not been taken into the filters yet, (rad/s)², (3,)."""
    force: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    degc: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """The last that were known, (3,)."""
    motion: Motion = field(default_factory=Motion)
    """Estimates the bias from motion before the first rest."""
    by_motion: Law | None = None
    held: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Variance by a turn that the rest detector has reported, until a second has counted without, (3,)."""
    shown_s: float = -math.inf
    """Time of the law that is shown."""


def restarted(state: State) -> State:
    """Return a state as after a restart of the device; what is known of the noise stays."""
    fresh = State(noise=state.noise)
    fresh.beliefs.jumped = state.beliefs.jumped
    return fresh


def step(state: State, params: Params, slot: Slot) -> tuple[FloatArray | None, bool]:
    """Take a slot; return the normalised innovations of the second that counts, (3,), and whether the law
    is another."""
    state.force = np.where(np.isfinite(slot.force), slot.force, state.force)
    state.degc = np.where(np.isfinite(slot.degc), slot.degc, state.degc)
    state.added = state.added + slot.growth
    beliefs = state.beliefs
    if slot.reported is not None and (slot.reported.any() or not slot.rest):
        learned = not slot.rest and not beliefs.contradicted  # what has been learned does not become better
        state.held = np.maximum(slot.reported**2, state.held if learned else 0.0)
    if not slot.rest or slot.span.gap_s:
        _leave(state, slot)
    if slot.rest:
        state.latest = [*state.latest[1 - FIRST_SLOTS :], slot]
        state.pending.append(slot)
        if beliefs.nominal is None:
            state.motion.interrupt()
            return None, _look_for_beginning(state, params)
        seconds = sum(one.span.seconds for one in state.pending[:-HELD_BACK])
        if seconds >= SECOND_S:
            return _count(state, params), True
    elif beliefs.nominal is None:
        return None, _learn_from_motion(state, slot)
    return None, slot.span.end_s - state.shown_s >= SECOND_S


def miss(state: State, lag_degc: FloatArray) -> None:
    """Note a gap: the lag of the gyros' temperatures may have changed by so much (sd), °C, (3,)."""
    state.motion.interrupt()
    nominal = state.beliefs.nominal
    if nominal is not None:
        law = nominal.law
        slope2 = law.mean[:, SLOPE] ** 2 + law.covariance[:, SLOPE, SLOPE]
        state.added = state.added + slope2 * lag_degc**2
        state.lost = True
        hypotheses.move(state.beliefs)
    state.pending, state.latest = [], []


def _leave(state: State, slot: Slot) -> None:
    """Follow the unit while it is not at rest; what has not counted does not."""
    beliefs = state.beliefs
    if state.latest:
        state.pending, state.latest = [], []
    if beliefs.nominal is None:
        return
    if not beliefs.moved:
        state.turn, state.lost = STILL, False
    reported = slot.reported is not None and slot.reported.any()
    if reported and beliefs.contradicted:
        beliefs.moved, beliefs.probability, beliefs.recent, beliefs.alike = True, 1.0, [], 0
    else:
        hypotheses.move(beliefs)
    state.turn = state.turn.then(slot.turn.less(beliefs.nominal.law.mean[:, WALK]))
    state.lost |= slot.span.gap_s > 0.0


def _learn_from_motion(state: State, slot: Slot) -> bool:
    """Learn the bias from the motion before the first rest; return whether a window has ended."""
    if slot.span.gap_s or np.isnan(slot.force).any():
        state.motion.interrupt()
        return False
    if not state.motion.take(slot.turn, slot.force):
        return False
    bias, variance = state.motion.bias
    state.by_motion = Law.of(
        bias, variance + EARTH_RATE**2, SENSITIVITY_SD**2, state.motion.force, slot.span.end_s
    )
    return True


def _noise_of(slots: Sequence[Slot]) -> FloatArray:
    """Return the variance of the mean rate of a second by second differences of slots, (3,)."""
    means = np.array([one.rate for one in slots])
    second = means[2:] - 2.0 * means[1:-1] + means[:-2]
    seconds = float(np.mean([one.span.covered_s for one in slots]))
    return np.asarray(np.maximum(np.nan_to_num((second**2).mean(0) / 6.0 * seconds), LEAST_WHITE))


def _look_for_beginning(state: State, params: Params) -> bool:
    """Begin once the noise is known and a second has passed."""
    slots = state.pending
    needed = FIRST_SLOTS if state.noise is None else 2
    seconds = sum(one.span.seconds for one in slots)
    if len(slots) < needed or seconds < SECOND_S:
        return False
    noise = _noise_of(slots) if state.noise is None else state.noise
    known = np.isfinite(params.white).all()
    if known:
        noise = np.maximum(params.white**2, LEAST_WHITE)
    state.noise = noise
    state.attitude.come_to_rest(slots[0].force, params.place, STILL, None)
    hypotheses.begin(state.beliefs, params.modes(noise), _seconds(state, slots), noise, bool(known))
    state.pending, state.added = [], np.zeros(3)
    return True


def _seconds(state: State, slots: Sequence[Slot]) -> list[Second]:
    """Return the means of seconds, less the earth rate."""
    found, part = [], []
    for slot in slots:
        part.append(slot)
        if sum(one.span.seconds for one in part) >= SECOND_S:
            found.append(_second(state, part))
            part = []
    return found + ([_second(state, part)] if part else [])


def _second(state: State, slots: Sequence[Slot]) -> Second:
    seconds = np.array([one.span.covered_s for one in slots])
    total = float(seconds.sum())
    weight = seconds / total
    rate = weight @ np.array([one.rate for one in slots]) - state.attitude.earth
    force = weight @ np.array([one.force for one in slots])
    degc = weight @ np.array([one.degc for one in slots])
    degc = np.where(np.isfinite(degc), degc, slots[-1].degc)
    force = np.where(np.isfinite(force), force, state.force)
    return Second(slots[-1].span.end_s, total, rate, force, degc)


def _count(state: State, params: Params) -> FloatArray:
    """Let a second count; return the normalised innovations, (3,)."""
    beliefs, slots = state.beliefs, state.pending[:-HELD_BACK]
    state.pending = state.pending[-HELD_BACK:]
    assert beliefs.nominal is not None
    law = beliefs.nominal.law
    if beliefs.moved:
        known = None if state.lost else law
        state.added = state.added + state.attitude.come_to_rest(
            slots[0].force, params.place, state.turn, known
        )
        state.turn, state.lost = STILL, False
    _check_noise(state)
    now = _second(state, slots)
    law = beliefs.nominal.law
    bias, variance = law.wider(state.added).at(now.end_s, now.degc).bias(now.force)
    innovation = (now.rate - bias) / np.sqrt(variance + law.white / now.seconds)
    reported = slots[-1].reported
    if reported is None:
        evidence = Evidence(changed=now.end_s - beliefs.since_s > PATIENCE_S, probability=0.5)
    else:
        # What the detector has decided for H1 is in doubt here until a second second fits it.
        undecided = bool(reported.any())
        evidence = Evidence(changed=not undecided, probability=0.0 if undecided else 0.5)
    hypotheses.decide(beliefs, now, state.added, lambda *_: evidence)
    state.added = np.zeros(3)
    if slots[-1].reported is not None:
        state.held = slots[-1].reported ** 2
    return np.asarray(innovation)


def _check_noise(state: State) -> None:
    """Take the noise of the latest slots, where it is plainly another."""
    beliefs = state.beliefs
    if len(state.latest) < FIRST_SLOTS or beliefs.nominal is None:
        return
    noise = _noise_of(state.latest)
    if (noise > ANOTHER * beliefs.nominal.law.white).any():
        state.noise, state.latest = noise, []
        hypotheses.take_noise(beliefs, noise)


def shown(state: State, params: Params, now_s: float) -> tuple[Law | None, FloatArray, FloatArray]:
    """Return the law of the bias at a time, what is to be added to its variance, and the variance by
    the hypothesis that is not shown, (rad/s)², (3,)."""
    state.shown_s = now_s
    if state.beliefs.nominal is None:
        return state.by_motion, np.zeros(3), np.zeros(3)
    law, ambiguity = hypotheses.shown(state.beliefs, now_s, state.degc, state.force)
    added = state.added + state.attitude.uncertain_earth(params.place)
    if state.beliefs.moved:
        added = added + turned_earth(state.attitude.up, params.place, state.turn)
    return law, added, np.maximum(ambiguity**2, state.held)
