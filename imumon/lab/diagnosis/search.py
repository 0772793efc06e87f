"""Search for effects that the bias model of each axis lacks: forward selection over all axes at once, then
backward elimination.

The model of an axis over R runs is y = X b + Z(theta) c + n, n ~ N(0, s² (W + r F + q R)): X the declared
curve, Z the columns of the effects with nonlinear parameters theta, W, F and R see `likelihood`.

    S(model)    = 2 ln L - (linear + nonlinear parameters) ln n - price of the choice     (BIC)
    gain(e | M) = S(M + e) - S(M)

with s, b and c at the maximum of L, r and q at that of a grid; beside e the noise is no larger (r + q) than
it is without it, so that an effect leaves less for the noise to explain.  A gain is twice
the logarithm of a Bayes factor: while nothing is missing it ever exceeds g with a probability of exp(-g / 2)
at most, however often it is tested (Ville 1939; Shafer et al. 2011, doi:10.1214/10-STS347).

One package has one physics, so what an effect gains on several axes adds up; the choice of one of e effects
on any of the sets of m axes costs 2 ln(e (2^m - 1)) (extended BIC: Chen & Chen 2008,
doi:10.1093/biomet/asn034).  Of a single axis the price is left out: its gain has to exceed `PROVEN` alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from imumon.effects.base import Survey
from imumon.lab.diagnosis.candidates import Candidate, Channel, Finding, Part, Scored, Table, candidates
from imumon.lab.diagnosis.likelihood import Likelihood, Noise, no_larger

PROVEN = 8.0
"""Gain above which an effect is proven: e^-4 by chance."""
CLOSE = 10.0
"""Families whose gains differ by less are not told apart."""
CLOSE_SHARE = 0.15
"""Nor those that differ by less than this share of the best gain: no regressor has exactly the shape of the
physics, and with a large effect the shape decides."""
MOST_NAMES = 3
"""Effects that are named in a set of those not told apart."""
STAGES = 5
"""Effects that are added to a channel, at most."""
PAIR_LIST = 4
"""Best candidates of each family that are tried in pairs."""
LEAST_SIZE = 0.3
"""White floors (rms) that an effect takes away, at least."""
SECOND_SHARE, JUMP_SHARE = 0.2, 0.5
"""And this share of what each effect before it takes away; a second jump in a run counts from the other share
on: the jumps of a telegraph noise are of one size."""
REFINEMENTS = 4
"""Levels of the pattern search; steps are 0.35 of those of the level before."""

Progress = Callable[[str], None] | None
"""Takes what is done next."""


# All axes of a sensor


def search(
    axes: Sequence[Channel], survey: Survey, names: Sequence[str], stages: int, progress: Progress
) -> list[Search]:
    """Find what the channels of one sensor, over the same training runs, lack of the effects of these names.

    The search begins with the effects of the present model that are fitted anew.  At most `stages` effects
    are added to a channel.
    """
    tried, pools = candidates(survey, names), {id(axis.pool): axis.pool for axis in axes}
    likelihoods = {key: Likelihood(pool) for key, pool in pools.items()}
    searches = [Search(axis, survey, likelihoods[id(axis.pool)], tried) for axis in axes]
    usual = len({one.family for one in tried if not one.choice})
    least = least_gain(usual, len(axes)) if len(axes) > 1 else PROVEN
    for one in searches:
        one.eliminate()
    for stage in range(stages):
        active = [one for one in searches if not one.finished]
        if not active:
            break
        if progress is not None:
            progress(f"effect {stage + 1} of {', '.join(one.channel.name for one in active)}")
        for one in active:
            one.tabulate(pairs=stages > 1)
        _add(active, least)
    for one in searches:
        one.eliminate()
    return searches


def least_gain(effects: int, channels: int) -> float:
    """Return the gain that proves one of so many effects on any set of so many channels."""
    return PROVEN + 2.0 * float(np.log(max(1, effects) * (2**channels - 1)))


def _add(active: Sequence[Search], least: float) -> None:
    """Add to each channel the effect that gains most on all the channels that show it; finish the others."""
    searches = {one.channel.name: one for one in active}
    tables = {name: dict(one.tables[-1]) for name, one in searches.items()}
    while (selection := select(tables, least)) is not None:
        for name in selection.channels:
            if searches[name].add(selection) or searches[name].finished:
                del tables[name]
            else:
                del tables[name][selection.names[0]]
    for name in tables:
        searches[name].finished = True


class Selection(NamedTuple):
    """Effects of which channels lack one, the one that is chosen first; these data do not separate them.
    `gain` is what it gains on all of these channels."""

    names: list[str]
    channels: list[str]
    gain: float


def select(tables: Mapping[str, Table], least: float) -> Selection | None:
    """Return the effect that gains most on all the channels that show it, if that is more than `least`.

    Of effects that gain alike, what carries over goes before an event.
    """
    names = dict.fromkeys(name for table in tables.values() for name in table)
    on = {name: [channel for channel in tables if _shows(tables[channel], name, least)] for name in names}
    total = {name: sum(tables[channel][name].gain for channel in on[name]) for name in names}
    proven = [name for name in names if total[name] > least]
    if not proven:
        return None

    def order(name: str) -> tuple[bool, float]:
        return tables[on[name][0]][name].candidate.scope != "event", total[name]

    chosen = max((name for name in proven if _near(total[name], max(total.values()))), key=order)
    channels = on[chosen]
    together = {
        name: sum(tables[channel][name].gain if name in tables[channel] else -np.inf for channel in channels)
        for name in names
    }
    apart = {chosen, *(tables[channel][chosen].partner for channel in channels)}
    alike = [name for name in names if together[name] > least and _near(together[name], total[chosen])]
    others = sorted((name for name in alike if name not in apart), key=lambda name: -together[name])
    return Selection([chosen, *others], channels, total[chosen])


def _shows(table: Table, name: str, least: float) -> bool:
    """Return whether a channel shows an effect, and does not prove another in its place.

    An event has a time of its own in each channel, so that each has to prove its own.
    """
    if name not in table:
        return False
    best = max(one.gain for one in table.values())
    own = PROVEN if table[name].candidate.scope == "event" else 0.0
    return table[name].gain > max(own, best - max(least, CLOSE_SHARE * best))


def _near(gain: float, best: float) -> bool:
    """Return whether a gain is too near to the best for a proof."""
    return best - gain < max(CLOSE, CLOSE_SHARE * best)


# One axis


class Search:
    """The search in one channel, and what it found.

    `findings` are the effects in the order in which they were found, those of the present model first;
    `many_events` means that a run has more than one event, such as two jumps, which no effect explains.
    `tables` has the best candidates of each stage, `stages` what was done, with the model that it led to and
    its gain (NaN without); `survey` is what the runs can show, `tried` what may be added.
    """

    def __init__(self, axis: Channel, survey: Survey, likelihood: Likelihood, tried: list[Candidate]) -> None:
        self.channel, self.survey, self.likelihood, self.tried = axis, survey, likelihood, tried
        again = [effect for effect in axis.known or () if effect not in axis.kept]
        self.findings = [Finding(Candidate((Part(effect),)), known=True) for effect in again]
        self.tables: list[Table] = []
        self.stages: list[tuple[str, Sequence[Candidate], float]] = []
        self.many_events = self.finished = False
        self._fitted: dict[tuple[int, ...], tuple[Channel, Sequence[Candidate], float, Noise]] = {}

    @property
    def model(self) -> list[Candidate]:
        """The candidates of the findings, beside the declared curve."""
        return [finding.candidate for finding in self.findings]

    def fitted(self, model: Sequence[Candidate]) -> tuple[float, Noise]:
        """Return the log-likelihood of the declared curve with candidates, and its noise."""
        key = (id(self.channel), *map(id, model))  # both are kept, so that no other has their id
        if key not in self._fitted:
            best = self.likelihood.best(self.channel.values, self.channel.design(model))
            self._fitted[key] = self.channel, model, *best
        return self._fitted[key][2:]

    def criterion(self, model: Sequence[Candidate] | None = None) -> float:
        """Return S of a model; None: of what was found so far."""
        model = self.model if model is None else model
        number = self.channel.design(model).shape[1] + sum(one.nonlinear for one in model)
        price = number * self.likelihood.price + sum(one.choice for one in model)
        return float(2.0 * self.fitted(model)[0] - price)

    def scored(self, tried: Sequence[Candidate], model: Sequence[Candidate]) -> list[Scored]:
        """Return candidates with their gains over a model.

        A state at power-on that is free must not be the effect: with it a candidate gains no more than it
        does beside that state alone.
        """
        if not tried:
            return []
        price, channel = self.likelihood.price, self.channel
        terms = [channel.pool.terms(candidate) for candidate in tried]
        starts = list(dict.fromkeys(tuple(start) for _, start in terms if start))
        every = [*([*own, *start] for own, start in terms), *map(list, starts)]
        before, noise = self.fitted(model)
        after = self.likelihood.scan(channel.values, channel.design(model), every, no_larger(noise))
        ratio = (2.0 * (after - before)).tolist()
        alone = dict(zip(starts, ratio[len(tried) :], strict=True))
        found = []
        for candidate, (own, start), value in zip(tried, terms, ratio, strict=False):
            fit = value - (len(own) + len(start)) * price
            gain = fit - candidate.nonlinear * price - candidate.choice
            if start:
                gain = min(gain, value - max(0.0, alone[tuple(start)]) - len(own) * price)
            found.append(Scored(candidate, gain, fit))
        return found

    def refined(self, candidate: Candidate, model: Sequence[Candidate]) -> Scored:
        """Return a candidate with its nonlinear parameters refined: a pattern search around the grid."""
        (best,) = self.scored([candidate], model)
        for level in range(REFINEMENTS):
            tried = best.candidate.neighbours(self.survey, level)
            best = max([best, *self.scored(tried, model)], key=attrgetter("gain"))
        return best

    def tabulate(self, pairs: bool) -> None:
        """Add a table: the best of each family beside what was found so far, at first in pairs as well."""
        scored = sorted(self.scored(self.tried, self.model), key=attrgetter("gain"))
        best = {one.family: one for one in scored}
        beside = self._beside_partner(scored, best) if pairs and not self.findings else {}
        self.tables.append({**best, **beside})

    def _beside_partner(self, scored: Sequence[Scored], best: Table) -> Table:
        """Return what effects gain beside the partner in the best pair, where both are needed.

        Two effects at once hide one another: the one that replaces both best may be neither.  A pair counts
        that gains more than any effect alone by more than the shape of that may be off.  Its partner is what
        does not carry over, else what gains less alone.
        """
        members = [self.refined(one.candidate, []) for one in best.values() if one.candidate.scope == "event"]
        single = [one for one in scored if len(one.candidate.parts) == 1]
        plain = [one for one in single if not (one.candidate.free_start or one.candidate.choice)]
        for family in best:
            members += [one for one in plain if one.family == family][-PAIR_LIST:]
        pairs = [two for two in combinations(members, 2) if two[0].family != two[1].family]
        both = [Candidate((*one.candidate.parts, *two.candidate.parts)) for one, two in pairs]
        found = list(zip([one.gain for one in self.scored(both, [])], pairs, strict=True))
        alone = max([PROVEN, *(one.gain for one in members)])
        gain, two = max(found, key=lambda pair: pair[0], default=(0.0, ()))
        if gain <= max([alone + max(PROVEN, CLOSE_SHARE * alone), *(one.gain for one in best.values())]):
            return {}
        partner = min(two, key=lambda one: (one.candidate.scope not in ("run", "event"), one.gain)).family
        beside = [
            one._replace(gain=gain - max(0.0, other.gain), partner=partner)
            for gain, pair in found
            for one, other in (pair, pair[::-1])
            if other.family == partner
        ]
        return {one.family: one for one in sorted(beside, key=attrgetter("gain"))}

    def add(self, selection: Selection) -> bool:
        """Add the best of a family with its parameters refined; return False where that is too small.

        Beside jumps that are too small, and with a second one in a run, nothing else is proven: the channel
        is finished.
        """
        table, name, model = self.tables[-1], selection.names[0], self.model
        best = self.refined(table[name].candidate, model)
        is_event = best.candidate.scope == "event"
        jumped = [one.parts[0].runs for one in model if one.family == name]
        again = is_event and best.candidate.parts[0].runs in jumped
        size, share = self._size(best.candidate, model), JUMP_SHARE if again else SECOND_SHARE
        least = [share * self._size_beside(one, best.candidate) for one in self.findings]
        if size < max(LEAST_SIZE * self.channel.floor.sd, self.channel.blind, *least):
            self.finished = is_event
            return False
        self.many_events |= again
        if self.many_events:
            self.finished = True
            return False
        there = {finding.name for finding in self.findings}
        others = [other for other in selection.names[1:] if other not in there]
        gain = max(best.gain, table[name].gain)  # beside a partner the latter is more
        rivals = {**{other: one.gain for other, one in table.items()}, name: gain}
        alike = {other: table[other].candidate for other in others[: MOST_NAMES - 1]}
        self.findings.append(Finding(best.candidate, gain, selection.gain, rivals, alike, size))
        if len(self.findings) > 1:
            self._refine(exchange=False)
        self.stages.append((name, self.model, gain))
        return True

    def _size(self, candidate: Candidate, model: Sequence[Candidate]) -> float:
        """Return the rms that a candidate takes away beside a model, by ordinary least squares."""
        without, with_it = (self.channel.residual_rms(one) for one in (model, [*model, candidate]))
        return float(np.sqrt(max(without**2 - with_it**2, 0.0)))

    def _size_beside(self, finding: Finding, candidate: Candidate) -> float:
        """Return the rms that a finding takes away beside the others and a candidate.

        One of the same family counts with what it took away alone, for two of a kind share it.
        """
        if finding.name == candidate.family and candidate.scope != "event":
            return finding.size
        return self._size(finding.candidate, [*self._beside(finding), candidate])

    def _beside(self, finding: Finding) -> list[Candidate]:
        """Return the candidates of the other findings."""
        return [other.candidate for other in self.findings if other is not finding]

    def eliminate(self) -> None:
        """Drop what others make needless, and refine what is left, each beside the others.

        An effect of the present model that these runs do not show, before anything is added, stays as it is.
        A finding gives way to one that fits as well, where that one is likelier beside what was found later.
        """
        for finding in list(self.findings):
            alone = len(self.findings) == 1 and not finding.known
            if not alone and self.criterion() - self.criterion(self._beside(finding)) <= PROVEN:
                self.findings.remove(finding)
                if finding.known and not self.tables:
                    (part,) = finding.candidate.parts
                    self.channel = replace(self.channel, kept=(*self.channel.kept, part.effect))
        before = [finding.name for finding in self.findings]
        if len(before) == 1 and not self.findings[0].known:
            return
        self._refine(exchange=True)
        if changed := [finding.name for finding in self.findings if finding.name not in before]:
            done = f"{' and '.join(changed)} fits better beside the rest"
            self.stages.append((done, self.model, float("nan")))

    def _refine(self, exchange: bool) -> None:
        """Refine each finding beside the others; with `exchange` one that fits as well may take its place."""
        for finding in self.findings:
            beside, names = self._beside(finding), [finding.name]
            names += finding.others if exchange else []
            tried = [one for one in self.tried if one.family in names and one.carries]
            best = max(self.scored([finding.candidate, *tried], beside), key=attrgetter("gain"))
            if best.family != finding.name:
                del finding.others[best.family]
                finding.others = {finding.name: finding.candidate, **finding.others}
            finding.candidate = self.refined(best.candidate, beside).candidate
