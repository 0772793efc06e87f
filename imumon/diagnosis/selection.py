"""Which effects the declared model lacks: one after another, each channel by itself and with those that
agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.candidates import Candidate, Part, Term, candidates
from imumon.diagnosis.channel import Channel, residual_rms
from imumon.diagnosis.fit import MATERIAL
from imumon.diagnosis.gains import (
    CLOSE,
    CLOSE_SHARE,
    PROVEN,
    SHORT_LIST,
    Leader,
    Scored,
    Table,
    families,
    joined_events,
    needed_in_pairs,
    pairs_of,
    pooled_gains,
)
from imumon.diagnosis.likelihood import Likelihood, Noise, coarse_grid, fine_grid
from imumon.effects.base import Effect, Survey

LEAST_EVIDENCE = 4.0
"""A channel with less is never made to agree with the others."""
MOST_STAGES = 6
MOST_NAMES = 3
SECOND_SHARE = 0.2
"""A further effect counts when what it takes away is at least this share of what the largest one does beside
it.  What they have in common counts for neither: the one that was found first has taken it all."""
LEAST_SIZE = 0.3
"""And at least this many white floors (rms)."""
MISFIT = 1.5
"""A winner that leaves more than so many floors does not fit by itself: then a gap of gains is no proof."""
ALIKE = 1.25
"""Residuals that differ by less than this factor are alike."""
REFINEMENTS = 4

Progress = Callable[[str], None]


@dataclass(slots=True)
class Finding:
    """An effect that was found in a channel."""

    candidate: Candidate
    """With refined parameters; coefficients come with the fit."""
    gain: float
    """Over the model so far, in BIC."""
    pooled_gain: float
    """The same over all channels that show something, with shared nonlinear parameters."""
    rivals: dict[str, float]
    """Gain of every family at that stage."""
    alike: list[str]
    """Families that cannot be told apart from it, it among them; empty when there is no other."""
    size: float
    """rms of what it takes away from the residual."""
    by_test: bool = False
    """Whether the test alone proves it."""
    others: dict[str, Candidate] = field(default_factory=dict)
    """The best of each other family that is not told apart from it."""
    known: bool = False
    """Whether it is of the model that was given, and fitted anew."""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.family


@dataclass(frozen=True, slots=True)
class Step:
    """A turn of the loop: what was done, the model that it led to, its gain in BIC where there was one, and
    what the model leaves (rms) once it is fitted."""

    done: str
    model: Sequence[Candidate]
    gain: float = float("nan")
    train_rms: float = float("nan")
    test_rms: float = float("nan")


def search(
    channels: Sequence[Channel], survey: Survey, names: Sequence[str], progress: Progress | None = None
) -> list[Search]:
    """Find what the channels of one sensor lack, of the effects of these names.

    Parameters
    ----------
    channels : sequence of Channel
        Three axes of a sensor, or fewer, over the same training runs.
    survey : Survey
        What the runs can show.
    """
    likelihood, tried = Likelihood(channels[0].train), candidates(survey, names)
    searches = [Search(channel, survey, likelihood, tried) for channel in channels]
    for stage in range(MOST_STAGES):
        active = [one for one in searches if not one.finished]
        if not active:
            break
        if progress is not None:
            progress(f"effect {stage + 1} of {', '.join(one.channel.name for one in active)}")
        tables = [one.table() for one in active]
        pooled = pooled_gains(tables, likelihood.price)
        for one, table in zip(active, tables, strict=True):
            one.decide(table, pooled)
    for one in searches:
        one.tidy()
    return searches


class Search:
    """The search in one channel, and what it found.

    `findings` are the effects in the order in which they were found, those of a model that was given first;
    `many_events` says that a run has more than one event, such as two jumps, which no effect explains.
    `turns` are those of the loop; `refit` says whether the curve that was given pays for being fitted anew;
    `survey` is what the runs can show, `tried` what may be added; `first` and `last` are what that did first
    and last.
    """

    def __init__(
        self, channel: Channel, survey: Survey, likelihood: Likelihood, tried: Sequence[Candidate]
    ) -> None:
        self.channel = channel
        self.findings: list[Finding] = []
        self.turns: list[Step] = []
        self.many_events = False
        self.finished = False
        self.first: Table | None = None
        self.last: Table | None = None
        self.refit = False
        # Where a curve is known, and off the means, another cannot take its place.
        self.tried = [one for one in tried if not (one.whole and channel.known is not None)]
        self.survey, self.likelihood = survey, likelihood
        self._known: dict[tuple[int, ...], tuple[list[Candidate], float, Noise]] = {}
        if channel.known is not None:
            self._begin_with(channel.known)

    @property
    def found(self) -> list[Candidate]:
        """The candidates of the findings."""
        return [finding.candidate for finding in self.findings]

    def of_family(self, name: str) -> list[Candidate]:
        """Return what was tried of a family, of one part each and with no free start."""
        return [
            one for one in self.tried if one.family == name and len(one.parts) == 1 and not one.free_start
        ]

    def null(self) -> tuple[float, Noise]:
        """Return the log-likelihood of the model so far, and its noise."""
        found = self.found
        key = tuple(map(id, found))  # the candidates are kept, so that no other has their id
        if key not in self._known:
            best = self.likelihood.best(self.channel.values, self.channel.design(found))
            self._known[key] = found, *best
        return self._known[key][1:]

    def noise_sd(self) -> float:
        """Return the white noise of a block that the likelihood of the model so far is largest with."""
        return self.likelihood.scale(self.channel.values, self.channel.design(self.found), self.null()[1])

    def noise_gain(self) -> float:
        """Return by how much slow noise is likelier than white noise alone, in BIC."""
        values, base = self.channel.values, self.channel.design(self.found)
        white = self.likelihood.at(values, base, (0.0, 0.0))
        return 2.0 * (self.null()[0] - white) - 2.0 * self.likelihood.price

    def _begin_with(self, known: Sequence[Effect]) -> None:
        """Fit anew what the runs show of a model that was given; the rest of it stays as it is."""
        given = self.channel.as_given()
        before = 2 * self.likelihood.best(given.values, given.base)[0]
        for effect in known:
            candidate = Candidate(effect.label, (Part(effect),))
            self.findings.append(Finding(candidate, 0.0, 0.0, {}, [], 0.0, known=True))
        for finding in list(self.findings):
            if self._worth(finding) <= PROVEN:
                self.findings = [other for other in self.findings if other is not finding]
                effect = finding.candidate.parts[0].effect
                self.channel = replace(self.channel, kept=(*self.channel.kept, effect))
                self._known.clear()
        self._refine()
        gain = self._evidence() - before - (self.channel.declared.degree) * self.likelihood.price
        self.refit = gain > PROVEN
        if self.refit:
            self.turns.append(Step("what was given is fitted anew", self.found, gain))

    def resume(self, kept: Sequence[Finding], refuted: Sequence[str]) -> bool:
        """Look again beside what is kept, without what the test has refuted; tell whether there is more.

        The channel goes by itself now: with what others have in common it was led wrong.  What is kept may be
        refined or exchanged for another effect here; the findings that were given stay as they were judged.
        """
        begun = [replace(one) for one in kept]
        self.findings = list(begun)
        self.turns.append(Step(f"the test refutes {', '.join(refuted)}", self.found))
        self.tried = [one for one in self.tried if one.family not in refuted]
        self.finished = self.many_events
        while not self.finished and len(self.findings) < len(kept) + MOST_STAGES:
            self.decide(self.table(), {})
        self.tidy()
        return {id(one) for one in self.findings} != {id(one) for one in begun}

    # One stage

    def table(self) -> Table:
        """Return the gains of everything that may be added to the model so far."""
        noise = self.null()[1]
        scored = self._gains(self.tried, coarse_grid(noise))
        short = {id(one) for group in families(scored, SHORT_LIST).values() for one in group}
        places = [at for at, one in enumerate(scored) if id(one) in short]
        fine = self._gains([scored[at].candidate for at in places], fine_grid(noise))
        for at, one in zip(places, fine, strict=True):
            best = max(one.gain, scored[at].gain), max(one.fit, scored[at].fit)
            scored[at] = Scored(one.candidate, *best, one.noise)
        scored += self._gains(joined_events(scored), fine_grid(noise))
        leaders = {name: Leader(group[0], group[0].gain) for name, group in families(scored, 1).items()}
        if not self.findings:
            leaders |= self._pairs(scored)
        return Table(scored, len(self.tried), leaders)

    def _gains(self, tried: Sequence[Candidate], grid: Sequence[Noise]) -> list[Scored]:
        """Return the candidates with their gain: over the model so far, and over their free start alone."""
        if not tried:
            return []
        pool, price, null = self.channel.pool, self.likelihood.price, self.null()[0]
        both = [pool.terms(candidate) for candidate in tried]
        starts = list(dict.fromkeys(tuple(start) for _, start in both if start))
        terms = [*([*defining, *start] for defining, start in both), *map(list, starts)]
        whole = [*(candidate.whole for candidate in tried), *(False for _ in starts)]
        likelihood, noise = self._scan(terms, whole, grid)
        ratio = (2 * (likelihood - null)).tolist()
        alone = dict(zip(starts, ratio[len(tried) :], strict=True))
        scored = []
        for at, (candidate, (defining, start)) in enumerate(zip(tried, both, strict=True)):
            more = len(defining) - self._freed([candidate])
            fit = ratio[at] - (more + len(start)) * price
            gain = fit - candidate.nonlinear * price - candidate.choice
            if start:
                gain = min(gain, ratio[at] - max(0.0, alone[tuple(start)]) - more * price)
            scored.append(Scored(candidate, gain, fit, noise[at]))
        return scored

    def _scan(
        self, terms: Sequence[Sequence[Term]], whole: Sequence[bool], grid: Sequence[Noise]
    ) -> tuple[FloatArray, list[Noise]]:
        """Return the best log-likelihood with each group of terms, those of a whole curve in its place, and
        its noise."""
        channel, found = self.channel, np.empty(len(terms))
        noise = [grid[0]] * len(terms)
        for kind in set(whole):
            places = [at for at, one in enumerate(whole) if one == kind]
            base, groups = channel.design(self.found, whole=kind), [terms[at] for at in places]
            found[places], best = self.likelihood.scan(channel.values, base, channel.pool, groups, grid)
            for at, point in zip(places, best, strict=True):
                noise[at] = point
        return found, noise

    def _freed(self, more: Sequence[Candidate]) -> int:
        """Return how many coefficients of the declared curve are freed by more beside what was found."""
        already = any(finding.candidate.whole for finding in self.findings)
        return 0 if already else self.channel.freed(more)

    def _pairs(self, scored: Sequence[Scored]) -> dict[str, Leader]:
        """Look for two effects at once; a jump that is one of them may be anywhere in a block."""
        leaders = [group[0] for group in families(scored, 1).values()]
        jumps = [self.refined(one) for one in leaders if one.candidate.scope == "event"]
        pairs, pool = pairs_of([*scored, *jumps]), self.channel.pool
        if not pairs:
            return {}
        null, noise = self.null()
        terms = [[term for one in pair for term in pool.terms(one.candidate)[0]] for pair in pairs]
        both = [[one.candidate for one in pair] for pair in pairs]
        whole = [any(one.whole for one in pair) for pair in both]
        likelihood, _ = self._scan(terms, whole, coarse_grid(noise, (0.3, 0.0)))
        number = [
            len(group) + sum(one.nonlinear for one in pair) - self._freed(pair)
            for pair, group in zip(both, terms, strict=True)
        ]
        choice = np.array([sum(one.candidate.choice for one in pair) for pair in pairs])
        gains = 2 * (likelihood - null) - np.array(number) * self.likelihood.price - choice
        return needed_in_pairs(pairs, gains.tolist(), max(one.gain for one in scored))

    def decide(self, table: Table, pooled: Mapping[str, float]) -> None:
        """Add the effect that explains most, unless none is proven and large enough."""
        self.first, self.last, leaders = self.first or table, table, table.leaders
        order = sorted(leaders, key=lambda name: -leaders[name].gain)
        while order and leaders[order[0]].gain > PROVEN:
            name = self._choose(order, leaders, pooled)
            finding = self._finding(leaders[name], table, pooled)
            if finding is None:
                order = [other for other in order if other != name and leaders[other].gain > PROVEN]
                continue
            if self._second_event(finding):
                break
            self.findings.append(finding)
            self.turns.append(Step(finding.name, self.found, finding.gain))
            return
        self.finished = True

    def _choose(
        self, order: Sequence[str], leaders: Mapping[str, Leader], pooled: Mapping[str, float]
    ) -> str:
        """Return the family to add: one that is there already where it does nearly as well, else what is
        shared.

        A second event comes last: what carries over goes first where it does nearly as well.
        """
        best = leaders[order[0]].gain
        slack = max(CLOSE, 0.3 * best)
        names = dict.fromkeys(finding.name for finding in self.findings)
        events = [finding.name for finding in self.findings if finding.candidate.scope == "event"]
        if order[0] in events:
            lasting = next((name for name in order if name not in events), None)
            return lasting if lasting and leaders[lasting].gain > max(PROVEN, best - slack) else order[0]
        for name in names:
            if name not in events and name in order and leaders[name].gain > max(PROVEN, best - slack):
                again = leaders[name].scored.candidate.parts[0].effect
                near = [other for other in order if leaders[other].gain > max(PROVEN, best - CLOSE)]
                return next((other for other in near if again.passes_for(other)), name)
        candidate = leaders[order[0]].scored.candidate
        for name in order[1:]:
            usual = candidate.choice and not leaders[name].scored.candidate.choice
            simpler = candidate.contains(name) or usual
            if simpler and leaders[name].gain > max(PROVEN, best - CLOSE):
                return name
        shared = max((name for name in order if name in pooled), key=pooled.__getitem__, default=order[0])
        if leaders[shared].gain > LEAST_EVIDENCE and _near(leaders[shared].gain, best):
            return shared
        return order[0]

    def _finding(self, leader: Leader, table: Table, pooled: Mapping[str, float]) -> Finding | None:
        """Return the effect with refined parameters, or None when it is too small beside those found."""
        name = leader.scored.family
        best = self.refined(leader.scored)
        candidate, refined = best.candidate, best.gain
        before, after = self._left(), self._left(candidate)
        size = float(np.sqrt(max(before**2 - after**2, 0.0)))
        if candidate.scope == "event" and not leader.partner and not self._stands_out(best):
            return None
        least = (
            0.0 if self._finer(candidate, before) else SECOND_SHARE * self._largest_beside(candidate, after)
        )
        if size < max(LEAST_SIZE * self.channel.floor.sd, least, self.channel.blind):
            return None
        rivals = {other: one.gain for other, one in table.leaders.items()}
        rivals[name] = max(leader.gain, refined)
        alike = self._alike(leader, table, pooled, after)
        others = {other: table.leaders[other].scored.candidate for other in alike[1:]}
        pooled_gain = pooled.get(name, leader.gain)
        return Finding(candidate, rivals[name], pooled_gain, rivals, alike, size, others=others)

    def _largest_beside(self, candidate: Candidate, left: float) -> float:
        """Return the largest rms that one of the findings takes away beside a candidate, which leaves this.

        Without the finding the candidate has the parameters of its family that suit it best then.  One of
        the same family would then be the finding itself, whose size counts as it was found.
        """
        others = self.of_family(candidate.family) if candidate.nonlinear else []
        found, sizes = self.findings, [0.0]
        for finding in found:
            self.findings = [other for other in found if other is not finding]
            without = min(map(self._left, [candidate, *others]))
            beside = float(np.sqrt(max(without**2 - left**2, 0.0)))
            sizes.append(finding.size if finding.name == candidate.family else beside)
        self.findings = found
        return max(sizes)

    def _stands_out(self, best: Scored) -> bool:
        """Tell whether a jump is proven even with noise that jumps by itself."""
        channel, price = self.channel, self.likelihood.price
        terms = channel.pool.terms(best.candidate)[0]
        ratio = self.likelihood.beyond_tails(
            channel.values,
            channel.design(self.found),
            channel.pool.matrix(terms),
            [self.null()[1], best.noise],
        )
        return ratio - (len(terms) + best.candidate.nonlinear) * price > PROVEN

    def _finer(self, candidate: Candidate, left: float) -> bool:
        """Tell whether a candidate says more exactly what is there already, where that does not fit yet."""
        if self.channel.known is not None and candidate.parts[0].effect.is_curve:
            return True  # a curve that was fitted with an effect in it has a share of that in its shape
        again = candidate.family in (finding.name for finding in self.findings)
        return again and candidate.scope == "shared" and left > MATERIAL * self.channel.floor.sd

    def _alike(self, leader: Leader, table: Table, pooled: Mapping[str, float], left: float) -> list[str]:
        """Return the families that are not told apart from the one chosen, by gain or by what they leave."""
        chosen, best, close = leader.scored.family, table.best, []
        for name, other in table.leaders.items():
            if name == chosen or other.gain <= PROVEN or _beside(leader, name, other):
                continue
            if other.scored.candidate.contains(chosen):
                continue
            near = _near(other.gain, best)
            if name in pooled and chosen in pooled:
                # What the axes agree on goes first, but not against what fits this one better.
                near &= other.gain >= leader.gain or _near(pooled[name], pooled[chosen])
                # And what they leave open together, the shape of one of them does not settle.
                near |= pooled[chosen] - pooled[name] < CLOSE
            if not near and left > MISFIT * self.channel.floor.sd and other.gain > 0.5 * best:
                near = self._left(other.scored.candidate) < ALIKE * left
            if near:
                close.append((pooled.get(name, other.gain), name))
        names = [name for _, name in sorted(close, reverse=True)[: MOST_NAMES - 1]]
        return [chosen, *names] if names else []

    def _second_event(self, finding: Finding) -> bool:
        """Tell, and remember, whether a run has a second jump that is not small beside the first."""
        same = [other for other in self.findings if other.name == finding.name]
        taken = {run for other in same for part in other.candidate.parts for run in part.runs}
        if finding.candidate.scope == "event":
            self.many_events |= any(run in taken for part in finding.candidate.parts for run in part.runs)
        return self.many_events

    def refined(self, best: Scored) -> Scored:
        """Return the candidate with its nonlinear parameters refined."""
        for level in range(REFINEMENTS):
            tried = [best.candidate, *best.candidate.neighbours(self.survey, level)]
            best = max(self._gains(tried, self.likelihood.neighbours(best.noise)), key=_gain)
            if len(tried) == 1:
                break
        return best

    def _left(self, *more: Candidate) -> float:
        """Return the rms that ordinary least squares leaves with what was found and more."""
        return residual_rms(self.channel.design([*self.found, *more]), self.channel.values)

    # At the end

    def tidy(self) -> None:
        """Drop what later findings made needless, and refine what is left."""
        self._drop_needless()
        self._exchange()
        if len(self.findings) > 1:
            self._refine()
        if self.channel.known is not None:
            self._keep_curve()

    def _keep_curve(self) -> None:
        """Leave the curve that was given as it is, but for a constant, unless fitting it anew pays."""
        fitted, price = self.channel, self.channel.declared.degree * self.likelihood.price
        before = self._evidence() - price
        self._known.clear()
        self.channel = replace(fitted, declared=replace(fitted.declared, degree=0))
        if any(finding.candidate.parts[0].effect.is_curve for finding in self.findings):
            self.channel = fitted
        elif before - self._evidence() > PROVEN:
            self._known.clear()
            self.channel = fitted

    def _refine(self) -> None:
        """Refine each effect beside the others."""
        everything, noise = list(self.findings), self.null()[1]
        for finding in everything:
            self.findings = [other for other in everything if other is not finding]
            finding.candidate = self.refined(Scored(finding.candidate, 0.0, 0.0, noise)).candidate
        self.findings = everything

    def _drop_needless(self) -> None:
        if len(self.findings) < 2:
            return
        for finding in list(self.findings):
            if self._worth(finding) <= PROVEN:
                self.findings = [other for other in self.findings if other is not finding]

    def _exchange(self) -> None:
        """Take another of those that are not told apart where beside it a later finding is needless.

        What was found first may have the wrong shape, and the later finding only fill what that leaves.
        """
        for finding in list(self.findings):
            for name in finding.alike or [finding.name]:
                if len(self.findings) > 1 and finding in self.findings:
                    self._exchanged(finding, name)

    def _exchanged(self, finding: Finding, name: str) -> None:
        """Take the best of a family in place of a finding where fewer then explain as much."""
        everything, candidate, before = self.findings, finding.candidate, self._evidence()
        self.findings = [other for other in everything if other is not finding]
        tried = [*self.of_family(name), *([finding.others[name]] if name in finding.others else [])]
        scored = self._gains(tried, fine_grid(self.null()[1]))
        finding.candidate = self.refined(max(scored, key=_gain)).candidate if scored else candidate
        self.findings = everything
        self._drop_needless()
        if len(self.findings) == len(everything) or before - self._evidence() > PROVEN:
            self.findings, finding.candidate = everything, candidate
        elif name != candidate.family:
            finding.others = {candidate.family: candidate, **finding.others}
            finding.others.pop(name, None)
            finding.alike = [name, *(one for one in finding.alike if one != name)]

    def _worth(self, finding: Finding) -> float:
        """Return by how much the evidence falls without a finding."""
        everything, before = self.findings, self._evidence()
        self.findings = [other for other in everything if other is not finding]
        worth = before - self._evidence()
        self.findings = everything
        return worth

    def _evidence(self) -> float:
        """Return twice the log-likelihood of the model so far less the price of its parameters."""
        terms = (len(group) for one in self.found for group in self.channel.pool.terms(one))
        number = sum(terms) + sum(one.nonlinear for one in self.found) - self.channel.freed(self.found)
        choice = sum(one.choice for one in self.found)
        return 2 * self.null()[0] - number * self.likelihood.price - choice


def _gain(one: Scored) -> float:
    return one.gain


def _near(gain: float, best: float) -> bool:
    """Tell whether a gain is too near to the best for a proof."""
    return best - gain < max(CLOSE, CLOSE_SHARE * best)


def _beside(leader: Leader, name: str, other: Leader) -> bool:
    """Tell whether another family did well beside this one, not in its place."""
    if not leader.partner:
        return False
    return name == leader.partner or other.partner not in ("", leader.partner)
