"""Search for the effects that each axis of a sensor lacks: forward over all axes at once, then backward.

The package docstring has the search in five steps, and the equations (3) to (5).  `search` runs the stages;
`AxisSearch.tabulate` is step 1, `select` 2, `AxisSearch.add` 3, `_add_families` 4, `AxisSearch.eliminate` 5
after the last stage, and `AxisSearch.fix_unproven` 5 before the first.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

import numpy as np

from imumon.effects.base import Survey

from .candidates import Candidate, Candidates, Channel, Finding, GainTable, Part, Scored, candidates
from .likelihood import Likelihood, Noise, noise_no_larger

PROVEN_GAIN = 8.0  # in BIC, above which an effect is proven: e^-4 by chance
# Families are not separated whose gains differ by less than `NEAR_GAIN`, or than this share of the best: no
# column has exactly the shape of the physics, and for a large effect this misfit exceeds the noise.  Assumed.
NEAR_GAIN = 10.0
NEAR_SHARE = 0.15
MOST_NAMES = 3  # families that are named in a set of those not separated
STAGES = 5  # effects that are added to a channel, at most
# Least rms that a further effect has to take away, over that of each effect before it.  See the ablation.
SECOND_SHARE = 0.2
# The same of a second jump in a run, from which on these are the jumps of a telegraph noise: of one size.
JUMP_SHARE = 0.5
REFINEMENTS = 4  # levels of the pattern search, each of steps 0.35 of the last; see the ablation

Progress = Callable[[str], None]  # takes a text: what is done next
Note = dict[str, Any]  # on a finding that was not added, or was left out, as in report.json
GAIN = attrgetter("gain")  # key to sort by


def search(
    channels: Sequence[Channel], survey: Survey, kinds: Sequence[str], stages: int, progress: Progress
) -> "list[AxisSearch]":
    """Find what the axes of one sensor, over the same training runs, lack of these kinds of effects; at most
    `stages` effects are added to an axis."""
    tried = candidates(survey, kinds)
    # One for each training: where thermometers differ, channels have several.
    likelihoods = {id(channel.training): Likelihood(channel.training) for channel in channels}
    axes = [AxisSearch(channel, survey, likelihoods[id(channel.training)], tried) for channel in channels]
    # Those of another driver pay for their choice themselves.
    n_families = len({candidate.family for candidate in tried if not candidate.choice_price})
    # Of an axis alone no gains are summed: see (5).
    bar = gain_bar(n_families, len(axes)) if len(axes) > 1 else PROVEN_GAIN
    for axis in axes:
        axis.fix_unproven()
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
    """Add one effect to each axis, by its newest table, until none exceeds the bar; finish the other axes."""
    # An axis that refuses the selected family goes on without it.  What a faulty axis gains is of its fault.
    axes = {axis.channel.name: axis for axis in active}
    # What each axis may still add, which shrinks below.
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
        best = max(table.values(), key=GAIN, default=None)
        if best and best.gain > 0.0:
            family = best.candidate.family
            showing = [other for other in tables if _shows(tables[other], family, bar)]
            axes[name].refuse(family, best.gain, showing, why)


class Selection(NamedTuple):
    """The family that is added next, its gain summed over these channels, and the `alternatives` that these
    data do not separate from it, the likeliest first."""

    family: str
    alternatives: list[str]
    channels: list[str]
    gain: float


def select(tables: Mapping[str, GainTable], bar: float) -> Selection | None:
    """Return the family whose gain, summed over the channels that show it, is largest; None below the bar."""
    # Of families whose gains are near, any other goes before an event.
    scopes = {family: entry.candidate.scope for table in tables.values() for family, entry in table.items()}
    showing = {family: [name for name in tables if _shows(tables[name], family, bar)] for family in scopes}
    total = {family: sum(tables[name][family].gain for name in showing[family]) for family in scopes}
    best = max(total.values(), default=0.0)
    near = [family for family, gain in total.items() if gain > bar and _near(gain, best)]
    if not near:
        return None
    no_event = [family for family in near if scopes[family] != "event"]
    chosen = max(no_event or near, key=total.__getitem__)
    channels = showing[chosen]
    partners = [tables[name][chosen].partner for name in channels]
    # Of a rival the gains on all these channels count, also where one of them does not show it.
    of_rivals = {
        family: sum(tables[name][family].gain for name in channels)
        for family in scopes
        if family not in (chosen, *partners) and all(family in tables[name] for name in channels)
    }
    rivals = [family for family, gain in of_rivals.items() if gain > bar and _near(gain, total[chosen])]
    rivals.sort(key=of_rivals.__getitem__, reverse=True)
    return Selection(chosen, rivals, channels, total[chosen])


def _shows(table: GainTable, family: str, bar: float) -> bool:
    """Return whether a channel shows a family, and does not prove another in its place."""
    if family not in table:
        return False
    gain, best = table[family].gain, max(entry.gain for entry in table.values())
    # An event has a time of its own in each channel, so that each has to prove its own.
    least = PROVEN_GAIN if table[family].candidate.scope == "event" else 0.0
    # The best is proven in its place if it gains more by the bar, as an effect does that is proven at all.
    in_its_place = gain <= best - max(bar, NEAR_SHARE * best)
    return gain > least and not in_its_place


def _near(gain: float, best: float) -> bool:
    return best - gain < max(NEAR_GAIN, NEAR_SHARE * best)


class AxisSearch:
    """The search in one channel, and what it found."""

    def __init__(self, channel: Channel, survey: Survey, likelihood: Likelihood, tried: Candidates) -> None:
        self.channel, self.survey, self.likelihood, self.candidates = channel, survey, likelihood, tried
        anew = [effect for effect in channel.present_effects or () if effect not in channel.fixed_effects]
        # In the order in which they were found, those of the present model first.
        self.findings = [Finding(Candidate((Part(effect),)), of_present_model=True) for effect in anew]
        self.of_present = [*self.findings]  # also those that others make needless, should these be refused
        self.tables: list[GainTable] = []  # the gains of each stage
        # What was added or exchanged, the model after that, and the gain (NaN of an exchange).
        self.history: list[tuple[str, Candidates, float]] = []
        self.refused: list[Note] = []  # what was not added or was dropped
        # Whether a run has several events, as two jumps, which no effect explains; whether nothing is added.
        self.repeated_event = self.finished = False
        # By id of the channel and candidates, as an effect with coefficients has no hash: these, so that no
        # others can have their ids, and the maximum.
        self._maxima: dict[tuple[int, ...], tuple[object, tuple[float, Noise]]] = {}

    @property
    def model(self) -> list[Candidate]:
        """The candidates of the findings, which are what the model has beside its base."""
        return [finding.candidate for finding in self.findings]

    @property
    def present(self) -> list[Candidate]:
        """The effects of the present model that are fitted anew."""
        return [finding.candidate for finding in self.of_present]

    def maximum(self, model: Candidates) -> tuple[float, Noise]:
        """Return loglik (2) of a model at its maximum, and the noise there."""
        key = (id(self.channel), *map(id, model))
        if key not in self._maxima:
            maximum = self.likelihood.maximum(self.channel.y, self.channel.design(model))
            self._maxima[key] = (self.channel, model), maximum
        return self._maxima[key][1]

    def criterion(self, model: Candidates) -> float:
        """Return S (3) of a model."""
        number = self.channel.design(model).shape[1] + sum(candidate.n_nonlinear for candidate in model)
        price = number * self.likelihood.price + sum(candidate.choice_price for candidate in model)
        return float(2.0 * self.maximum(model)[0] - price)

    def gains(self, tried: Candidates, model: Candidates) -> list[Scored]:
        """Return candidates with their gains (4) over a model."""
        # A free state at power-on must not be the effect: a candidate gains no more with it than beside it.
        if not tried:
            return []
        price = self.likelihood.price
        terms = [self.channel.training.terms(candidate) for candidate in tried]
        complete = [[*effect_terms, *start_terms] for effect_terms, start_terms in terms]
        starts = list(dict.fromkeys(tuple(start_terms) for _, start_terms in terms if start_terms))
        before, noise = self.maximum(model)
        # Both in one scan, which whitens each column once.
        after = self.likelihood.scan(
            self.channel.y, self.channel.design(model), [*complete, *starts], noise_no_larger(noise)
        )
        ratios = (2.0 * (after - before)).tolist()
        ratio_of_start = dict(zip(starts, ratios[len(tried) :], strict=True))
        scored = []
        # Behind the ratios of what is tried come those of the starts alone.
        for candidate, (effect_terms, start_terms), ratio in zip(tried, terms, ratios, strict=False):
            linear_gain = ratio - (len(effect_terms) + len(start_terms)) * price
            gain = linear_gain - candidate.n_nonlinear * price - candidate.choice_price
            if start_terms:
                # theta and the choice are in the columns of the start as well: their prices cancel.
                beside_start = ratio - max(0.0, ratio_of_start[tuple(start_terms)])
                gain = min(gain, beside_start - len(effect_terms) * price)
            scored.append(Scored(candidate, gain, linear_gain))
        return scored

    def refined(self, candidate: Candidate, model: Candidates) -> Scored:
        """Return a candidate with theta refined beside a model: a pattern search around the grid."""
        (best,) = self.gains([candidate], model)
        for level in range(REFINEMENTS):
            neighbours = best.candidate.neighbours(self.survey, level)
            best = max([best, *self.gains(neighbours, model)], key=GAIN)
        return best

    def tabulate(self, pairs: bool) -> None:
        """Tabulate the best candidate of each family beside the findings; at first in pairs, too."""
        scored = sorted(self.gains(self.candidates, self.model), key=GAIN)
        best = {entry.candidate.family: entry for entry in scored}  # the last of a family, which gains most
        in_pairs = self._beside_partner(scored, best) if pairs and not self.findings else {}
        self.tables.append({**best, **in_pairs})

    def _beside_partner(self, scored: Sequence[Scored], best: GainTable) -> GainTable:
        """Return what families gain beside the partner in the best pair, where both are needed."""
        # Two effects at once hide one another: the one that replaces both best may be neither.  Alone A gains
        # 20, B 5 and C 30; A and B gain 60, B and C 32.  A and B are the best pair, and B the partner.
        # Beside it A gains 55, for 5 are B's own, and C 27: both A and B are needed.
        members = self._pair_members(scored, best)
        both = combinations(members, 2)
        pairs = [(one, two) for one, two in both if one.candidate.family != two.candidate.family]
        joint = [Candidate((*one.candidate.parts, *two.candidate.parts)) for one, two in pairs]
        gains = [pair.gain for pair in self.gains(joint, [])]
        best_gain, best_pair = max(zip(gains, pairs, strict=True), key=itemgetter(0), default=(0.0, ()))
        alone = max([PROVEN_GAIN, *(member.gain for member in members)])
        # A single effect may gain too little by as much, as its shape is not exactly that of the physics.
        needed = alone + max(PROVEN_GAIN, NEAR_SHARE * alone)
        if best_gain <= max([needed, *(entry.gain for entry in best.values())]):
            return {}
        # The partner is what does not carry over, if one of both does not, else what gains less alone.
        of_a_run = [one for one in best_pair if one.candidate.scope in ("run", "event")]
        partner = min(of_a_run or best_pair, key=GAIN).candidate.family
        beside = [
            member._replace(gain=gain - max(0.0, other.gain), partner=partner)
            for gain, pair in zip(gains, pairs, strict=True)
            for member, other in (pair, pair[::-1])
            if other.candidate.family == partner
        ]
        return {entry.candidate.family: entry for entry in sorted(beside, key=GAIN)}

    def _pair_members(self, scored: Sequence[Scored], best: GainTable) -> list[Scored]:
        """Return what is tried in pairs, as all pairs would be thousands: events, refined, and of each family
        the last four (assumed) of `scored`, which gain most."""
        members = [self.refined(one.candidate, []) for one in best.values() if one.candidate.scope == "event"]
        single = [entry for entry in scored if len(entry.candidate.parts) == 1]
        plain = [one for one in single if not (one.candidate.free_start or one.candidate.choice_price)]
        for family in best:
            members += [entry for entry in plain if entry.candidate.family == family][-4:]
        return members

    def add(self, selection: Selection) -> bool:
        """Add the best of a family with theta refined; return False where it is refused."""
        # Beside too small jumps, or a second one in a run, nothing else is proven: the channel is finished.
        family = selection.family
        table = self.tables[-1]
        best = self.refined(table[family].candidate, self.model)
        best = best._replace(gain=max(best.gain, table[family].gain))  # beside a partner the latter is more
        is_event = best.candidate.scope == "event"
        runs_with_event = [one.parts[0].separate_runs for one in self.model if one.family == family]
        is_second = is_event and best.candidate.parts[0].separate_runs in runs_with_event
        removed = self._removed_rms(best.candidate, self.model)
        least = self._least_removed(best.candidate, JUMP_SHARE if is_second else SECOND_SHARE)
        is_small = removed < least
        if is_second or is_small:
            self.finished = is_event
            self.repeated_event = not is_small
            floor = self.channel.floor.sd
            few = f"takes away {removed / floor:.2f} white floors, needed are {least / floor:.2f}"
            why = few if is_small else "a second one in a run"
            self.refuse(family, best.gain, selection.channels, why)
            return False
        added = {finding.name for finding in self.findings}
        others = [other for other in selection.alternatives if other not in added]
        self.findings.append(
            Finding(
                best.candidate,
                gain=best.gain,
                gain_over_axes=selection.gain,
                family_gains={name: entry.gain for name, entry in table.items()} | {family: best.gain},
                alternatives={name: table[name].candidate for name in others[: MOST_NAMES - 1]},
                removed_rms=removed,
                partner=table[family].partner,
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

    def _removed_rms(self, candidate: Candidate, model: Candidates) -> float:
        """Return sqrt(A² - B²), A and B the rms that least squares leave with a model and with both."""
        without, with_it = (self.channel.residual_rms(each) for each in (model, [*model, candidate]))
        return float(np.sqrt(max(without**2 - with_it**2, 0.0)))

    def _least_removed(self, candidate: Candidate, share: float) -> float:
        """Return the rms that a candidate has to take away, at least: some of the white floor, what faults
        make, and a share of what each finding takes away beside the others and the candidate."""
        # Less than 0.3 floors change an error of one floor by less than 5 %.
        least = [0.3 * self.channel.floor.sd, self.channel.fault_rms]
        for finding in self.findings:
            removed = finding.removed_rms
            # Two of one family share it: beside the candidate the finding would take away too little.
            if finding.name != candidate.family or candidate.scope == "event":
                removed = self._removed_rms(finding.candidate, [*self._others(finding), candidate])
            least.append(share * removed)
        return max(least)

    def _others(self, finding: Finding) -> list[Candidate]:
        return [other.candidate for other in self.findings if other is not finding]

    def fix_unproven(self) -> None:
        """Before the first stage, leave as they are the effects of the present model that these runs do not
        prove, and refine the others: so far all findings are of that model."""
        for finding in [*self.findings]:
            if self.criterion(self.model) - self.criterion(self._others(finding)) <= PROVEN_GAIN:
                self.findings.remove(finding)
                self.of_present.remove(finding)
                fixed = (*self.channel.fixed_effects, finding.candidate.parts[0].effect)
                self.channel = replace(self.channel, fixed_effects=fixed)
        self._refine_each(exchange=False)

    def eliminate(self) -> None:
        """After the last stage, drop what others, or a refused partner, make needless; refine the rest."""
        # A finding gives way to an alternative where that is likelier beside what was found later.
        findings = [*self.findings]
        for finding in findings:
            # A single one needs no proof: the sum over the axes has proven it.  But nothing has proven one of
            # the present model, nor one whose partner was refused.
            if len(self.findings) == 1 and not (finding.of_present_model or finding.partner):
                continue
            gain = self.criterion(self.model) - self.criterion(self._others(finding))
            if gain <= PROVEN_GAIN:
                self.findings.remove(finding)
                self.refuse(finding.name, gain, [self.channel.name], "dropped, needless beside the rest")
        if len(findings) == 1 and not findings[0].of_present_model:
            return  # it was refined when it was added, with nothing beside it, as now
        before = [finding.name for finding in self.findings]
        self._refine_each(exchange=True)
        if changed := [finding.name for finding in self.findings if finding.name not in before]:
            self.history.append((f"{' and '.join(changed)} fits better beside the rest", self.model, np.nan))

    def _refine_each(self, exchange: bool) -> None:
        """Refine each finding beside the others; with `exchange` an alternative may take its place."""
        for finding in self.findings:
            others = self._others(finding)
            families = [finding.name, *(finding.alternatives if exchange else ())]
            # What is separate has a time or coefficients of its own in each run: it stays near where it is.
            tried = [one for one in self.candidates if one.family in families and one.shared]
            best = max(self.gains([finding.candidate, *tried], others), key=GAIN)
            if (new := best.candidate.family) != finding.name:
                del finding.alternatives[new]
                finding.alternatives = {finding.name: finding.candidate, **finding.alternatives}
                # Its gain is that of the same stage, where the others were not all there.
                finding.gain_over_axes += finding.family_gains[new] - finding.gain
                finding.gain = finding.family_gains[new]
            finding.candidate = self.refined(best.candidate, others).candidate
