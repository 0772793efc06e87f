"""Which effects the declared model lacks: one after another, each channel by itself and with those that
agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.candidates import Candidate, Part, Pool, Term, candidates
from imumon.diagnosis.gains import PROVEN, Table, joined_events, paired, pooled_gains
from imumon.diagnosis.search import (
    Likelihood,
    Noise,
    Target,
    coarse_grid,
    fine_grid,
    neighbours,
    parameters,
)
from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS

CLOSE = 10.0
"""Families whose gains differ by less are not told apart."""
CLOSE_SHARE = 0.15
"""Nor those that differ by less than this share of the best gain: no regressor has exactly the shape of the
physics, and with a large effect the shape decides."""
LEAST_EVIDENCE = 4.0
"""A channel with less is never made to agree with the others."""
MOST_STAGES = 6
MOST_NAMES = 3
SECOND_SHARE = 0.2
"""A further effect counts when what it takes away is at least this share of what the largest one does."""
LEAST_SIZE = 0.3
"""And at least this many white floors (rms)."""
MISFIT = 1.5
"""A winner that leaves more than so many floors does not fit by itself: then a gap of gains is no proof."""
ALIKE = 1.25
"""Residuals that differ by less than this factor are alike."""
REFINEMENTS = 4
FORETOLD = 1.1
"""Factor by which the runs must foretell one another better for a family to go before one of larger gain."""
FORETELLING = 0.7
"""A family with less than this share of the gain is not taken for how it foretells."""

Progress = Callable[[str], None]


@dataclass(slots=True)
class Finding:
    """An effect that was found in a channel.

    Parameters
    ----------
    candidate : Candidate
        With refined parameters; coefficients come with the fit.
    gain : float
        Over the model so far, in BIC.
    pooled_gain : float
        The same over all channels that show something, with shared nonlinear parameters.
    rivals : dict of str to float
        Gain of every family at that stage.
    alike : list of str
        Families that cannot be told apart from it, it among them; empty when there is no other.
    size : float
        rms of what it takes away from the residual.
    """

    candidate: Candidate
    gain: float
    pooled_gain: float
    rivals: dict[str, float]
    alike: list[str]
    size: float

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.family


@dataclass(slots=True)
class Outcome:
    """What the search found in a channel."""

    findings: list[Finding] = field(default_factory=list)
    many_jumps: bool = False
    remark: Finding | None = None
    noise: Noise = (0.0, 0.0)
    finished: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """A channel over the training runs.

    Parameters
    ----------
    name : str
    temperature : str
        Which temperature drives it.
    values : array of shape (n,)
    declared : array of shape (n, p)
        Columns of the declared model.
    floor : float
        White floor of a block of the search.
    """

    name: str
    temperature: str
    values: FloatArray
    declared: FloatArray
    floor: float


def ordinary(columns: FloatArray, values: FloatArray) -> FloatArray:
    """Return the coefficients of ordinary least squares, the smallest where columns are collinear."""
    norm = np.linalg.norm(columns, axis=0)
    norm = np.where(norm > 0, norm, 1.0)
    return np.asarray(np.linalg.lstsq(columns / norm, values, rcond=1e-10)[0] / norm)


def residual_rms(columns: FloatArray, values: FloatArray) -> float:
    """Return the rms of the residual of ordinary least squares."""
    left = values - columns @ ordinary(columns, values)
    return float(np.sqrt(np.mean(left**2)))


class Search:
    """Finds what a group of channels (one sensor) lacks.

    Parameters
    ----------
    runs : sequence of RunBlocks
        Training runs.
    channels : sequence of Channel
        Three axes of a sensor, or fewer.
    survey : Survey
        What the runs can show.
    families : sequence of str
        Effects to try.
    """

    def __init__(
        self, runs: Sequence[RunBlocks], channels: Sequence[Channel], survey: Survey, families: Sequence[str]
    ) -> None:
        self._likelihood = Likelihood(runs)
        self._channels = channels
        self._survey = survey
        self._candidates = candidates(survey, families)
        self._pools = {channel.temperature: Pool(runs, channel.temperature) for channel in channels}
        self._outcomes = {channel.name: Outcome() for channel in channels}
        self._known: dict[tuple[str, tuple[int, ...]], tuple[tuple[Candidate, ...], float, Noise]] = {}

    def run(self, progress: Progress | None = None) -> Mapping[str, Outcome]:
        """Return what was found in each channel."""
        for stage in range(MOST_STAGES):
            active = [c for c in self._channels if not self._outcomes[c.name].finished]
            if not active:
                break
            if progress is not None:
                progress(f"effect {stage + 1} of {', '.join(c.name for c in active)}")
            self._stage(active)
        for channel in self._channels:
            self._drop_needless(channel)
            self._merge_start(channel)
            self._polish(channel)
            self._outcomes[channel.name].noise = self._null(channel)[1]
        return self._outcomes

    def columns(self, channel: Channel, found: Sequence[Candidate]) -> FloatArray:
        """Return the columns of candidates for a channel over all runs, (n, k)."""
        pool = self._pools[channel.temperature]
        parts = [pool.matrix([*defining, *start]) for defining, start in map(pool.terms, found)]
        return np.concatenate(parts, axis=1) if parts else np.empty((len(channel.values), 0))

    # One stage

    def _stage(self, active: Sequence[Channel]) -> None:
        tables = {channel.name: self._table(channel) for channel in active}
        for channel in active:
            extra = joined_events(tables[channel.name])
            if extra:
                tables[channel.name] = self._extended(channel, tables[channel.name], extra)
            self._pair(channel, tables[channel.name])
        pooled = pooled_gains(list(tables.values()))
        for channel in active:
            self._decide(channel, tables[channel.name], pooled)

    def _table(self, channel: Channel) -> Table:
        best, noise = self._null(channel)
        coarse = self._gains(channel, self._candidates, coarse_grid([noise]), best)
        short = sorted({at for family in coarse.families() for at in family})
        fine = self._gains(channel, [self._candidates[at] for at in short], fine_grid(noise), best)
        coarse.gain[short] = np.maximum(coarse.gain[short], fine.gain)
        coarse.fit[short] = np.maximum(coarse.fit[short], fine.fit)
        coarse.noise.update({at: fine.noise[index] for index, at in enumerate(short)})
        return coarse

    def _pair(self, channel: Channel, table: Table) -> None:
        """Look for two effects at once, where none was found yet."""
        if self._outcomes[channel.name].findings or table.gain.max() <= PROVEN:
            return
        best, noise = self._null(channel)
        pool = self._pools[channel.temperature]
        grid = coarse_grid([noise, (0.3, 0.0)])
        found = paired(self._likelihood, pool, self._target(channel), best, table, grid)
        table.together, table.partner = found

    def _extended(self, channel: Channel, table: Table, extra: list[Candidate]) -> Table:
        best, noise = self._null(channel)
        more = self._gains(channel, extra, fine_grid(noise), best)
        count = len(table.candidates)
        return Table(
            [*table.candidates, *extra],
            np.concatenate([table.gain, more.gain]),
            np.concatenate([table.fit, more.fit]),
            {**table.noise, **{count + at: value for at, value in more.noise.items()}},
            table.common,
            table.penalty,
        )

    def _gains(
        self, channel: Channel, tried: Sequence[Candidate], grid: Sequence[Noise], null: float
    ) -> Table:
        """Return the gain of each candidate, over the model so far and over its free start alone."""
        pool = self._pools[channel.temperature]
        both = [pool.terms(candidate) for candidate in tried]
        starts = list(dict.fromkeys(tuple(start) for _, start in both if start))
        terms: list[Sequence[Term]] = [[*defining, *start] for defining, start in both]
        scan = self._likelihood.scan([self._target(channel)], pool, [*terms, *starts], grid)
        fit = scan.likelihood[0]
        alone = {start: fit[len(tried) + at] for at, start in enumerate(starts)}
        logarithm = np.log(self._likelihood.n)
        penalty = np.array([parameters(c, group) for c, group in zip(tried, terms, strict=True)]) * logarithm
        gain = 2 * (fit[: len(tried)] - null) - penalty
        for at, (defining, start) in enumerate(both):
            if start:
                own = 2 * (fit[at] - max(null, alone[tuple(start)])) - len(defining) * logarithm
                gain[at] = min(gain[at], own)
        linear = np.array([len(group) for group in terms]) * logarithm
        noise = {at: scan.grid[scan.noise[0, at]] for at in range(len(tried))}
        return Table(
            list(tried), gain, 2 * (fit[: len(tried)] - null) - linear, noise, len(tried), penalty - linear
        )

    def _decide(self, channel: Channel, table: Table, pooled: dict[str, float]) -> None:
        outcome = self._outcomes[channel.name]
        own = table.best()
        if not own or max(gain for gain, _ in own.values()) <= PROVEN:
            outcome.finished = True
            return
        order = sorted(own, key=lambda family: -own[family][0])
        while order:
            family = self._choose(outcome, order, own, pooled)
            finding = self._finding(channel, table, family, own, pooled)
            if finding is not None and (other := self._better_foretold(channel, table, finding, own)):
                finding = self._finding(channel, table, other, own, pooled) or finding
            if finding is None:
                order.remove(family)
                order = [name for name in order if own[name][0] > PROVEN]
                continue
            if _second_event(outcome, finding):
                outcome.many_jumps = outcome.finished = True
                return
            outcome.findings.append(finding)
            return
        outcome.finished = True

    def _choose(
        self,
        outcome: Outcome,
        order: Sequence[str],
        own: Mapping[str, tuple[float, int]],
        pooled: Mapping[str, float],
    ) -> str:
        """Return the family to add: one that is there already where it does nearly as well, else what is
        shared."""
        best = own[order[0]][0]
        slack = max(CLOSE, 0.3 * best)
        for name in dict.fromkeys(finding.name for finding in outcome.findings):
            if name in order and own[name][0] > max(PROVEN, best - slack):
                return name
        shared = max(
            (name for name in order if name in pooled), key=lambda name: pooled[name], default=order[0]
        )
        if own[shared][0] > LEAST_EVIDENCE and best - own[shared][0] < max(CLOSE, CLOSE_SHARE * best):
            return shared
        return order[0]

    def _better_foretold(
        self, channel: Channel, table: Table, finding: Finding, own: Mapping[str, tuple[float, int]]
    ) -> str | None:
        """Return the family, of those not told apart, by which the runs foretell one another better; else
        None."""
        if self._survey.runs < 2 or not finding.alike:
            return None
        errors = {
            name: self._foretold(
                channel, finding.candidate if name == finding.name else table.candidates[own[name][1]]
            )
            for name in finding.alike
            if name == finding.name or own[name][0] > FORETELLING * own[finding.name][0]
        }
        best = min(errors, key=lambda name: errors[name])
        return best if errors[best] < errors[finding.name] / FORETOLD else None

    def _foretold(self, channel: Channel, candidate: Candidate) -> float:
        """Return the rms error with which each run is foretold by the others, its own constant given."""
        base = self._target(
            channel, [f.candidate for f in self._outcomes[channel.name].findings] + [candidate]
        )
        total = 0.0
        for rows in self._likelihood.rows():
            others = ~rows
            left = base.values[rows] - base.base[rows] @ ordinary(base.base[others], base.values[others])
            total += float(np.sum((left - left.mean()) ** 2))
        return float(np.sqrt(total / len(base.values)))

    def _finding(
        self,
        channel: Channel,
        table: Table,
        family: str,
        own: Mapping[str, tuple[float, int]],
        pooled: Mapping[str, float],
    ) -> Finding | None:
        """Return the effect with refined parameters, or None when it is too small beside those found."""
        outcome = self._outcomes[channel.name]
        gain, at = own[family]
        candidate, refined_gain = self._refined(channel, table.candidates[at], table.noise[at])
        before = self._left(channel, [])
        after = self._left(channel, [candidate])
        size = float(np.sqrt(max(before**2 - after**2, 0.0)))
        largest = max((finding.size for finding in outcome.findings), default=0.0)
        if size < max(LEAST_SIZE * channel.floor, SECOND_SHARE * largest):
            return None
        rivals = {name: value for name, (value, _) in own.items()}
        rivals[family] = max(gain, refined_gain)
        alike = self._alike(channel, table, family, own, pooled, after)
        return Finding(candidate, rivals[family], pooled.get(family, gain), rivals, alike, size)

    def _alike(
        self,
        channel: Channel,
        table: Table,
        family: str,
        own: Mapping[str, tuple[float, int]],
        pooled: Mapping[str, float],
        left: float,
    ) -> list[str]:
        """Return the families that are not told apart from the one chosen, by gain or by what they leave."""
        best = max(gain for gain, _ in own.values())
        close = []
        for name, (gain, at) in own.items():
            if name == family or gain <= PROVEN or _beside(table, family, name):
                continue
            near = best - gain < max(CLOSE, CLOSE_SHARE * best)
            if name in pooled and family in pooled:
                near &= pooled[family] - pooled[name] < max(CLOSE, CLOSE_SHARE * pooled[family])
            if near:
                close.append((gain, name))
            elif left > MISFIT * channel.floor and gain > 0.5 * best:
                other = self._left(channel, [table.candidates[at]])
                if other < ALIKE * left:
                    close.append((gain, name))
        names = [name for _, name in sorted(close, reverse=True)[: MOST_NAMES - 1]]
        return [family, *names] if names else []

    def _refined(self, channel: Channel, candidate: Candidate, noise: Noise) -> tuple[Candidate, float]:
        """Return the candidate with its nonlinear parameters refined, and its gain."""
        null, _ = self._null(channel)
        grid = neighbours(noise)
        best, gain = candidate, -np.inf
        for level in range(REFINEMENTS):
            tried = [best, *_moved(best, self._survey, level)]
            table = self._gains(channel, tried, grid, null)
            at = int(np.argmax(table.gain))
            best, gain = tried[at], float(table.gain[at])
            if len(tried) == 1:
                break
        return best, gain

    # The model so far

    def _target(self, channel: Channel, found: Sequence[Candidate] | None = None) -> Target:
        if found is None:
            found = [finding.candidate for finding in self._outcomes[channel.name].findings]
        base = np.column_stack([channel.declared, self.columns(channel, found)])
        return Target(channel.name, channel.values, base)

    def _null(self, channel: Channel) -> tuple[float, Noise]:
        found = tuple(finding.candidate for finding in self._outcomes[channel.name].findings)
        key = channel.name, tuple(map(id, found))  # the candidates are kept, so that no other has their id
        if key not in self._known:
            best, noise = self._likelihood.null([self._target(channel)])
            self._known[key] = found, float(best[0]), noise[0]
        return self._known[key][1:]

    def _left(self, channel: Channel, more: Sequence[Candidate]) -> float:
        """Return the rms that ordinary least squares leaves with what was found and more."""
        found = [finding.candidate for finding in self._outcomes[channel.name].findings]
        target = self._target(channel, [*found, *more])
        return residual_rms(target.base, target.values)

    def _polish(self, channel: Channel) -> None:
        """Refine each finding anew beside the others, which were not there when it was found."""
        outcome = self._outcomes[channel.name]
        if len(outcome.findings) < 2:
            return
        everything = list(outcome.findings)
        noise = self._null(channel)[1]
        for finding in everything:
            outcome.findings = [other for other in everything if other is not finding]
            finding.candidate, _ = self._refined(channel, finding.candidate, noise)
        outcome.findings = everything

    def _merge_start(self, channel: Channel) -> None:
        """Take for a start out of equilibrium what passed for an effect of its own, if that does."""
        outcome = self._outcomes[channel.name]
        everything = list(outcome.findings)
        pairs = [
            (lag, other)
            for lag in everything
            for other in everything
            if other.name in EFFECTS[lag.name].start_looks_like and not lag.candidate.free_start
        ]
        if not pairs:
            return
        lag, passing = pairs[0]
        before = self._evidence(channel)
        fixed = lag.candidate
        outcome.findings = [finding for finding in everything if finding is not passing]
        lag.candidate, _ = self._refined(channel, replace(fixed, free_start=True), self._null(channel)[1])
        if before - self._evidence(channel) > CLOSE:
            outcome.findings, lag.candidate = everything, fixed

    def _evidence(self, channel: Channel) -> float:
        """Return twice the log-likelihood of the model so far less the price of its parameters."""
        found = [finding.candidate for finding in self._outcomes[channel.name].findings]
        pool = self._pools[channel.temperature]
        price = sum(parameters(one, [*terms[0], *terms[1]]) for one in found for terms in [pool.terms(one)])
        return 2 * self._null(channel)[0] - price * float(np.log(self._likelihood.n))

    def _drop_needless(self, channel: Channel) -> None:
        """Drop what later findings made needless."""
        outcome = self._outcomes[channel.name]
        if len(outcome.findings) < 2:
            return
        logarithm = np.log(self._likelihood.n)
        for finding in list(outcome.findings):
            everything = outcome.findings
            with_it, _ = self._null(channel)
            outcome.findings = [other for other in everything if other is not finding]
            without, _ = self._null(channel)
            terms = sum(map(len, self._pools[channel.temperature].terms(finding.candidate)))
            price = (terms + finding.candidate.nonlinear) * logarithm
            if 2 * (with_it - without) - price > PROVEN:
                outcome.findings = everything


def _beside(table: Table, family: str, other: str) -> bool:
    """Tell whether another family did well beside this one, not in its place."""
    if family not in table.partner:
        return False
    return other == table.partner[family] or table.partner.get(other) not in (None, table.partner[family])


def _second_event(outcome: Outcome, finding: Finding) -> bool:
    """Tell whether a run has a second jump that is not small beside the first."""
    if EFFECTS[finding.name].scope != "event":
        return False
    same = [other for other in outcome.findings if other.name == finding.name]
    taken = {run for other in same for part in other.candidate.parts for run in part.runs}
    return any(run in taken for part in finding.candidate.parts for run in part.runs)


def _moved(candidate: Candidate, survey: Survey, level: int) -> list[Candidate]:
    """Return neighbours of a candidate, one parameter of one part changed at a time."""
    found = []
    for at, part in enumerate(candidate.parts):
        for effect in part.effect.refined(survey, level):
            parts = list(candidate.parts)
            parts[at] = Part(effect, part.runs)
            found.append(replace(candidate, parts=tuple(parts)))
    return found
