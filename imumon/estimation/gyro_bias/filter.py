"""The bias from slot to slot: rests come and go, the bank of filters takes what the slots at rest say.

A slot at rest counts when the next one is at rest as well: what moved the unit may have begun before it was
noticed.  All biases are less what the thermal model has added since the start: so the samples of a slot, and
the slots of the first minute, refer to one moment without further ado.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.estimation.gyro_bias import bank as filters
from imumon.estimation.gyro_bias.attitude import Attitude, Place, turned_earth
from imumon.estimation.gyro_bias.bank import AtRest, Bank, Family
from imumon.estimation.gyro_bias.contrary import Contrary
from imumon.estimation.gyro_bias.law import LAW, Laws, at_slot, no_law, sd_at_slot, surprise
from imumon.estimation.gyro_bias.motion import Motion
from imumon.estimation.gyro_bias.slot import MOVED_DEGC, Reading, Slot
from imumon.estimation.gyro_bias.steps import mix_variants
from imumon.estimation.gyro_bias.white import WhiteNoise
from imumon.filters.turns import STILL, Turn
from imumon.geodesy import EARTH_RATE

SAME_POSE = 0.02
"""m/s², a tenth of a degree: with 0.1 °/s/g less than 1 °/h."""
LARGEST_TILT = 0.03
"""rad by which a unit at rest may turn until the tilt is measured from a new reference."""
GATE = 25.0
"""A slot whose squared innovation over its variance is beyond this in every filter contradicts the bias."""
STILLNESS = 2e-6
"""Velocity over g at the end of a slot at rest, rad s: 0.02 mm/s; what shakes more is in the noise."""
YAW_NOISE = 3e-8
"""How well the heading is known to stand still at rest, rad sqrt(s)."""
ACCEL_WALK = 1e-6
"""Random walk of the accelerometers' biases over g, rad/sqrt(s)."""
MIX_S = 5.0
"""The filters of the bank share what they know this often."""
FORGETTING_S = 600.0
"""Memory of the evidence for a slope."""
SIGNIFICANCE, EVIDENCE = 9.0, 8.0
"""A slope is used when d² > 9 P_dd and the log-likelihoods differ by more than 8 in its favour."""
REFILTERED = (8, 30)
"""Slots of the first rest after which, besides its end, all of it is filtered anew with the noise known."""


_NAN = np.full(3, np.nan)


def _nothing() -> FloatArray:
    return _NAN.copy()


def _zero() -> FloatArray:
    return np.zeros(3)


@dataclass(frozen=True, slots=True, eq=False)
class Params:
    """What does not change."""

    family: Family
    """Filters of the bank."""
    white: FloatArray
    """Angular random walk, rad/sqrt(s), (3,); NaN where it is to be measured."""
    tilt_noise: float
    """Velocity random walk, m/s/sqrt(s); NaN when it is to be measured."""
    place: Place
    learns: bool
    """Whether the slope over temperature is learned."""
    first_slots: int
    """Length of the first rest that is filtered again, slots."""


@dataclass(frozen=True, slots=True, eq=False)
class Noise:
    """White noise of the gyros, rad/sqrt(s), (3,), and of the tilt by the accelerometers, rad sqrt(s)."""

    rate: FloatArray
    tilt: float


@dataclass(slots=True, eq=False)
class Moved:
    """By how much the bias has moved in the present rest, or the last, and whether it has ended in motion.

    A turn of which nobody knows whether it is a change of the bias is one of two things.  While the rate is
    what it was then, the bias may have changed by the whole of it.  Once it plainly moves, the question is
    only how much of the beginning the bias has taken in.
    """

    least: FloatArray = field(default_factory=lambda: np.full(3, np.inf))
    greatest: FloatArray = field(default_factory=lambda: np.full(3, -np.inf))
    """The bias, rad/s, (3,)."""
    turned: FloatArray = field(default_factory=_zero)
    """How fast it may have turned all the time, rad/s, (3,): what nobody had decided then."""
    undecided: FloatArray = field(default_factory=_zero)
    rate: FloatArray = field(default_factory=_zero)
    """The rms of the turn in question, and the rate less the bias when it came in question, rad/s, (3,)."""
    plainly: bool = False
    """Whether it has moved otherwise since."""

    def see(self, bias: FloatArray, undecided: FloatArray) -> None:
        """Take the bias of a slot at rest."""
        self.least, self.greatest = np.fmin(self.least, bias), np.fmax(self.greatest, bias)
        self.turned = np.maximum(self.turned, np.abs(undecided))

    def move(self, undecided: FloatArray, rate: FloatArray, noise: FloatArray) -> None:
        """Take a slot in motion: the turn in question, the rate less the bias, and its noise, (3,) each."""
        if (undecided != self.undecided).any():
            self.undecided, self.rate, self.plainly = undecided, rate, False
        moved = np.abs(rate - self.rate)
        self.plainly |= bool((moved > np.abs(undecided) + math.sqrt(2.0 * GATE) * noise).any())

    def by(self, bias: FloatArray) -> FloatArray:
        """Return how much of a turn a bias can have taken in; infinite where that is not known."""
        if not self.plainly:
            return np.full(3, np.inf)
        off = np.fmax(self.greatest - bias, bias - self.least) + self.turned
        return np.where(np.isfinite(off), np.abs(off), np.inf)


@dataclass(slots=True, eq=False)
class State:
    """All that is carried from slot to slot."""

    white: WhiteNoise = field(default_factory=WhiteNoise)
    noise: Noise = field(default_factory=lambda: Noise(_nothing(), math.nan))
    """By the latest slot that counted."""
    bank: Bank | None = None
    """None until the noise is known."""
    attitude: Attitude = field(default_factory=Attitude)
    turn: Turn = STILL
    lost: bool = False
    """At the last rest, since then, and whether readings were missing meanwhile."""
    at_rest: bool = False
    fresh: bool = False
    """Whether it is at rest, and has just come to it."""
    waiting: Reading | None = None
    """What counts if the next slot is at rest as well."""
    first: list[Reading] = field(default_factory=list)
    """Those of the first rest."""
    zeroed: bool = False
    """Whether the first rest is over."""
    used_s: float = 0.0
    left_s: float = 0.0
    """Time of the bank, and when the unit left its last rest."""
    unmixed_s: float = 0.0
    jumps: int = 0
    contrary: Contrary = field(default_factory=Contrary)
    """What speaks against it."""
    at_degc: FloatArray = field(default_factory=_zero)
    noted_degc: FloatArray = field(default_factory=_zero)
    """Temperature of the bank, and where a move was last noted, (3,)."""
    growth: FloatArray = field(default_factory=_zero)
    arrival: FloatArray = field(default_factory=_zero)
    """Variance used so far, and that of coming to rest in another attitude, (3,)."""
    evidence: FloatArray = field(default_factory=_zero)
    chosen: BoolArray = field(default_factory=lambda: np.zeros(3, bool))
    """For a slope, and whether it is used, (3,)."""
    moved: Moved = field(default_factory=Moved)
    law: Laws = field(default_factory=no_law)
    """The estimate, less the thermal model's part."""
    reference: FloatArray | None = None
    """Specific force at the first rest, (3,): sensitivities count from there."""
    motion: Motion = field(default_factory=Motion)
    """What is known of the bias before the first rest."""


def restarted(state: State) -> State:
    """Return a state as after a restart of the device; what is known of the noise stays."""
    state.white.begin()
    return State(white=state.white, jumps=state.jumps)


def step(state: State, params: Params, slot: Slot) -> FloatArray:
    """Take a slot; return the normalised innovations, (3,), NaN where there are none."""
    innovation = _nothing()
    if state.at_rest and not (slot.rest and slot.follows):
        _leave(state, params, slot.start_s)
    if not state.at_rest:
        _follow_turn(state, slot)
    if slot.rest:
        if not state.at_rest:
            state.at_rest = state.fresh = True
        innovation = _close(state, params, slot)
    elif state.bank is not None:
        noise = _noise(state, params)
        _coast(state, params, noise, slot)
        _show(state, params, noise, slot)
    if state.bank is None:
        _move(state, params, slot)
    return innovation


def _move(state: State, params: Params, slot: Slot) -> None:
    """Learn the bias from the motion before the first rest."""
    motion = state.motion
    if slot.rest or slot.gap or slot.force is None:
        motion.interrupt()
    elif motion.take(slot.turn, slot.force):
        bias, variance = motion.bias
        sensitivity_sd = params.family.sensitivity_sd
        law = no_law()
        law["terms"] = 0.0
        law["terms"][0, :, 0] = bias
        sensitivities = np.full(3, sensitivity_sd @ sensitivity_sd / len(sensitivity_sd))
        law["covariance"] = np.diag(np.concatenate([np.zeros(2), sensitivities]))
        law["covariance"][0, :, 0, 0] = variance + EARTH_RATE**2
        law["degc"], law["reference"] = slot.degc, motion.force
        law["offset"] = slot.force - motion.force
        state.law = law


def _follow_turn(state: State, slot: Slot) -> None:
    bias = at_slot(state.law)
    known = np.where(np.isfinite(bias), bias, 0.0)
    state.turn = state.turn.then(slot.turn.less(known))
    state.lost |= slot.gap
    state.contrary.behind_gap |= slot.gap


def _leave(state: State, params: Params, at_s: float) -> None:
    """Note that the unit is at rest no more; what the last slot was like nobody knows."""
    if not state.zeroed:
        _filter_again(state, params)
        state.zeroed = state.bank is not None
        state.first = []
    state.at_rest, state.waiting = False, None
    state.white.begin()
    state.turn, state.lost, state.left_s = STILL, False, at_s


def _close(state: State, params: Params, slot: Slot) -> FloatArray:
    """End a slot at rest: let the one before count, and keep this one until the next."""
    attitude = state.attitude
    if state.fresh:
        drift = (slot.end_s - state.left_s) * float(sd_at_slot(state.law).max())
        state.arrival = state.arrival + attitude.come_to_rest(
            slot.force, params.place, state.turn, drift, state.lost
        )
        state.arrival = state.arrival + slot.undecided**2
        state.moved = Moved()
    usable = (slot.force is not None) == (attitude.gravity > 0.0)
    tilt = np.zeros(3)
    if usable and slot.force is not None:
        tilt = attitude.tilt(slot.force)
        usable = float(tilt @ tilt) < LARGEST_TILT**2
    if not usable:
        # It has turned, or the accelerometers have come or gone: as if it came to rest here.
        _leave(state, params, slot.end_s)
        state.at_rest = state.fresh = True
        return _nothing()
    innovation = _count(state, params, state.waiting) if state.waiting is not None else _nothing()
    state.waiting = Reading(slot, slot.rate - attitude.earth, tilt, state.fresh)
    state.fresh = False
    if state.bank is not None:
        _doubt(state, state.waiting)
    return innovation


def _doubt(state: State, reading: Reading) -> None:
    """Widen the sigma by a slot that contradicts the bias, before it counts: it may have jumped."""
    contrary, noise2 = state.contrary, state.noise.rate**2 / reading.slot.averaged_s
    if contrary.readings or surprise(state.law, reading.rate, noise2) > GATE:
        law = state.law.copy()
        bias = at_slot(law)
        known2 = (contrary.rate - bias) ** 2 if contrary.readings else 0.0
        unknown2 = np.maximum((reading.rate - bias) ** 2 - known2, 0.0)
        law["covariance"][0, :, 0, 0] += (contrary.jump or contrary.prior) * unknown2
        state.law = law


def _count(state: State, params: Params, reading: Reading) -> FloatArray:
    """Let a slot count: for the noise, and for the bias."""
    innovation = _nothing()
    if reading.fresh:
        state.white.begin()
    state.white.add(reading.slot.averaged_s, reading.rate, reading.tilt)
    noise = state.noise = _noise(state, params)
    if state.bank is not None:
        innovation = _take(state, params, state.bank, noise, reading)
    if not state.zeroed:
        state.first.append(reading)
        count = len(state.first)
        if count in REFILTERED or count == params.first_slots or state.bank is None:
            _filter_again(state, params)
        if count >= params.first_slots:
            state.zeroed, state.first = state.bank is not None, []
    if state.bank is not None:
        _show(state, params, noise, reading.slot)
    return innovation


def _noise(state: State, params: Params) -> Noise:
    """Return the noise; NaN while it is not known."""
    rate, tilt = params.white, params.tilt_noise / max(state.attitude.gravity, 1.0)
    if state.white.known:
        rate = np.where(np.isfinite(rate), rate, state.white.rate)
        tilt = tilt if math.isfinite(tilt) else state.white.tilt
    return Noise(rate, tilt)


def _filter_again(state: State, params: Params) -> None:
    """Filter all slots since the start anew, with the noise as it is known now."""
    noise, readings = _noise(state, params), state.first
    if not (readings and math.isfinite(noise.rate.sum() + noise.tilt)):
        return
    begin = readings[0].slot
    state.bank = filters.start(params.family.in_one_pose, 2 if params.learns else 1, noise.rate)
    filters.come_to_rest(state.bank, state.attitude.flat)
    state.evidence, state.unmixed_s, state.contrary = np.zeros(3), 0.0, Contrary()
    state.used_s, state.growth = begin.start_s, begin.growth
    state.at_degc, state.noted_degc = begin.degc.copy(), begin.degc.copy()
    state.reference = begin.force
    for k, reading in enumerate(readings):
        # A jump among them begins the bank anew, with no first slots any more.
        _take(state, params, state.bank, noise, replace(reading, fresh=reading.fresh and k > 0))
    _show(state, params, noise, readings[-1].slot)


def _changes(noted: FloatArray, now: FloatArray, least: float) -> FloatArray:
    """Return by how much each has changed since it was noted, if by `least`, and note it; NaN is no change.

    What comes late counts from where it came.
    """
    changes = [0.0, 0.0, 0.0]
    for j, (was, is_now) in enumerate(zip(noted.tolist(), now.tolist(), strict=True)):
        if not abs(is_now - was) < least and math.isfinite(is_now):
            changes[j] = is_now - was if math.isfinite(was) else 0.0
            noted[j] = is_now
    return np.array(changes)


def _coast(state: State, params: Params, noise: Noise, slot: Slot) -> None:
    """Bring the biases to the end of a slot, without a measurement."""
    assert state.bank is not None
    warming = _changes(state.at_degc, slot.degc, 0.0) if params.learns else _zero()
    difference = np.abs(_changes(state.noted_degc, slot.degc, MOVED_DEGC)) if params.learns else _zero()
    dt, growth = slot.end_s - state.used_s, slot.growth - state.growth
    if slot.lag_degc.any():
        slope2 = state.law["terms"][0, :, 1] ** 2 + state.law["covariance"][0, :, 1, 1]
        growth = growth + np.nan_to_num(slope2) * slot.lag_degc**2
    filters.wander(state.bank, noise.rate, dt, warming, difference, growth)
    state.growth, state.used_s = slot.growth, slot.end_s


def _offset(state: State, params: Params, force: FloatArray | None) -> FloatArray:
    """Return the specific force less that of the first rest, (3,); from the first change on it counts."""
    if force is None or state.reference is None or state.bank is None:
        return np.zeros(3)
    offset = np.asarray(force - state.reference)
    if len(state.bank.family.sensitivity_sd) < len(params.family.sensitivity_sd):
        if float(offset @ offset) < SAME_POSE**2:
            return np.zeros(3)
        filters.widen(state.bank, params.family)
    return offset


def _take(state: State, params: Params, bank: Bank, noise: Noise, reading: Reading) -> FloatArray:
    """Take a slot into the bank; return the normalised innovations, (3,)."""
    slot, dt = reading.slot, reading.slot.dt
    _coast(state, params, noise, slot)
    # Only at rest: nothing is learned of the bias while it moves, and variances that only add up help nobody.
    state.unmixed_s += dt
    if state.unmixed_s >= MIX_S:
        filters.mix(bank, state.unmixed_s)
        state.unmixed_s = 0.0
    flat = state.attitude.flat
    if reading.fresh:
        filters.come_to_rest(bank, flat, state.arrival)
        state.arrival = np.zeros(3)
    # Of the rotation about an axis gravity shows the horizontal part, the heading held shows the rest.
    at_rest = AtRest(
        dt,
        reading.rate,
        reading.tilt,
        _offset(state, params, slot.force),
        noise.rate**2 / slot.covered + flat * ACCEL_WALK**2,
        YAW_NOISE**2 + flat * (noise.tilt**2 / slot.covered - YAW_NOISE**2),
        flat * STILLNESS**2,
    )
    filters.integrate(bank, at_rest)
    innovation, surprises = filters.look(bank, at_rest)
    shown: FloatArray = np.where(state.chosen, innovation[-1], innovation[0])
    # Just after a contradiction the rotation is not known, and a rotation explains any rate for a while.
    contrary = state.contrary.readings and filters.disagreement(bank, at_rest).min(0).max() > GATE
    if contrary or surprises.min(0).max() > GATE:
        _refuse(state, params, bank, reading)
        return shown
    state.contrary = Contrary()
    likelihood = filters.take(bank, at_rest)
    if params.learns:
        fade = math.exp(-dt / FORGETTING_S)
        state.evidence = fade * state.evidence + likelihood[1] - likelihood[0]
    return shown


def _refuse(state: State, params: Params, bank: Bank, reading: Reading) -> None:
    """Note a slot that contradicts the bias; if that goes on, the bias is what these slots say."""
    contrary, attitude = state.contrary, state.attitude
    contrary.add(reading, reading.rate - at_slot(state.law), attitude.up, _noise(state, params).tilt)
    filters.come_to_rest(bank, attitude.flat)
    if contrary.has_jumped:
        state.jumps += 1
        state.first = contrary.readings[1:]
        _filter_again(state, params)
        state.first, state.zeroed = [], True


def _show(state: State, params: Params, noise: Noise, slot: Slot) -> None:
    """Make the law of the bank the one that is shown.

    It is that of both variants, with and without slope, each by its likelihood: a slope that is not proven
    may be there all the same.
    """
    assert state.bank is not None
    # It holds until the next slot ends; at rest the one that waits comes on top.
    ahead_s = slot.holds_s * (2.0 if state.at_rest else 1.0)
    mean, covariance = filters.law(state.bank, params.family, noise.rate, ahead_s)
    if params.learns:
        if state.at_rest:
            slope, variance = mean[1, :, 1], covariance[1, :, 1, 1]
            state.chosen = (slope**2 > SIGNIFICANCE * variance) & (state.evidence > EVIDENCE)
        mix_variants(mean, covariance, state.chosen, state.evidence)
    law = np.zeros(1, LAW)
    law["moved"] = np.inf
    law["terms"], law["covariance"], law["degc"] = mean[0], covariance[0], state.at_degc
    if state.reference is not None and slot.force is not None:
        law["reference"] = state.reference
        law["offset"] = _offset(state, params, slot.force) if state.at_rest else slot.force - state.reference
    if state.contrary.readings:
        law["covariance"][0, :, 0, 0] += state.contrary.jump * (state.contrary.rate - at_slot(law)) ** 2
    law["earth"] = params.place.turning
    if state.at_rest:
        # The first slot has what was undecided before.
        state.moved.see(at_slot(law), slot.undecided if slot.follows else np.zeros(3))
    else:
        bias = at_slot(law)
        state.moved.move(slot.undecided, slot.rate - bias, noise.rate / np.sqrt(slot.averaged_s))
        law["undecided"], law["moved"] = slot.undecided, state.moved.by(bias)
        law["turned"] = np.sqrt(turned_earth(state.attitude.up, params.place, state.turn))
    state.law = law
