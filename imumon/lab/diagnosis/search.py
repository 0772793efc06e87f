"""Search for the effects that each axis of a sensor lacks: forward over all axes at once, then backward.

The package docstring has the search in five steps, and the equations (3) to (5).  `search` runs the stages;
`AxisSearch.tabulate` is step 1, `select` 2, `AxisSearch.add` 3, `_add_families` 4, `AxisSearch.eliminate` 5.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from imumon.effects.base import Survey

from .candidates import Candidate, Channel, Finding, GainTable, Model, Part, Scored, candidates
from .likelihood import Likelihood, Noise, noise_no_larger

PROVEN_GAIN = 8.0
"""Gain above which an effect is proven: e^-4 by chance."""
NEAR_GAIN, NEAR_SHARE = 10.0, 0.15
"""Families are not separated whose gains differ by less, or by less than this share of the best: no column
has exactly the shape of the physics, and for a large effect this misfit exceeds the noise."""
MOST_NAMES = 3
"""Families that are named in a set of those not separated."""
STAGES = 5
"""Effects that are added to a channel, at most."""
SECOND_SHARE, JUMP_SHARE = 0.2, 0.5
"""Share of what each effect before it takes away that an effect takes away, at least; a second jump in a run
counts from the other share on: the jumps of a telegraph noise are of one size."""
REFINEMENTS = 4
"""Levels of the pattern search; steps are 0.35 of those of the level before."""

Progress = Callable[[str], None]
"""Takes what is done next."""


def search(
    channels: Sequence[Channel], survey: Survey, kinds: Sequence[str], stages: int, progress: Progress
) -> "list[AxisSearch]":
    """Find what the axes of one sensor, over the same training runs, lack of these kinds of effects.

    A present model's effects that are fitted anew are the first findings; those that these runs do not show
    stay as they are.  At most `stages` effects are added to an axis.
    """
    tried = candidates(survey, kinds)
    likelihoods = {id(one.training): Likelihood(one.training) for one in channels}  # thermometers may differ
    axes = [AxisSearch(one, survey, likelihoods[id(one.training)], tried) for one in channels]
    n_families = len({one.family for one in tried if not one.choice_price})  # the others pay for themselves
    bar = gain_bar(n_families, len(axes)) if len(axes) > 1 else PROVEN_GAIN
    for axis in axes:
        axis.eliminate()
    for stage in range(stages):
        active = [axis for axis in axes if not axis.finished]
        if not active:
            break
        progress(f"effect {stage + 1} of {', '.join(axis.channel.name for axis in active)}")
        for axis in active:
            axis.tabulate(pairs=stages > 1)
        _add_families(active, bar)
    for axis in axes:
        axis.eliminate()
    return axes


def gain_bar(families: int, axes: int) -> float:
    """Return the bar (5) for one of so many families on any set of so many axes."""
    return PROVEN_GAIN + 2.0 * float(np.log(max(1, families) * (2**axes - 1)))


def _add_families(active: "Sequence[AxisSearch]", bar: float) -> None:
    """Add one effect to each axis, by its newest table, until none exceeds the bar; finish the other axes.

    An axis that refuses the selected family goes on without it.  What a faulty axis gains is of its fault.
    """
    axes = {axis.channel.name: axis for axis in active}
    tables = {name: dict(axis.tables[-1]) for name, axis in axes.items() if not axis.channel.faulty}
    added = set[str]()
    while selection := select(tables, bar):
        for name in selection.channels:
            if axes[name].add(selection):
                added.add(name)
            if name in added or axes[name].finished:
                del tables[name]
            else:
                del tables[name][selection.family]
    for name in axes.keys() - added:
        axes[name].finished = True
    why = f"the sum over the axes that show it is below the bar of {bar:.1f}"
    for name, table in tables.items():
        best = max(table.values(), key=attrgetter("gain"), default=None)
        if best and best.gain > 0.0:
            showing = [one for one in tables if _shows(tables[one], best.candidate.family, bar)]
            axes[name].refuse(best.candidate.family, best.gain, showing, why)


class Selection(NamedTuple):
    """The family that is added next, its gain summed over these channels, and the `alternatives` that these
    data do not separate from it, the likeliest first."""

    family: str
    alternatives: list[str]
    channels: list[str]
    gain: float


def select(tables: Mapping[str, GainTable], bar: float) -> Selection | None:
    """Return the family whose gain, summed over the channels that show it, is largest; None below the bar.

    Of families whose gains are near, any other goes before an event.
    """
    families = dict.fromkeys(family for table in tables.values() for family in table)
    showing = {f: [name for name in tables if _shows(tables[name], f, bar)] for f in families}
    total = {f: sum(tables[name][f].gain for name in showing[f]) for f in families}
    near = [f for f in families if total[f] > bar and _near(total[f], max(total.values()))]
    if not near:
        return None
    no_event = [f for f in near if tables[showing[f][0]][f].candidate.scope != "event"]
    chosen = max(no_event or near, key=lambda f: total[f])
    channels = showing[chosen]
    # Of others all gains on these channels count, also where they do not show them.
    everywhere = [f for f in families if all(f in tables[name] for name in channels)]
    there = {f: sum(tables[name][f].gain for name in channels) for f in everywhere}
    not_rivals = {chosen, *(tables[name][chosen].partner for name in channels)}
    rivals = [f for f in there if f not in not_rivals and there[f] > bar and _near(there[f], total[chosen])]
    return Selection(chosen, sorted(rivals, key=lambda f: -there[f]), channels, total[chosen])


def _shows(table: GainTable, family: str, bar: float) -> bool:
    """Return whether a channel shows a family, and does not prove another in its place.  An event has a time
    of its own in each channel, so that each has to prove its own."""
    if family not in table:
        return False
    best = max(one.gain for one in table.values())
    least = PROVEN_GAIN if table[family].candidate.scope == "event" else 0.0
    return table[family].gain > max(least, best - max(bar, NEAR_SHARE * best))


def _near(gain: float, best: float) -> bool:
    return best - gain < max(NEAR_GAIN, NEAR_SHARE * best)


class AxisSearch:
    """The search in one channel, and what it found.

    `findings` are in the order in which they were found, those of the present model first.  With a
    `repeated_event` a run has several events, such as two jumps, which no effect explains.  Once `finished`,
    nothing is added.  `tables` has the gains of each stage; `history` what was added or exchanged, the model
    after that, and the gain (NaN of an exchange); `refused` what was not added or dropped, for report.json.
    """

    def __init__(
        self, channel: Channel, survey: Survey, likelihood: Likelihood, tried: list[Candidate]
    ) -> None:
        self.channel, self.survey, self.likelihood, self.candidates = channel, survey, likelihood, tried
        again = [one for one in channel.present_effects or () if one not in channel.fixed_effects]
        self.findings = [Finding(Candidate((Part(effect),)), of_present_model=True) for effect in again]
        self.tables: list[GainTable] = []
        self.history: list[tuple[str, Model, float]] = []
        self.refused: list[dict[str, Any]] = []
        self.repeated_event = self.finished = False
        self._maxima: dict[tuple[int, ...], tuple[Channel, Model, float, Noise]] = {}

    @property
    def model(self) -> list[Candidate]:
        """The candidates of the findings, which are what the model has beside its base."""
        return [finding.candidate for finding in self.findings]

    @property
    def present(self) -> list[Candidate]:
        """The effects of the present model that are fitted anew."""
        return [finding.candidate for finding in self.findings if finding.of_present_model]

    def maximum(self, model: Model) -> tuple[float, Noise]:
        """Return loglik (2) of a model at its maximum, and the noise there."""
        key = (id(self.channel), *map(id, model))  # both are kept, so that no other has their id
        if key not in self._maxima:
            found = self.likelihood.maximum(self.channel.y, self.channel.design(model))
            self._maxima[key] = self.channel, model, *found
        return self._maxima[key][2:]

    def criterion(self, model: Model) -> float:
        """Return S (3) of a model."""
        number = self.channel.design(model).shape[1] + sum(one.n_nonlinear for one in model)
        price = number * self.likelihood.price + sum(one.choice_price for one in model)
        return float(2.0 * self.maximum(model)[0] - price)

    def gains(self, tried: Model, model: Model) -> list[Scored]:
        """Return candidates with their gains (4) over a model.

        A free state at power-on must not be the effect: a candidate gains no more with it than beside it.
        """
        if not tried:
            return []
        price, channel = self.likelihood.price, self.channel
        terms = [channel.training.terms(candidate) for candidate in tried]
        starts = list(dict.fromkeys(tuple(start) for _, start in terms if start))
        every = [*([*of_effect, *start] for of_effect, start in terms), *map(list, starts)]
        before, noise = self.maximum(model)
        after = self.likelihood.scan(channel.y, channel.design(model), every, noise_no_larger(noise))
        ratio = (2.0 * (after - before)).tolist()
        of_start_alone = dict(zip(starts, ratio[len(tried) :], strict=True))
        found = []
        for candidate, (of_effect, start), value in zip(tried, terms, ratio, strict=False):
            linear_gain = value - (len(of_effect) + len(start)) * price
            gain = linear_gain - candidate.n_nonlinear * price - candidate.choice_price
            if start:
                beside_start = value - max(0.0, of_start_alone[tuple(start)])
                gain = min(gain, beside_start - len(of_effect) * price)
            found.append(Scored(candidate, gain, linear_gain))
        return found

    def refined(self, candidate: Candidate, model: Model) -> Scored:
        """Return a candidate with theta refined beside a model: a pattern search around the grid."""
        (best,) = self.gains([candidate], model)
        for level in range(REFINEMENTS):
            neighbours = best.candidate.neighbours(self.survey, level)
            best = max([best, *self.gains(neighbours, model)], key=attrgetter("gain"))
        return best

    def tabulate(self, pairs: bool) -> None:
        """Tabulate the best candidate of each family beside the findings; at first in pairs, too."""
        scored = sorted(self.gains(self.candidates, self.model), key=attrgetter("gain"))
        best = {one.candidate.family: one for one in scored}
        in_pairs = self._beside_partner(scored, best) if pairs and not self.findings else {}
        self.tables.append({**best, **in_pairs})

    def _beside_partner(self, scored: Sequence[Scored], best: GainTable) -> GainTable:
        """Return what families gain beside the partner in the best pair, where both are needed.

        Two effects at once hide one another: the one that replaces both best may be neither.  A pair counts
        that gains more than any effect alone by more than the shape of that may be off.  Its partner is what
        does not carry over, else what gains less alone.  A with 20 and B with 5 alone, 60 both: beside its
        partner B, A has 55, for 5 are B's own.  C with 30 alone, 32 beside B, falls to 27: both are needed.
        """
        members = [self.refined(one.candidate, []) for one in best.values() if one.candidate.scope == "event"]
        single = [one for one in scored if len(one.candidate.parts) == 1]
        plain = [one for one in single if not (one.candidate.free_start or one.candidate.choice_price)]
        for family in best:  # the best four of it
            members += [one for one in plain if one.candidate.family == family][-4:]
        both = combinations(members, 2)
        pairs = [(one, two) for one, two in both if one.candidate.family != two.candidate.family]
        joint = [Candidate((*one.candidate.parts, *two.candidate.parts)) for one, two in pairs]
        found = list(zip([one.gain for one in self.gains(joint, [])], pairs, strict=True))
        alone = max([PROVEN_GAIN, *(one.gain for one in members)])
        gain, best_pair = max(found, key=lambda pair: pair[0], default=(0.0, ()))
        if gain <= max([alone + max(PROVEN_GAIN, NEAR_SHARE * alone), *(one.gain for one in best.values())]):
            return {}
        lesser = min(best_pair, key=lambda one: (one.candidate.scope not in ("run", "event"), one.gain))
        partner = lesser.candidate.family
        beside = [
            one._replace(gain=gain - max(0.0, other.gain), partner=partner)
            for gain, pair in found
            for one, other in (pair, pair[::-1])
            if other.candidate.family == partner
        ]
        return {one.candidate.family: one for one in sorted(beside, key=attrgetter("gain"))}

    def add(self, selection: Selection) -> bool:
        """Add the best of a family with theta refined; return False where it is refused.

        Beside too small jumps, or a second one in a run, nothing else is proven: the channel is finished.
        """
        table, family, model = self.tables[-1], selection.family, self.model
        best = self.refined(table[family].candidate, model)
        best = best._replace(gain=max(best.gain, table[family].gain))  # beside a partner the latter is more
        is_event = best.candidate.scope == "event"
        runs_with_event = [one.parts[0].separate_runs for one in model if one.family == family]
        again = is_event and best.candidate.parts[0].separate_runs in runs_with_event
        removed = self._removed_rms(best.candidate, model)
        least = self._least_removed(best.candidate, JUMP_SHARE if again else SECOND_SHARE)
        if again or removed < least:
            self.repeated_event, self.finished = again and removed >= least, is_event
            floor = self.channel.floor.sd
            why = f"takes away {removed / floor:.2f} white floors, needed are {least / floor:.2f}"
            why = "a second one in a run" if self.repeated_event else why
            self.refuse(family, best.gain, selection.channels, why)
            return False
        there = {finding.name for finding in self.findings}
        others = [other for other in selection.alternatives if other not in there]
        alternatives = {other: table[other].candidate for other in others[: MOST_NAMES - 1]}
        gains = {other: one.gain for other, one in table.items()} | {family: best.gain}
        self.findings.append(
            Finding(
                best.candidate, best.gain, selection.gain, gains, alternatives, removed, table[family].partner
            )
        )
        if len(self.findings) > 1:
            self._refine_each(exchange=False)
        self.history.append((family, self.model, best.gain))
        return True

    def refuse(self, family: str, gain: float, axes: Sequence[str], why: str) -> None:
        """Note what is not added at this stage, or dropped after it: with its gain here, and who shows it."""
        self.refused.append(
            {"stage": len(self.tables), "name": family, "axes": [*axes], "gain_bic": gain, "why": why}
        )

    def _removed_rms(self, candidate: Candidate, model: Model) -> float:
        """Return sqrt(A² - B²), A and B the rms that least squares leave with a model and with both."""
        without, with_it = (self.channel.residual_rms(one) for one in (model, [*model, candidate]))
        return float(np.sqrt(max(without**2 - with_it**2, 0.0)))

    def _least_removed(self, candidate: Candidate, share: float) -> float:
        """Return the rms that a candidate has to take away: 0.3 white floors, and a share of what each
        finding takes away beside the others and the candidate; one of the same family alone, for two of a
        kind share it."""
        least = [0.3 * self.channel.floor.sd, self.channel.fault_rms]
        for finding in self.findings:
            removed = finding.removed_rms
            if finding.name != candidate.family or candidate.scope == "event":
                removed = self._removed_rms(finding.candidate, [*self._others(finding), candidate])
            least.append(share * removed)
        return max(least)

    def _others(self, finding: Finding) -> list[Candidate]:
        return [other.candidate for other in self.findings if other is not finding]

    def eliminate(self) -> None:
        """Drop what others, or a refused partner, make needless; refine what is left, each beside the others.

        An effect of the present model that these runs do not show, before anything is added, stays as it is.
        A finding gives way to an alternative where that is likelier beside what was found later.
        """
        findings = list(self.findings)
        for finding in findings:
            if len(self.findings) == 1 and not (finding.of_present_model or finding.partner):
                continue
            gain = self.criterion(self.model) - self.criterion(self._others(finding))
            if gain > PROVEN_GAIN:
                continue
            self.findings.remove(finding)
            if finding.of_present_model and not self.tables:
                (part,) = finding.candidate.parts
                self.channel = replace(self.channel, fixed_effects=(*self.channel.fixed_effects, part.effect))
            else:
                self.refuse(finding.name, gain, [self.channel.name], "dropped, needless beside the rest")
        if len(findings) == 1 and not findings[0].of_present_model:
            return  # nothing is beside it, and was not
        before = [finding.name for finding in self.findings]
        self._refine_each(exchange=True)
        if changed := [finding.name for finding in self.findings if finding.name not in before]:
            self.history.append((f"{' and '.join(changed)} fits better beside the rest", self.model, np.nan))

    def _refine_each(self, exchange: bool) -> None:
        """Refine each finding beside the others; with `exchange` an alternative may take its place."""
        for finding in self.findings:
            others, families = self._others(finding), [finding.name]
            families += finding.alternatives if exchange else []
            tried = [one for one in self.candidates if one.family in families and one.shared]
            best = max(self.gains([finding.candidate, *tried], others), key=attrgetter("gain"))
            if (new := best.candidate.family) != finding.name:
                del finding.alternatives[new]
                finding.alternatives = {finding.name: finding.candidate, **finding.alternatives}
                # Its gain is that of the same stage, where the others were not all there.
                finding.gain_over_axes += finding.family_gains[new] - finding.gain
                finding.gain = finding.family_gains[new]
            finding.candidate = self.refined(best.candidate, others).candidate
