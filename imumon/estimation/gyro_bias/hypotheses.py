"""What the mean of a quiet second is: the bias as before, a changed bias, or a turn.

Two hypotheses of the bias are filtered side by side: H0, *nominal*, the bias as predicted, which learns
while no mean contradicts it, and H1, *changed*, a bias that is another since a mean did.  A mean fits one of
them if the means of the last 1, 4 and 16 s lie within `FIT_SIGMAS` of its prediction on each axis.  Nominal
is compared as it was 16 to 32 s ago, when it had not learned the beginning of a slow turn.  `ROWS` is the
decision, first match; the docs print the same table.  Between H1 and a turn decides the caller's test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import bank as filter_bank
from imumon.estimation.gyro_bias.bank import Bank
from imumon.estimation.gyro_bias.modes import Modes
from imumon.estimation.gyro_bias.prediction import Prediction
from imumon.estimation.rest.quiet import Second

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
LAG_S = 16.0
"""Age of the nominal prediction that is compared, at least; twice as much at most."""
ONSET_S = 4.0
"""A contradiction that motion follows sooner was how the motion began."""
NEW_POSE = 0.3
"""m/s²: a specific force that differs by more from the first one is that of another pose."""
LEAST_WHITE = 1e-18
"""Variance of the mean of a second, (rad/s)²: less than any gyro has, and more than none."""


class Evidence(NamedTuple):
    """What a test has found about a mean and its difference from the nominal bias."""

    turns: bool = False
    """The log ratio is for a turn: no mean fits the nominal bias, however wide its prediction is."""
    changed: bool = False
    """It does not turn: the bias has changed."""
    probability: float = 0.0
    """That the difference is a turn, while neither is certain.  It decides what is shown, and whether that is
    rest; `turns` decides only what the filters learn."""


Test = Callable[[Prediction, FloatArray, bool], Evidence]
"""Of the prediction of the nominal bias, the difference from it, rad/s, (3,), and whether that fits."""


@dataclass(slots=True, eq=False)
class State:
    """Both hypotheses, and what is known about the choice between them."""

    nominal: Bank | None = None
    nominal_undo: Bank | None = None
    """Nominal before the last second, which is taken back where motion follows at once."""
    nominal_lagged: tuple[Bank, ...] = ()
    """Nominal as it was, the first 16 to 32 s ago; empty while it is contradicted."""
    changed: Bank | None = None
    changed_lagged: tuple[Prediction, ...] = ()
    """Predictions of changed, the first 4 to 8 s ago: a rate that drifts on does not fit them."""
    nominal_at_onset: Prediction | None = None
    """Of nominal, when changed began: as time goes on it becomes vague, and would fit a steady turn."""
    fits_s: float = 0.0
    """How long the changed one has fitted, s."""
    since_s: float = math.nan
    """Since when the nominal bias was contradicted last."""
    probability: float = 0.0
    """That the present rate is a turn."""
    changes: int = 0
    """How often the rate has changed since then."""
    first: FloatArray | None = None
    """Mean rate of the first rest, (3,); None once the unit has been in another pose."""
    pose: FloatArray = field(default_factory=lambda: np.full(3, np.nan))
    """Specific force at the first rest, (3,)."""
    moved: bool = False
    """Whether it has moved since the last second that was decided on."""
    jumped: int = 0
    """How often the bias has changed."""
    recent: list[Second] = field(default_factory=list)
    """Seconds of this rest, 16 at most."""
    alike: int = 0
    """How many of them are of the present rate.  At the first contradiction it goes on, as the onset is not
    known; it begins anew when the rate changes once more."""

    @property
    def contradicted(self) -> bool:
        """Whether the rate contradicts the nominal bias."""
        return self.changed is not None

    @property
    def turning(self) -> bool:
        """Whether a turn is more likely than a changed bias."""
        return self.probability > 0.5


class Facts(NamedTuple):
    """The predicates of the table."""

    fits_nominal: bool
    """And the test finds no turn."""
    fits_changed: bool
    contradicted: bool
    settled: bool
    """Whether the last 16 s are of one rate: that of a turn which comes to its end goes on changing."""
    accepted: bool
    """Whether the test has decided for a change of the bias."""
    likely_turn: bool
    """Whether the test finds that a turn is likely."""


Action = Callable[[State, Second, Bank], None]


def _learn(state: State, now: Second, _: Bank) -> None:
    """H0 holds, or holds again: nominal learns."""
    state.nominal_undo = _nominal(state)
    state.nominal = nominal = _updated(state.nominal_undo, now)
    state.changed, state.changes, state.probability = None, 0, 0.0
    if state.moved or not state.nominal_lagged:
        state.nominal_lagged = (nominal,) * 2
    elif nominal.time_s - state.nominal_lagged[1].time_s >= LAG_S:
        state.nominal_lagged = (state.nominal_lagged[1], nominal)


def _accept(state: State, now: Second, compared: Bank) -> None:
    """H1 holds: the changed bias becomes the nominal one."""
    state.nominal, state.first, state.nominal_lagged = state.changed, None, ()
    state.jumped += 1
    _learn(state, now, compared)


def _continue(state: State, now: Second, _: Bank) -> None:
    """The rate is the same since it changed; H1 or a turn is not decided."""
    assert state.changed is not None
    state.changed = _updated(state.changed, now)
    state.fits_s += now.seconds
    if now.end_s - state.changed_lagged[1].time_s >= ONSET_S:
        state.changed_lagged = (state.changed_lagged[1], state.changed.prediction)


def _begin(state: State, now: Second, compared: Bank) -> None:
    """The rate is another: H1 begins, or begins anew."""
    changed = compared.copy()
    state.nominal_at_onset = compared.prediction.at(now.end_s, now.degc)
    if state.changed is None:
        state.since_s, state.nominal_lagged, state.nominal, state.nominal_undo = now.end_s, (), compared, None
    else:
        state.changes, state.alike = state.changes + 1, 1
        filter_bank.take_noise(changed, state.changed)
    filter_bank.predict(changed, now.end_s, now.degc)
    filter_bank.forget(changed)
    filter_bank.update(changed, now.rate, now.force, now.seconds, weigh=False)
    state.changed, state.fits_s, state.changed_lagged = changed, now.seconds, (changed.prediction,) * 2


ROWS: tuple[tuple[str, Callable[[Facts], bool], Action], ...] = (
    ("rest", lambda f: f.fits_nominal and not f.contradicted, _learn),
    ("rest again", lambda f: f.fits_nominal and f.settled and not f.likely_turn, _learn),
    ("changed bias", lambda f: f.fits_changed and f.accepted, _accept),
    ("undecided", lambda f: f.fits_changed, _continue),
    ("another rate", lambda _: True, _begin),
)
"""Name, condition and action; the first that holds.  In the last two the probability of a turn sets which
bias is shown, and whether it is rest."""


def decide(state: State, now: Second, added: FloatArray, test: Test) -> None:
    """Decide on a quiet second.

    Parameters
    ----------
    added : array (3,)
        What has been added to the variance of the bias meanwhile, (rad/s)².
    """
    _widen(state, added)
    if state.moved:
        if np.linalg.norm(now.force - state.pose) > NEW_POSE:
            state.first = None  # it was in a hand, and not on a turntable
        if not state.contradicted:
            state.nominal_lagged = (_nominal(state),) * 2
    state.recent = [*state.recent[1 - SPANS[-1] :], now]
    state.alike = min(state.alike + 1, len(state.recent))
    compared = _nominal(state) if state.contradicted else state.nominal_lagged[0]
    facts, probability = _facts(state, now, compared, test)
    action = next(row[2] for row in ROWS if row[1](facts))
    action(state, now, compared)
    if state.contradicted:
        state.probability = probability
    state.moved = False


def _nominal(state: State) -> Bank:
    assert state.nominal is not None
    return state.nominal


def _facts(state: State, now: Second, compared: Bank, test: Test) -> tuple[Facts, float]:
    """Return the predicates, and the probability of a turn, if the rate is not the nominal bias."""
    prediction = compared.prediction.at(now.end_s, now.degc)
    alike = state.recent[-state.alike :]
    fits_changed, limits, sigmas = False, prediction, FIT_SIGMAS
    if state.changed is not None:
        lately = alike[-max(int(state.fits_s), 1) - 1 :]
        fits_changed, _ = _fit(FIT_SIGMAS, state.changed_lagged[0].at(now.end_s, now.degc), now, lately)
        if fits_changed and state.nominal_at_onset is not None:
            limits, sigmas = replace(prediction, covariance=state.nominal_at_onset.covariance), RETURN_SIGMAS
    fits, difference = _fit(sigmas, limits, now, alike)
    evidence = Evidence()
    # In the first seconds of a rest a wide prediction fits a turn as well.
    if not fits or state.contradicted or len(state.recent) <= SPANS[1]:
        evidence = test(prediction, difference, fits)
    facts = Facts(
        fits_nominal=fits and not evidence.turns,
        fits_changed=fits_changed,
        contradicted=state.contradicted,
        settled=len(alike) >= SETTLED_S,
        accepted=evidence.changed,
        likely_turn=evidence.probability > LIKELY_TURN,
    )
    return facts, evidence.probability


def _fit(
    sigmas: float, prediction: Prediction, now: Second, recent: Sequence[Second]
) -> tuple[bool, FloatArray]:
    """Compare the means of the last seconds with a prediction; the difference is that of up to 4 s."""
    bias, of_second = prediction.bias(now.force)
    _, of_mean = prediction.bias(now.force, of_mean=True)
    fits, difference = True, np.zeros(3)
    for span in SPANS:
        if len(recent) < span and span != SPANS[1]:
            continue
        part = recent[-span:]
        seconds = sum(one.seconds for one in part)
        off = sum((one.seconds * one.rate for one in part), np.zeros(3)) / seconds - bias
        spread = (of_second if len(part) == 1 else of_mean) + prediction.white / seconds
        fits &= bool((off * off <= sigmas**2 * spread).all())
        if span <= SPANS[1]:
            difference = off
    return fits, difference


def _banks(state: State) -> list[Bank]:
    """Return each bank once: an older one may be the nominal one itself."""
    banks = (state.nominal, state.nominal_undo, state.changed, *state.nominal_lagged)
    return list({id(bank): bank for bank in banks if bank is not None}.values())


def _widen(state: State, variance: FloatArray) -> None:
    """Add to the variance of the bias, (3,)."""
    if variance.any():
        for bank in _banks(state):
            filter_bank.widen(bank, variance)
        state.changed_lagged = tuple(prediction.wider(variance) for prediction in state.changed_lagged)


def _updated(bank: Bank, now: Second) -> Bank:
    """Return the filters after a second at rest."""
    bank = bank.copy()
    if np.isnan(bank.force[0]):
        bank.force = now.force  # accelerometers that come late
    filter_bank.predict(bank, now.end_s, now.degc)
    filter_bank.update(bank, now.rate, now.force, now.seconds)
    return bank


def begin(
    state: State, modes: Modes, seconds: Sequence[Second], white: FloatArray, known_noise: bool = False
) -> None:
    """Begin with the first seconds at rest; white, (3,), is the variance of the mean rate of a second."""
    first = seconds[0]
    state.nominal = filter_bank.start(
        modes, white, known_noise, first.force, first.end_s - first.seconds,
        first.degc,
    )  # fmt: skip
    for now in seconds:
        _learn(state, now, state.nominal)
    state.nominal_lagged, state.nominal_undo, state.moved = (state.nominal,) * 2, None, False
    state.recent, state.alike = list(seconds), len(seconds)
    state.first, state.pose = np.mean([one.rate for one in seconds], axis=0), first.force


def move(state: State, undo: bool) -> None:
    """Note that the unit moves: a contradiction of a few seconds was how the motion began.

    Parameters
    ----------
    undo : bool
        Whether the last second is taken back: what moves the unit may begin before it is noticed.
    """
    if undo and state.nominal_undo is not None:
        state.nominal = state.nominal_undo
    state.nominal_undo = None
    if state.changed is not None and state.changed.time_s - state.since_s < ONSET_S:
        state.changed, state.nominal_lagged, state.probability = None, (), 0.0
    state.moved, state.recent, state.alike = True, [], 0


def take_noise(state: State, white: FloatArray) -> None:
    """Take another white noise, (3,), as of a fan that starts."""
    for bank in _banks(state):
        if not bank.known_noise:
            filter_bank.rescale(bank, white)


def shown(state: State, now_s: float, degc: FloatArray, force: FloatArray) -> tuple[Prediction, FloatArray]:
    """Return the more likely prediction at a time, and what the other adds to sigma, rad/s, (3,)."""
    nominal = _nominal(state).prediction.at(now_s, degc)
    if state.changed is None:
        return nominal, np.zeros(3)
    changed = state.changed.prediction.at(now_s, degc)
    difference = changed.bias(force)[0] - nominal.bias(force)[0]
    if state.turning:
        return nominal, math.sqrt(1.0 - state.probability) * difference
    # The variance of the mixture: that of the nominal bias, which may be vague by then, counts as well.
    excess = np.maximum(nominal.bias(force)[1] - changed.bias(force)[1], 0.0)
    return changed, np.copysign(np.sqrt(state.probability * (difference**2 + excess)), difference)
