"""Search: which effects does the bias model of each axis lack?  Forward over all axes at once, then backward.

The model of an axis over R runs is y = X b + Z(theta) c + n, n ~ N(0, s² (W + r F + q R)): X the declared
curve, Z the columns of the effects with nonlinear parameters theta, W, F and R see `likelihood`.

    S(model)    = 2 ln L - (linear + nonlinear parameters) ln n - price of the choice     (BIC)
    gain(e | M) = S(M + e) - S(M)

with r, q, s, b and c at the maximum of L, the noise no larger than it is without the effect.  A gain is twice
the logarithm of a Bayes factor: while nothing is missing it ever exceeds g with a probability of exp(-g / 2)
at most, however often one looks (Ville 1939; Shafer et al. 2011, doi:10.1214/10-STS347).  Which effect is
added to which axes, see `choice`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.effects.base import Effect, Survey
from imumon.lab.diagnosis.candidates import Candidate, Part, candidates
from imumon.lab.diagnosis.channel import Channel, residual_rms
from imumon.lab.diagnosis.choice import (
    PROVEN,
    Finding,
    Lack,
    Scored,
    Table,
    first_lack,
    gain_of,
    proof,
)
from imumon.lab.diagnosis.likelihood import Likelihood, Noise, no_larger

MOST_NAMES = 3
"""Effects that are named in a set of those not told apart."""
STAGES = 5
LEAST_SIZE = 0.3
"""White floors (rms) that an effect takes away, at least."""
SECOND_SHARE = 0.2
"""And this share of what the largest effect before it takes away."""
JUMP_SHARE = 0.5
"""A further jump counts from this share on: the jumps of a telegraph noise are of one size."""
REFINEMENTS = 4

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Step:
    """A stage of the search: what was done, the model that it led to, its gain where there was one, and the
    rms that the model leaves once it is fitted."""

    done: str
    model: Sequence[Candidate]
    gain: float = float("nan")
    train_rms: float = float("nan")
    test_rms: float = float("nan")


def search(
    channels: Sequence[Channel],
    survey: Survey,
    names: Sequence[str],
    stages: int = STAGES,
    progress: Progress | None = None,
) -> list[Search]:
    """Find what the channels of one sensor lack, of the effects of these names.

    Parameters
    ----------
    channels : sequence of Channel
        Three axes of a sensor, or fewer, over the same training runs.
    survey : Survey
        What the runs can show.
    stages : int
        Effects that are added to a channel, at most.
    """
    likelihood, tried = Likelihood(channels[0].train), candidates(survey, names)
    searches = [Search(channel, survey, likelihood, tried) for channel in channels]
    usual = len({one.family for one in tried if not one.choice})
    least = proof(usual, len(channels)) if len(channels) > 1 else PROVEN
    for stage in range(stages):
        active = [one for one in searches if not one.finished]
        if not active:
            break
        if progress is not None:
            progress(f"effect {stage + 1} of {', '.join(one.channel.name for one in active)}")
        for one in active:
            one.tables.append(one.table())
            one.too_small.clear()
        _add(active, least)
    for one in searches:
        one.tidy()
    return searches


def _add(active: Sequence[Search], least: float) -> None:
    """Add to each channel the effect that gains most on all the channels that show it; finish the others."""
    left = {one.channel.name: one for one in active}
    while left:
        tables = {name: one.open_table() for name, one in left.items()}
        there = {name: [finding.name for finding in one.findings] for name, one in left.items()}
        lack = first_lack(tables, least, there)
        if lack is None:
            break
        done = [name for name in lack.channels if left[name].add(lack)]
        left = {name: one for name, one in left.items() if name not in done}
    for one in left.values():
        one.finished = True


class Search:
    """The search in one channel, and what it found.

    `findings` are the effects in the order in which they were found, those of a model that was given first;
    `many_events` says that a run has more than one event, such as two jumps, which no effect explains.
    `tables` has the best candidates of each stage, `turns` what was done; `refit` says whether the curve that
    was given pays for being fitted anew; `survey` is what the runs can show, `tried` what may be added.
    """

    def __init__(
        self, channel: Channel, survey: Survey, likelihood: Likelihood, tried: Sequence[Candidate]
    ) -> None:
        self.channel, self.survey, self.likelihood, self.tried = channel, survey, likelihood, tried
        self.findings: list[Finding] = []
        self.tables: list[Table] = []
        self.turns: list[Step] = []
        self.too_small = set[str]()
        self.many_events = self.finished = self.refit = False
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

    # One stage

    def table(self) -> Table:
        """Return the best of each family beside the model so far."""
        return {one.family: one for one in sorted(self.scored(self.tried), key=gain_of)}

    def scored(self, tried: Sequence[Candidate]) -> list[Scored]:
        """Return candidates with their gains over the model so far.

        A state at power-on that is free must not be the effect: with it a candidate gains no more than it
        does beside that state alone.
        """
        if not tried:
            return []
        price, pool = self.likelihood.price, self.channel.pool
        terms = [pool.terms(candidate) for candidate in tried]
        starts = list(dict.fromkeys(tuple(start) for _, start in terms if start))
        null, noise = self.null()
        ratio = 2.0 * (
            self._scan([*([*own, *start] for own, start in terms), *map(list, starts)], noise) - null
        )
        alone = dict(zip(starts, ratio[len(tried) :].tolist(), strict=True))
        found = []
        for candidate, (own, start), value in zip(tried, terms, ratio.tolist(), strict=False):
            fit = value - (len(own) + len(start)) * price
            gain = fit - candidate.nonlinear * price - candidate.choice
            if start:
                gain = min(gain, value - max(0.0, alone[tuple(start)]) - len(own) * price)
            found.append(Scored(candidate, gain, fit))
        return found

    def _scan(self, terms: Sequence[Sequence[tuple[int, int]]], noise: Noise) -> np.ndarray:
        channel = self.channel
        base = channel.design(self.found)
        return self.likelihood.scan(channel.values, base, channel.pool, terms, no_larger(noise))[0]

    def open_table(self) -> Table:
        """Return the table of this stage without what is too small to be added."""
        return {name: one for name, one in self.tables[-1].items() if name not in self.too_small}

    def add(self, lack: Lack) -> bool:
        """Add the best of a family with its parameters refined, and tell whether this stage is done: not when
        that is too small.  With a second event in a run the channel is finished."""
        table, name = self.tables[-1], lack.names[0]
        best = self.refined(table[name])
        size = float(np.sqrt(max(self._left() ** 2 - self._left(best.candidate) ** 2, 0.0)))
        least = max(LEAST_SIZE * self.channel.floor.sd, self.channel.blind)
        again = best.candidate.scope == "event" and name in (finding.name for finding in self.findings)
        largest = max((finding.size for finding in self.findings), default=0.0)
        if size < max(least, (JUMP_SHARE if again else SECOND_SHARE) * largest):
            self.too_small.add(name)
            self.finished = best.candidate.scope == "event"  # beside small jumps nothing else is proven
            return self.finished
        if self._second_event(best.candidate):
            self.finished = True
            return True
        there = {finding.name for finding in self.findings}
        others = [other for other in lack.names[1:] if other in table and other not in there][
            : MOST_NAMES - 1
        ]
        self.findings.append(
            Finding(
                best.candidate,
                best.gain,
                lack.gain,
                {**{other: one.gain for other, one in table.items()}, name: best.gain},
                [name, *others] if others else [],
                size,
                others={other: table[other].candidate for other in others},
            )
        )
        if len(self.findings) > 1:
            self._refine()
        self.turns.append(Step(name, self.found, best.gain))
        return True

    def _second_event(self, candidate: Candidate) -> bool:
        """Tell, and remember, whether a run has a second jump."""
        same = [one for one in self.found if one.family == candidate.family]
        taken = {run for one in same for part in one.parts for run in part.runs}
        if candidate.scope == "event":
            self.many_events |= any(run in taken for part in candidate.parts for run in part.runs)
        return self.many_events

    def refined(self, best: Scored) -> Scored:
        """Return a candidate with its nonlinear parameters refined: a pattern search around the grid."""
        best = self.scored([best.candidate])[0]
        for level in range(REFINEMENTS):
            tried = best.candidate.neighbours(self.survey, level)
            best = max([best, *self.scored(tried)], key=gain_of)
        return best

    def _left(self, *more: Candidate) -> float:
        """Return the rms that ordinary least squares leaves with what was found and more."""
        return residual_rms(self.channel.design([*self.found, *more]), self.channel.values)

    # At the end

    def tidy(self) -> None:
        """Drop what later findings made needless, and refine what is left, each beside the others."""
        if len(self.findings) > 1:
            self._drop_needless()
            before = [finding.name for finding in self.findings]
            self._refine(exchange=True)
            if changed := [finding.name for finding in self.findings if finding.name not in before]:
                self.turns.append(Step(f"{' and '.join(changed)} fits better beside the rest", self.found))
        if self.channel.known is not None:
            self._keep_curve()

    def _drop_needless(self) -> None:
        for finding in list(self.findings):
            if len(self.findings) > 1 and self._worth(finding) <= PROVEN:
                self.findings = [other for other in self.findings if other is not finding]

    def _refine(self, exchange: bool = False) -> None:
        """Refine each finding beside the others.

        With `exchange`, a finding gives way to one that was not told apart from it, where that one is
        likelier beside what was found later.
        """
        everything = list(self.findings)
        for finding in everything:
            self.findings = [other for other in everything if other is not finding]
            names = [finding.name, *finding.alike] if exchange else [finding.name]
            tried = [one for one in self.tried if one.family in names and one.carries]
            best = self.refined(max(self.scored([finding.candidate, *tried]), key=gain_of))
            finding.becomes(best.candidate)
        self.findings = everything

    def _worth(self, finding: Finding) -> float:
        """Return by how much the score falls without a finding."""
        everything, before = self.findings, self.score()
        self.findings = [other for other in everything if other is not finding]
        worth = before - self.score()
        self.findings = everything
        return worth

    def score(self) -> float:
        """Return S of the model so far."""
        number = self.channel.design(self.found).shape[1] + sum(one.nonlinear for one in self.found)
        price = number * self.likelihood.price + sum(one.choice for one in self.found)
        return float(2.0 * self.null()[0] - price)

    # A model that was given

    def _begin_with(self, known: Sequence[Effect]) -> None:
        """Fit anew what the runs show of a model that was given; the rest of it stays as it is."""
        given = self.channel.as_given()
        before = 2 * self.likelihood.best(given.values, given.base)[0] - self.likelihood.price
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
        gain = self.score() - before
        self.refit = gain > PROVEN
        if self.refit:
            self.turns.append(Step("what was given is fitted anew", self.found, gain))

    def _keep_curve(self) -> None:
        """Leave the curve that was given as it is, but for a constant, unless fitting it anew pays."""
        fitted, before = self.channel, self.score()
        self._known.clear()
        self.channel = replace(fitted, declared=replace(fitted.declared, degree=0))
        curve = any(finding.candidate.parts[0].effect.is_curve for finding in self.findings)
        if curve or before - self.score() > PROVEN:
            self._known.clear()
            self.channel = fitted
