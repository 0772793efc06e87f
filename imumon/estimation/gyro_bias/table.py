"""What a quiet second is: rest with the bias as believed, a change of the bias, or a turn.

Two hypotheses of the bias are filtered side by side: `believed`, which learns while nothing contradicts it,
and `changed`, which begins when something does.  A second fits one of them if the means of the last 1, 4 and
16 s lie within `BEYOND` sigma of its law on each axis.  What believed is compared by is its law of 16 to 32 s
ago, which has not learned the beginning of a slow turn.  `ROWS` is the decision, first match; the docs print
the same table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import bank as filters
from imumon.estimation.gyro_bias.bank import Bank
from imumon.estimation.gyro_bias.law import Law
from imumon.estimation.gyro_bias.modes import Modes
from imumon.estimation.gyro_bias.odds import (
    Second,
    Witness,
    as_believed,
    by_compass,
    by_gravity,
    first_was_turn,
    probability_of_turn,
)

BEYOND = 4.5
"""Sigmas of an axis from which on a mean does not fit; with 4, drifts of a warm-up were disputed."""
AGAIN = 2.0
"""The same, of the old bias once the changed one fits as well."""
SPANS = (1, 4, 16)
"""Seconds whose means are compared."""
LAG_S = 16.0
"""Age of the law that compares, at least; twice as much at most."""
SETTLED_S = 4.0
"""A dispute that motion follows sooner was how the motion began."""
CERTAIN = 12.0
"""Log likelihood ratio from which on witnesses decide for a change of the bias."""
AGAINST = 2.0
"""Log likelihood ratio of a turn from which on a mean that fits a wide law is no rest."""
HISTORY_S = 64.0
"""Seconds whose headings are remembered: a turn of 0.6 °/s turns by `odds.COMPASS_RAD`."""
LEAST_WHITE = 1e-18
"""Variance of the mean of a second, (rad/s)²: less than any gyro has, and more than none."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a bias may do."""

    largest_jump: float
    """rad/s."""
    undecided_s: float
    """After which a change that fits is the bias, s."""
    accel_drift: float
    """Of the accelerometers, m/s³."""


class Version(NamedTuple):
    """A bank at a time, and its law."""

    bank: Bank
    law: Law


@dataclass(slots=True, eq=False)
class State:
    """Both hypotheses, and what is known of the dispute between them."""

    believed: Bank | None = None
    law: Law | None = None
    """Of believed, at its time."""
    older: tuple[Version, ...] = ()
    """Believed as it was, the first 16 to 32 s ago; empty in a dispute."""
    changed: Bank | None = None
    changed_law: Law | None = None
    earlier: tuple[Law, ...] = ()
    """Laws of changed, the first 4 to 8 s ago: what drifts on fits none of them."""
    law_then: Law | None = None
    """Of believed, when changed began: as time goes on it becomes vague, and would fit a steady turn."""
    fits_s: float = 0.0
    """How long the changed one has fitted, s."""
    since_s: float = math.nan
    """Begin of the dispute; NaN without one."""
    probability: float = 0.0
    """That the present rate is a turn."""
    turning: bool = False
    """Whether that is more likely; believed is shown then, else changed."""
    changes: int = 0
    """How often the rate has changed in the dispute."""
    first: FloatArray | None = None
    """Mean rate of the first rest, (3,); None once the unit has been in another pose."""
    pose: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """Specific force at the first rest, (3,)."""
    moved: bool = False
    """Whether it has moved since the last second that was decided on."""
    jumped: int = 0
    """How often the bias has jumped, by the table."""
    noise: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Variance of the mean of a second, of rates and specific forces, (6,)."""
    recent: list[Second] = field(default_factory=list)
    """Seconds of this rest, or of this rate, 16 at most."""
    history: list[Second] = field(default_factory=list)

    @property
    def disputed(self) -> bool:
        """Whether the rate contradicts the bias as believed."""
        return math.isfinite(self.since_s)


class Facts(NamedTuple):
    """The predicates of the table."""

    fits_believed: bool
    """And gravity does not show that it turns."""
    fits_changed: bool
    disputed: bool
    settled: bool
    """Whether at least two seconds of this rest fit."""
    certain: bool
    """Whether a witness, the rest detector or patience has decided for a change of the bias."""


Action = Callable[[State, Second, Version], None]


def _learn(state: State, now: Second, _: Version) -> None:
    """The bias is as believed, or so again: it learns, and the dispute is over."""
    assert state.believed is not None
    _take(state.believed, now)
    state.law = filters.law_of(state.believed)
    state.changed = state.changed_law = None
    state.since_s, state.turning, state.changes, state.probability = math.nan, False, 0, 0.0
    if state.moved or not state.older:
        version = Version(state.believed.copy(), state.law)
        state.older = (version, version)
    elif state.believed.time_s - state.older[1].bank.time_s >= LAG_S:
        state.older = (state.older[1], Version(state.believed.copy(), state.law))


def _accept(state: State, now: Second, compared: Version) -> None:
    """The bias has changed."""
    state.believed, state.first, state.older = state.changed, None, ()
    state.jumped += 1
    _learn(state, now, compared)


def _go_on(state: State, now: Second, _: Version) -> None:
    """The rate is the same as since it changed: whether that is the bias is not decided."""
    assert state.changed is not None
    _take(state.changed, now)
    state.changed_law = filters.law_of(state.changed)
    state.fits_s += now.seconds
    if now.end_s - state.earlier[1].time_s >= SETTLED_S:
        state.earlier = (state.earlier[1], state.changed_law)


def _begin(state: State, now: Second, compared: Version) -> None:
    """The rate is another: the dispute begins, or the rate changes again."""
    if not state.disputed:
        state.since_s, state.older = now.end_s, ()
        state.believed, state.law = compared
    if state.changed is not None:
        state.changes, state.recent = state.changes + 1, state.recent[-1:]
    assert state.believed is not None
    assert state.law is not None
    state.changed, state.law_then = state.believed.copy(), state.law.at(now.end_s, now.degc)
    filters.predict(state.changed, now.end_s, now.degc)
    filters.forget(state.changed)
    filters.update(state.changed, now.rate, now.force, now.seconds, weigh=False)
    state.changed_law, state.fits_s = filters.law_of(state.changed), now.seconds
    state.earlier = (state.changed_law, state.changed_law)


ROWS: tuple[tuple[str, Callable[[Facts], bool], Action], ...] = (
    ("rest", lambda f: f.fits_believed and not f.disputed, _learn),
    ("rest again", lambda f: f.fits_believed and f.settled, _learn),
    ("changed bias", lambda f: f.fits_changed and f.certain, _accept),
    ("undecided", lambda f: f.fits_changed, _go_on),
    ("another rate", lambda _: True, _begin),
)
"""Name, condition and what is done; the first that holds.  In the last two `probability_of_turn` sets which
bias is shown, and whether it is rest."""


def decide(
    state: State,
    limits: Limits,
    now: Second,
    arrived: FloatArray,
    reported: FloatArray | None = None,
    parts: Sequence[Second] = (),
) -> str:
    """Decide on a quiet second; return the name of the row.

    Parameters
    ----------
    arrived : array (3,)
        What has been added to the variance of the bias meanwhile, (rad/s)².
    reported : array (3,), optional
        The turn that may be a change of the bias, by the rest detector: then its odds hold.
    parts : sequence of Second, optional
        The slots of this second: in the first ones of a rest gravity bears witness by them.
    """
    assert state.believed is not None
    _widen(state, arrived)
    if state.moved:
        _settle_pose(state, now)
        if not state.disputed:
            state.older = (_present(state),) * 2
    state.recent = [*state.recent[1 - SPANS[-1] :], now]
    state.history = [one for one in state.history if now.end_s - one.end_s < HISTORY_S] + [now]
    compared = _present(state) if state.disputed else state.older[0]
    facts, probability = _facts(state, limits, now, compared, reported, parts)
    name, _, act = next(row for row in ROWS if row[1](facts))
    act(state, now, compared)
    if state.disputed:
        state.probability = probability
        state.turning = state.probability > 0.5 and reported is None
    state.moved = False
    return name


def _present(state: State) -> Version:
    """Return the believed bias as it is."""
    assert state.believed is not None
    assert state.law is not None
    return Version(state.believed, state.law)


def _facts(
    state: State,
    limits: Limits,
    now: Second,
    compared: Version,
    reported: FloatArray | None,
    parts: Sequence[Second],
) -> tuple[Facts, float]:
    """Return the predicates, and the probability of a turn, if the rate is not the bias as believed."""
    law = compared.law.at(now.end_s, now.degc)
    fits_changed = False
    if state.changed_law is not None:
        lately = state.recent[-max(int(state.fits_s), 1) - 1 :]
        fits_changed = _fit(BEYOND, state.earlier[0].at(now.end_s, now.degc), now, lately).fits
    if fits_changed and state.law_then is not None:
        fit = _fit(AGAIN, replace(law, covariance=state.law_then.covariance), now, state.recent)
    else:
        fit = _fit(BEYOND, law, now, state.recent)
    witness = Witness()
    if not fit.fits or state.disputed or len(state.history) <= SPANS[1]:
        seconds = state.recent if fit.fits else state.history[-SPANS[-1] :]
        witnesses = parts if parts and len(seconds) < 3 else seconds
        witness = _witness(state, limits, now, law, fit.difference, witnesses)
    patient = state.disputed and now.end_s - state.since_s > limits.undecided_s
    decided = patient and witness.evidence > -AGAINST if reported is None else not reported.any()
    probability = probability_of_turn(witness, limits.largest_jump, state.changes)
    certain = witness.evidence > CERTAIN or decided
    return Facts(
        fit.fits and witness.evidence > -AGAINST,
        fits_changed,
        state.disputed,
        len(state.recent) > 1,
        certain,
    ), probability


def _witness(
    state: State, limits: Limits, now: Second, law: Law, difference: FloatArray, lately: Sequence[Second]
) -> Witness:
    """Return what the law itself, gravity, a compass and the first mean say of a rate that differs from
    it."""
    bias, variance = law.bias(now.force, of_mean=True)
    turn = sum((one.seconds * (one.rate - bias) for one in lately[1:]), np.zeros(3))
    noise = float(state.noise[3:].max()) / lately[0].seconds
    evidence, part = by_gravity(lately, difference, turn, float(variance.max()), noise, limits.accel_drift)
    evidence += by_compass(_of_dispute(state), difference)
    steady = state.first is not None and state.fits_s >= SETTLED_S
    first = first_was_turn(state.first, now.rate) if steady and state.first is not None else 0.0
    return Witness(evidence, as_believed(part, variance) + first, part)


class _Fit(NamedTuple):
    fits: bool
    difference: FloatArray


def _fit(beyond: float, law: Law, now: Second, recent: Sequence[Second]) -> _Fit:
    """Compare the means of the last seconds with a law; the difference is that of up to 4 s."""
    bias, of_second = law.bias(now.force)
    _, of_mean = law.bias(now.force, of_mean=True)
    fits, difference = True, np.zeros(3)
    for span in SPANS:
        if len(recent) < span and span != SPANS[1]:
            continue
        part = recent[-span:]
        seconds = sum(one.seconds for one in part)
        off = sum((one.seconds * one.rate for one in part), np.zeros(3)) / seconds - bias
        spread = (of_second if len(part) == 1 else of_mean) + law.white / seconds
        fits &= bool((off * off <= beyond**2 * spread).all())
        if span <= SPANS[1]:
            difference = off
    return _Fit(fits, difference)


def _of_dispute(state: State) -> list[Second]:
    """Return the seconds with headings since the rate is what it is."""
    first_s = state.recent[0].end_s if len(state.recent) < SPANS[-1] else -math.inf
    return [
        one
        for one in state.history
        if one.end_s >= max(first_s, state.since_s if state.disputed else first_s)
    ]


def _settle_pose(state: State, now: Second) -> None:
    """Note whether it lies in another pose than at first: then it was in a hand, and no turn is left."""
    if state.first is not None and np.linalg.norm(now.force - state.pose) > 0.3:
        state.first = None


def _widen(state: State, variance: FloatArray) -> None:
    """Add to the variance of the bias, (3,)."""
    if not variance.any():
        return
    if state.older and state.older[0].bank is not state.believed:
        state.older = tuple(Version(version.bank, version.law.wider(variance)) for version in state.older)
    for bank in (state.believed, state.changed):
        if bank is not None:
            filters.widen(bank, variance)
    state.law = None if state.law is None else state.law.wider(variance)
    if state.changed_law is not None:
        state.changed_law = state.changed_law.wider(variance)
        state.earlier = tuple(law.wider(variance) for law in state.earlier)


def _take(bank: Bank, now: Second) -> None:
    if np.isnan(bank.force[0]):
        bank.force = now.force  # accelerometers that come late
    filters.predict(bank, now.end_s, now.degc)
    filters.update(bank, now.rate, now.force, now.seconds)


def begin(
    state: State, modes: Modes, seconds: Sequence[Second], noise: FloatArray, known_noise: bool = False
) -> None:
    """Begin with the first seconds at rest; noise, (6,), is the variance of the mean of a second."""
    first = seconds[0]
    state.noise = noise
    white = np.maximum(noise[:3], LEAST_WHITE)
    state.believed = filters.start(
        modes, white, known_noise, first.force, first.end_s - first.seconds, first.degc
    )
    state.law = filters.law_of(state.believed)
    state.older, state.recent = (), []
    for now in seconds:
        state.moved = False
        _learn(state, now, _present(state))
        state.recent = [*state.recent[1 - SPANS[-1] :], now]
    state.history = list(seconds)
    state.first, state.pose = np.mean([one.rate for one in seconds], axis=0), first.force


def move(state: State) -> None:
    """Note that the unit moves: a dispute of a few seconds was how the motion began."""
    if state.changed is not None and state.changed.time_s - state.since_s < SETTLED_S:
        state.changed = state.changed_law = None
        state.since_s, state.turning, state.older, state.probability = math.nan, False, (), 0.0
    state.moved, state.recent, state.history = True, [], []


def take_noise(state: State, noise: FloatArray) -> None:
    """Take another noise, (6,), as of a fan that starts."""
    state.noise = noise
    white = np.maximum(noise[:3], LEAST_WHITE)
    older = [version.bank for version in state.older]
    banks = {id(bank): bank for bank in (state.believed, state.changed, *older) if bank is not None}
    for bank in banks.values():
        if not bank.known_noise:
            filters.rescale(bank, white)
    state.older = tuple(Version(bank, filters.law_of(bank)) for bank in older)
    state.law = None if state.believed is None else filters.law_of(state.believed)
    state.changed_law = None if state.changed is None else filters.law_of(state.changed)


def shown(state: State, now_s: float, degc: FloatArray, force: FloatArray) -> tuple[Law, FloatArray]:
    """Return the more likely law at a time, and the ambiguity that the other adds to sigma, rad/s, (3,)."""
    assert state.law is not None
    believed = state.law.at(now_s, degc)
    if state.changed_law is None:
        return believed, np.zeros(3)
    changed = state.changed_law.at(now_s, degc)
    difference = changed.bias(force)[0] - believed.bias(force)[0]
    if state.turning:
        return believed, math.sqrt(1.0 - state.probability) * difference
    return changed, math.sqrt(state.probability) * difference
