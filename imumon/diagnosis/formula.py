"""A formula for what no known effect explains: up to three terms of causal operators over what was recorded.

A term is an operator, or one within another, over temperature, time, specific force and drivers.  It goes
through the search of the diagnosis as any effect does: the same likelihood, the same rules for what counts.
Its price for having been chosen is twice the logarithm of how many terms there are that are no longer than it
(extended BIC, Chen & Chen 2008).  A formula is a description, no cause, and is offered only when it predicts
a test that it has not seen.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from typing import ClassVar, Literal, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.candidates import Candidate, Part, Pool
from imumon.diagnosis.channel import Channel
from imumon.diagnosis.explaining import EXPLAINED, evidence_of_test, explained_share
from imumon.diagnosis.fitting import Fit, fit, score
from imumon.diagnosis.gains import PROVEN
from imumon.diagnosis.likelihood import GRID, Likelihood
from imumon.diagnosis.proven_by_test import woven
from imumon.diagnosis.selection import Finding, Search
from imumon.effects.base import TEMPERATURE, Drive, Effect, Memory, Scale, Survey
from imumon.effects.drift import HOUR_S
from imumon.effects.g_sensitivity import LEAST_RANGE
from imumon.effects.operators import first_order, play

MOST_TERMS = 3
MOST_DRIVERS = 3
"""Beside temperature, time and specific force: of more, those that say most alone or times one other."""
RATES_S = (15.0, 45.0, 135.0, 400.0, 1200.0)
"""Filters of a rate.  A slow one is how far the value is ahead of what follows it late."""
LAGS_S = (60.0, 180.0, 540.0, 1620.0)
LOOPS = (0.1, 0.3)
"""Half widths of a loop, in half spans."""
STEP = 0.55
"""Of the refinement, in the logarithm: half of the ratio of neighbouring times."""
TIME = "time"
FORCE = tuple(f"accel_{axis}" for axis in "xyz")
WHITE: Sequence[tuple[float, float]] = ((0.0, 0.0),)
Operator = Literal["signal", "rate", "lag", "leak", "loop", "size", "power", "product"]


@dataclass(frozen=True, slots=True)
class Node:
    """An operator over others, or a signal as (value - middle) / half span; of time, hours.

    The parameter is a filter or time constant in s, a half width in half spans, or an exponent.
    """

    operator: Operator
    of: tuple[Node, ...] = ()
    parameter: float = 0.0
    name: str = ""
    scale: Scale = Scale(0.0, 1.0)  # noqa: RUF009 - it is frozen

    @property
    def length(self) -> int:
        """Number of operators and signals."""
        return 1 + sum(node.length for node in self.of)

    def signals(self) -> Iterator[Node]:
        """Yield the signals."""
        if self.operator == "signal":
            yield self
        for node in self.of:
            yield from node.signals()

    def values(self, drive: Drive) -> FloatArray:
        """Return it over a run, (n,); no value depends on what comes after."""
        if self.operator == "signal":
            return (_recorded(self.name, drive) - self.scale.middle) / self.scale.half_span
        first, *others = (node.values(drive) for node in self.of)
        if self.operator == "product":
            return first * others[0]
        if self.operator == "size":
            return np.abs(first)
        if self.operator == "power":
            return np.asarray(first**self.parameter)
        if self.operator == "loop":
            return play(first, self.parameter, np.nan)
        if self.operator == "leak":  # nothing has leaked in before power-on
            start = drive.time_s[:1], first[:1], np.zeros(min(1, len(first)))
            return first_order(drive.time_s, first, self.parameter, *(float(part.sum()) for part in start))
        late = first_order(drive.time_s, first, self.parameter, np.nan, np.nan, np.nan)
        return late if self.operator == "lag" else (first - late) / self.parameter * 60.0

    def moved(self, factor: float) -> Iterator[Node]:
        """Yield it with one of its parameters that are no exponents multiplied."""
        if self.parameter and self.operator != "power":
            yield replace(self, parameter=self.parameter * factor)
        for at, node in enumerate(self.of):
            for other in node.moved(factor):
                yield replace(self, of=(*self.of[:at], other, *self.of[at + 1 :]))

    def __str__(self) -> str:
        """Return it as a person writes it."""
        inner = [str(node) for node in self.of]
        if self.operator == "signal":
            return self.name
        if self.operator == "size":
            return f"|{inner[0]}|"
        if self.operator == "power":
            return f"{inner[0]}^{self.parameter:.0f}"
        if self.operator == "product":
            return " ".join(inner)
        unit = "" if self.operator == "loop" else " s"
        return f"{self.operator}({inner[0]}, {self.parameter:.3g}{unit})"


def _recorded(name: str, drive: Drive) -> FloatArray:
    if name == TIME:
        return drive.time_s / HOUR_S
    if name not in FORCE:
        return drive.of(name)
    if drive.accel is None:
        raise ValueError(f"a formula of {name} needs the specific force")
    return drive.accel[:, FORCE.index(name)]


class Term(Effect):
    """A term of a formula as an effect: regressed, fitted and scored like any other; in no model file."""

    name: ClassVar[str] = "formula"
    node: Node

    @property
    def inputs(self) -> tuple[str, ...]:
        """What it is of."""
        return tuple(dict.fromkeys(node.name for node in self.node.signals() if node.name != TIME))

    def scale_of(self, driver: str) -> Scale | None:
        """Return where a driver went in training."""
        return next((node.scale for node in self.node.signals() if node.name == driver), None)

    def refined(self, survey: Survey, level: int) -> list[Self]:  # noqa: ARG002 - no limit depends on it
        """Return it with each of its parameters a little smaller and larger."""
        factors = np.exp(np.array([-STEP, STEP]) * 0.5**level).tolist()
        return [self.model_copy(update={"node": node}) for f in factors for node in self.node.moved(f)]

    def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - it is for whole runs
        """Return the column of a whole run."""
        return self.node.values(drive)[:, np.newaxis]


@dataclass(frozen=True, slots=True)
class Formula:
    """What describes a residual that no known effect explains."""

    terms: list[tuple[Node, float]]
    """With the coefficient, in the unit of the channel."""
    tried: int
    """Number of terms that it was chosen from."""
    gain: float
    """Over what was claimed, in BIC, after the price of the search."""
    fit: Fit
    """Of the declared model, what is claimed, and the terms."""
    test_before: float
    test_rms: float
    """What is left of the test with what is claimed, and with the formula."""

    @property
    def scales(self) -> dict[str, Scale]:
        """Middle and half span of its signals."""
        return {node.name: node.scale for term, _ in self.terms for node in term.signals()}

    def text(self, factor: float = 1.0) -> str:
        """Return the formula, its coefficients times a factor."""
        parts = [f"{coefficient * factor:+.3g} {node}" for node, coefficient in self.terms]
        return " ".join(parts).removeprefix("+")


def formula(channel: Channel, found: Search, before: Fit, beside: Sequence[Finding]) -> Formula | None:
    """Return the formula that describes what is left of a channel, if it predicts the test.

    Parameters
    ----------
    found : Search
        The search in the known effects, in its blocks.
    before : Fit
        The model with what is claimed.
    beside : sequence of Finding
        What is claimed, and what is fitted anew of a model that was given.
    """
    if not channel.test or any(woven(channel, run) for run in channel.test):
        return None
    searched = replace(found.channel, known=None)
    best: Formula | None = None
    few: list[Node] = []
    # The likelihood looks at what is fast; of a slow course least squares see more.
    for grid in (GRID, WHITE):
        search = Search(searched, found.survey, Likelihood(searched.train, grid), [])
        search.findings = list(beside)
        few = few or _few(search, signals(search.channel.pool, found.survey))
        search.tried = _priced(_terms(few))
        while not search.finished and len(search.findings) < len(beside) + MOST_TERMS:
            search.decide(search.table(), {})
        one = _tested(channel, before, beside, search)
        if one is not None and (best is None or one.test_rms < best.test_rms):
            best = one
    return best


def _tested(channel: Channel, before: Fit, beside: Sequence[Finding], search: Search) -> Formula | None:
    """Return the terms that a search found as a formula, less those that the test does as well without,
    unless the test shows otherwise."""
    new = _needed(channel, search.found, len(beside))
    if not new:
        return None
    after = fit(channel, [*search.found[: len(beside)], *new])
    left = score(channel, before, like=after), score(channel, after)
    if explained_share(left[0].rms, left[1].rms, channel.floor.sd) < EXPLAINED:
        return None
    parts = after.parts[-len(new) :]
    terms = [(part.effect.node, float(part.own[0, 0])) for part in parts if isinstance(part.effect, Term)]
    gain = sum(finding.gain for finding in search.findings if finding.candidate in new)
    return Formula(terms, len(search.tried), gain, after, left[0].rms, left[1].rms)


def _needed(channel: Channel, found: Sequence[Candidate], known: int) -> list[Candidate]:
    """Return the terms, which come after so many others, without those that the test does as well without."""
    beside, new = list(found[:known]), list(found[known:])
    while len(new) > 1:
        everything = fit(channel, [*beside, *new])
        fewer = [[other for other in new if other is not one] for one in new]
        gains = [evidence_of_test(channel, everything, fit(channel, [*beside, *less])) for less in fewer]
        least = min(range(len(new)), key=gains.__getitem__)
        if not gains[least] <= PROVEN:
            break
        new = fewer[least]
    return new


def signals(pool: Pool, survey: Survey) -> list[Node]:
    """Return what a formula may be of: time, temperature, drivers, and the specific force where it varies."""
    found = [Node("signal", name=TIME)]
    if survey.thermal:
        found.append(Node("signal", name=TEMPERATURE, scale=survey.scale))
    found += [Node("signal", name=name, scale=scale) for name, scale in survey.others.items()]
    if survey.accel_range >= LEAST_RANGE:
        found += [Node("signal", name=name, scale=Scale(0.0, survey.accel_range)) for name in FORCE]
    there = set(pool.runs[0].drives[pool.temperature].others) | {TIME, TEMPERATURE, *FORCE}
    return [node for node in found if node.name in there]


def _few(search: Search, found: Sequence[Node]) -> list[Node]:
    """Return the signals without those of most drivers, where there are many."""
    usual = [node for node in found if node.name in (TIME, TEMPERATURE, *FORCE)]
    others = [node for node in found if node not in usual]
    if len(others) > MOST_DRIVERS:
        gains = {
            node.name: max(search.gains(_candidates([node, *_alone(node), *_by_others(node, found)])))
            for node in others
        }
        others = sorted(others, key=lambda node: -gains[node.name])[:MOST_DRIVERS]
    return [*usual, *others]


def _alone(signal: Node) -> list[Node]:
    """Return one operator over a signal that varies; the specific force at rest has no rate."""
    if signal.name in FORCE:
        return [Node("power", (signal,), 2.0), Node("size", (signal,))]
    rates = [Node("rate", (signal,), seconds) for seconds in RATES_S]
    lags = [Node("lag", (signal,), seconds) for seconds in LAGS_S]
    loops = [Node("loop", (signal,), width) for width in LOOPS]
    powers = [Node("power", (signal,), exponent) for exponent in (2.0, 3.0)]
    return [*rates, *lags, *loops, *powers, *(Node("size", (one,)) for one in (signal, *rates[:-1]))]


def _by_others(signal: Node, found: Sequence[Node]) -> list[Node]:
    """Return the products of a signal with each of the others, and with the rate of the temperature."""
    rates = [Node("rate", (node,), RATES_S[1]) for node in found if node.name == TEMPERATURE]
    pairs = [sorted((signal, node), key=str) for node in (*found, *rates) if node != signal]
    return [Node("product", tuple(pair)) for pair in pairs]


def _terms(found: Sequence[Node]) -> list[Node]:
    """Return all terms over signals: operators alone, products of two, and what leaks away of either."""
    alone = [node for signal in found if signal.name != TIME for node in _alone(signal)]
    # A middling and a slow rate stand for the others, to be refined.
    factors = [*found, *(node for node in alone if _may_be_factor(node))]
    products = [Node("product", pair) for pair in combinations(factors, 2)]
    inner = [node for node in alone if node.operator in ("size", "power")]
    leaks = [Node("leak", (node,), tau) for node in (*found, *inner, *products) for tau in LAGS_S]
    lags = [Node("lag", (node,), tau) for node in inner for tau in LAGS_S]
    return [*found, *alone, *products, *leaks, *lags]


def _may_be_factor(node: Node) -> bool:
    rate = node.of[0] if node.operator == "size" else node
    return (rate.operator == "rate" and rate.parameter in (RATES_S[1], RATES_S[3])) or (
        node.operator == "power" and node.parameter == 2.0
    )


def _priced(nodes: Sequence[Node]) -> list[Candidate]:
    """Return terms as candidates that pay for how many there are that are no longer."""
    count = Counter(node.length for node in nodes)
    price = {
        length: 2.0 * float(np.log(sum(count[other] for other in count if other <= length)))
        for length in count
    }
    found = _candidates(nodes)
    return [replace(one, choice=price[node.length]) for one, node in zip(found, nodes, strict=True)]


def _candidates(nodes: Sequence[Node]) -> list[Candidate]:
    return [Candidate(Term.name, (Part(_term(node)),)) for node in nodes]


@lru_cache(maxsize=10_000)
def _term(node: Node) -> Term:
    """Return a term, the same of the same node: a pool keeps the columns of an effect for all channels."""
    return Term(node=node)
