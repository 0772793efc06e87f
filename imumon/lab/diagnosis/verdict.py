"""The verdict on a channel: what is claimed of the findings, and the first row of `VERDICTS` that holds.

w is the white floor, f the total floor.  Of a residual rms A, the *baseline's* (the declared model, or the
present one as it is), a model that leaves B *explains* enough if B < 1.8 f, or if it has 0.6 of the excess::

    explained share = 1 - (B² - f²) / (A² - f²)                                                      (10)

What is claimed (`_claimable`):

1. *Events.*  A jump counts only where 1.3 w or more are left of training without it, and no run has two.
2. *Refuted.*  New findings without which the test is estimated better are left out, the worst one first.
3. (a) *By training.*  The others are claimed if they explain training and test, and 0.25 of both; else none.
4. (b) *By the test.*  Where 1.8 f are left of training without findings, and 3 claims nothing, or carries
   over (predicts the test) and leaves 1.8 f of it: of single effects, that is claimed which leaves least of
   it, if it takes away 8 w, has 0.6 of the excess over w, not f, and leaves less than half of what 3 leaves.

Predicates of `VERDICTS` are properties of `ChannelVerdict`; what is left is by the model with the claims.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by

from .candidates import Channel, Finding
from .fit import Fit, FittedPart, PartSigma, Score, fit, score_test, sigmas
from .search import MOST_NAMES, AxisSearch

SMALL_RESIDUAL = 1.8
"""Total floors below which a residual is explained: slow noise of 1.5 of them leaves that."""
CLEAN_RESIDUAL = 1.3
"""White (of coarse samples total) floors below which what is missing, 0.83 of them, is too small to count."""
LEAST_EXPLAINED = 0.6
"""Explained share (10) from which on effects are named, in training and in the test.  With it nothing is
named in 99 channels of causes that are no effect; on a chamber record true effects have 0.67 to 0.99."""
# The same of training and test together, whatever is left: true effects of half a floor have 0.28 or more;
# what a thermometer in steps of 1 °C makes of a steep curve mostly has less.
LEAST_OF_ALL = 0.25


class Row(NamedTuple):
    """A verdict: predicate of `ChannelVerdict` (empty: it always holds), kind in `report.json`, and words."""

    predicate: str
    state: str
    sentence: str


VERDICTS = (
    Row("faulty", "faulty", "the data is at fault, and no effect is looked for"),
    Row("claimed", "named", "{names}"),
    Row("unexplained", "unexplained", "unexplained"),
    Row("hidden", "too few digits", "too few digits to tell"),
    Row("clean", "nothing missing", "nothing is missing"),
    Row("", "not proven", "nothing is proven"),  # what is left is small, or only the test has it
)
BESIDE_CLAIMS = {
    "not_told_apart": ", not told apart",
    "by_test": ", proven by the test alone, so this test is no independent proof",
    "unexplained": ", and more that is unexplained",
    "hidden": "; too few digits to tell whether there is more",
}
"""What is added to the sentence of what is claimed, where a predicate holds."""
FLOORS_BY_TEST = 8.0
"""sqrt(A² - B²) of what the test alone proves, in white floors: false ones, of effects that are not in the
library, had at most 5.4, true ones of a chamber record at least 90."""


class Claim(NamedTuple):
    """An effect that is claimed, with its parts, and their sigmas, as fitted beside the other claims."""

    finding: Finding
    parts: list[FittedPart]
    sigmas: list[PartSigma]


@dataclass
class ChannelVerdict:
    """What is claimed of a channel, and how well it does."""

    search: AxisSearch
    channel: Channel  # in the blocks that are scored, where the search may have been in shorter ones
    before: Fit  # the baseline: the declared model, or the present one as it is
    after: Fit  # that with the findings
    test_before: Score
    test_after: Score
    findings: Sequence[Finding]
    claims: list[Claim]  # those of the findings that the present model has not
    unexplained: bool
    """More than 1.8 total floors are left in training, or in the test after the named effects; or a session
    has two jumps."""
    remark: str  # why nothing else is claimed
    left_out: Sequence[dict[str, Any]]  # what was found but made the test worse
    # Whether `after` goes into the model file, else `before` does: nothing of what is claimed carries over,
    # or the constants of the test make the prediction worse with it.
    predicts: bool
    refit: list[str]  # what was fitted anew of the present model, its curve first; empty where it stays
    # Of the declared coefficients, (degree + 1, degree + 1), as fitted in the blocks of the search.
    declared_covariance: FloatArray

    @property
    def name(self) -> str:
        """Name of the channel."""
        return self.channel.name

    @property
    def claimed(self) -> bool:
        """(a) the effects that pass explain 60 % of the excess or leave less than 1.8 total floors, in
        training and in the test, and a quarter of the excess of both; or (b) one effect takes away 8 white
        floors and 60 % of the excess of the test."""
        return bool(self.claims)

    @property
    def faulty(self) -> bool:
        """One value of the samples is far too frequent (saturation, dead band, dropouts)."""
        return self.channel.faulty

    @property
    def by_test(self) -> bool:
        """The effect was chosen by the test, as in (b)."""
        return any(claim.finding.by_test for claim in self.claims)

    @property
    def not_told_apart(self) -> bool:
        """Effects of other names fit as well."""
        return any(claim.finding.alternatives for claim in self.claims)

    @property
    def hidden(self) -> bool:
        """The resolution (quantization) of the samples may make as much as is left.

        Even where nothing is left: a bias that stays within a step is not read at all.
        """
        channel, test = self.channel, self.test_after
        if self.unexplained or not channel.coarse or self.faulty:
            return False
        rms = test.smaller_rms if self.claims else test.rms
        return not rms >= CLEAN_RESIDUAL * channel.total_floor  # true of NaN, too: without a test

    @property
    def clean(self) -> bool:
        """Less than 1.3 white floors are left in the test."""
        return self.test_after.rms < CLEAN_RESIDUAL * self.channel.floor.sd

    @property
    def shifted(self) -> bool:
        """Less than 1.8 total floors are left of training, and of the test but for a constant of each run."""
        small, score = SMALL_RESIDUAL * self.channel.total_floor, self.test_after
        runs = [r[c] for r, c in zip(score.predicted_residual, score.counts, strict=True) if c.any()]
        return score.rms >= small > max(self.after.train_rms, *(float(run.std()) for run in runs))

    @property
    def row(self) -> Row:
        """The verdict: the first row of the table whose predicate holds."""
        return next(row for row in VERDICTS if not row.predicate or getattr(self, row.predicate))

    @property
    def in_short(self) -> str:
        """The verdict in a few words."""
        found = [claim.finding for claim in self.claims]
        # A name that is not told apart from another claim, and is claimed itself, is another one of it.
        again = {finding.name: f"another {finding.name}" for finding in found}
        each = [" or ".join([one.name, *(again.get(n, n) for n in one.alternatives)]) for one in found]
        names = [f"({name})" if " or " in name and len(each) > 1 else name for name in dict.fromkeys(each)]
        text = self.row.sentence.format(names=" and ".join(names))
        if self.row.predicate == "claimed":
            text += "".join(more for predicate, more in BESIDE_CLAIMS.items() if getattr(self, predicate))
        return text

    @property
    def summary(self) -> str:
        """The verdict with its numbers and reasons."""
        if self.faulty:
            return "; ".join([*self.channel.faults, self.in_short])
        reasons = [_numbers(self), *([self.remark] if self.remark else [])]
        reasons += [f"{item['name']} was found but made the test worse" for item in self.left_out]
        pairs = [(claim.finding.name, other) for claim in self.claims for other in claim.finding.alternatives]
        if pairs:
            reasons.append(f"to separate: {'; '.join(dict.fromkeys(separated_by(*pair) for pair in pairs))}")
        if self.hidden:
            share = self.channel.fault_rms / self.channel.floor.sd
            reasons.append(f"steps as coarse may make up to {share:.1f} of a smooth bias")
        return "; ".join([*self.channel.faults, f"{self.in_short}: {'; '.join(reasons)}"])


def _numbers(verdict: ChannelVerdict) -> str:
    """Return what is left, in white floors, of training and of the test: only that shows if it is all."""
    floor, score = verdict.channel.floor.sd, verdict.test_after
    before, after = verdict.before.train_rms / floor, verdict.after.train_rms / floor
    changed = verdict.claims or verdict.refit
    anew = "" if verdict.claims else f"{', '.join(verdict.refit)} fitted anew, "
    text = (
        f"{anew}{before:.1f} white floors become {after:.2f} in training"
        if changed
        else f"the declared model leaves {before:.2f} white floors in training"
    )
    if not verdict.channel.test:
        return f"{text}; without a test that is no proof"
    if not np.isfinite(score.rms):
        return f"{text}; no proof: the test has too little inside what training covered"
    covered = "" if score.coverage == 1.0 else f", over the {score.coverage:.0%} of it that training covered"
    before = verdict.test_before.rms / floor
    if not changed:
        return f"{text}, {before:.2f} in the test{covered}"
    predicted = verdict.predicts and verdict.after.carries_over
    predicted |= score.continues_training and score.rms < verdict.test_before.rms
    value, how = (score.rms, "predicted") if predicted else (score.estimated_rms, "estimated in the test")
    return f"{text}, {before:.1f} become {value / floor:.2f} in the test{covered} ({how})"


def explained_share(before: float, after: float, floor: float) -> float:
    """Return the explained share (10), 0 where `before` is below the (total or white) floor; all are rms."""
    excess = before**2 - floor**2
    return 1.0 - (after**2 - floor**2) / excess if excess > 0 and np.isfinite(after) else 0.0


class _Hypothesis(NamedTuple):
    """Findings that may be claimed, the model with them, and the scores of the baseline and of this one."""

    findings: list[Finding]
    after: Fit
    test_before: Score
    test_after: Score
    remark: str = ""

    @property
    def new(self) -> list[Finding]:
        """The findings that are not of the present model."""
        return [finding for finding in self.findings if not finding.of_present_model]


def decide(search: AxisSearch, channel: Channel) -> ChannelVerdict:
    """Return the verdict on a channel, in the blocks that are scored, by what the search found in it."""
    baseline, left_out = fit(channel.with_model_fixed(), []), list[Any]()
    claimed = _claimable(channel, search, baseline, left_out)
    _, after, test_before, test_after, remark = claimed
    # Jumps of the test itself may make the prediction worse, whatever else was found.
    # Without a test its rms are NaN: nothing is worse, and `max` returns its first.
    predicts = (not after.parts or after.carries_over) and not test_after.rms > test_before.rms
    if not predicts and not (test_after.continues_training and test_after.rms < test_before.rms):
        # Then only the baseline predicts, which is what the model file has; the estimated rms stays.
        test_after = test_after._replace(
            rms=test_before.rms, predicted_residual=test_before.predicted_residual
        )
    residual_rms = max(after.train_rms, test_after.smaller_rms) if claimed.new else after.train_rms
    model = [finding.candidate for finding in claimed.findings]
    # In the blocks of the search on purpose: its likelihood knows the noise.
    covariance, part_sigmas = sigmas(search.channel, search.survey, search.likelihood, model)
    parts = iter(after.parts[len(channel.fixed_effects) :])
    parts_of_each = [list(islice(parts, len(candidate.parts))) for candidate in model]
    claims = map(Claim, claimed.findings, parts_of_each, part_sigmas)
    refit = ["curve"] if channel.degree else []
    refit += [finding.name for finding in claimed.findings if finding.of_present_model]
    return ChannelVerdict(
        search=search,
        channel=channel,
        before=baseline,
        after=after,
        test_before=test_before,
        test_after=test_after,
        findings=claimed.findings,
        claims=[claim for claim in claims if not claim.finding.of_present_model],
        unexplained=search.repeated_event or residual_rms >= SMALL_RESIDUAL * channel.total_floor,
        remark=remark,
        left_out=left_out,
        predicts=predicts,
        refit=refit if channel.present_effects is not None and predicts else [],
        declared_covariance=covariance,
    )


def _claimable(channel: Channel, search: AxisSearch, baseline: Fit, left_out: list[Any]) -> _Hypothesis:
    """Return what is claimed, in the four steps of the module docstring; adds to `left_out`."""

    def hypothesis(findings: list[Finding]) -> _Hypothesis:
        after = fit(channel, [finding.candidate for finding in findings])
        test_before = score_test(channel, baseline, settled_as=after)
        return _Hypothesis(findings, after, test_before, score_test(channel, after))

    base = hypothesis([one for one in search.findings if one.of_present_model])  # nothing that was found
    lasting = [finding for finding in search.findings if finding.candidate.scope != "event"]  # 1
    without_jumps = fit(channel, [finding.candidate for finding in lasting]).train_rms
    small_jumps = search.repeated_event or without_jumps < CLEAN_RESIDUAL * channel.floor.sd
    findings = lasting if small_jumps else search.findings
    trained = hypothesis(_not_refuted(channel, findings, left_out))  # 2
    if trained.new and (why := _refutation(channel, baseline, trained)):  # 3
        best = max(trained.new, key=lambda finding: finding.gain)
        trained = base._replace(remark=f"the best of the known effects is {best.name}, but {why}")
    elif search.repeated_event:
        trained = trained._replace(remark="there is more than one jump in a run")
    small = SMALL_RESIDUAL * channel.total_floor
    residual_rms = trained.test_after.smaller_rms if trained.new else np.inf
    still_open = not trained.new or (trained.after.carries_over and residual_rms >= small)
    if still_open and base.after.train_rms >= small and (proven := _proven_by_test(channel, search, base)):
        by_test = hypothesis([*base.findings, proven])  # 4
        # What training proves goes first unless it leaves twice as much of the test (assumed).
        if 2.0 * by_test.test_after.rms < residual_rms:
            return by_test
    return trained


def _not_refuted(channel: Channel, findings: list[Finding], left_out: list[Any]) -> list[Finding]:
    """Return what passes step 2; what does not carry over predicts nothing that could be refuted."""
    passed = list(findings)
    while passed and channel.test:
        everything = fit(channel, [finding.candidate for finding in passed])
        predicting = {part.effect.label for part in everything.parts if part.carries_over}
        with_it, trials = score_test(channel, everything).estimated_rms, []
        for finding in (each for each in passed if each.name in predicting and not each.of_present_model):
            others = fit(channel, [other.candidate for other in passed if other is not finding])
            without = score_test(channel, others, settled_as=everything).estimated_rms
            trials += [(without, finding)] if without < with_it else []
        if not trials:
            break
        without, worst = min(trials, key=lambda trial: trial[0])
        left_out.append({"name": worst.name, "test_rms_with": with_it, "test_rms_without": without})
        passed.remove(worst)
    return passed


def _refutation(channel: Channel, baseline: Fit, found: _Hypothesis) -> str:
    """Return what of training, or of the test, refutes a hypothesis; empty where nothing does.

    To estimate takes some of all slow noise away: it counts where nothing is left, and beside training only.
    """
    floor, white, score = channel.total_floor, channel.floor.sd, found.test_after
    if channel.test and not np.isfinite(score.rms):
        return "no block of the test can be scored with it"

    def too_little(what: str, before: float, after: float, least: float) -> str:
        share = explained_share(before, after, floor)
        return (
            f"it explains only {max(0.0, share):.0%} of {what}:"
            f" {before / white:.1f} white floors become {after / white:.1f}"
            if share < least
            else ""
        )

    train_before, train_after = baseline.train_rms, found.after.train_rms
    why = too_little("the training", train_before, train_after, LEAST_EXPLAINED)
    if why and train_after >= SMALL_RESIDUAL * floor:
        return why
    why = too_little("the test", found.test_before.rms, score.rms, LEAST_EXPLAINED)
    if why and channel.test and score.smaller_rms >= SMALL_RESIDUAL * floor:
        return why
    # Whatever is left; without a test, whose rms is NaN, of the training alone.
    both_before, both_after = np.sqrt(
        np.nanmean(np.square([[train_before, found.test_before.rms], [train_after, score.smaller_rms]]), 1)
    )
    return too_little("all recordings", both_before, both_after, LEAST_OF_ALL)


def _proven_by_test(channel: Channel, search: AxisSearch, base: _Hypothesis) -> Finding | None:
    """Return the effect that predicts the test best, if it explains it, where training proves nothing.

    Noise that wanders as fast as it does within minutes may go anywhere within the hour, so that no
    likelihood separates a loop gone through once from a wander.  But no wander goes the same way again.
    Only effects count that make the training likelier, by more than their coefficients cost: the best of each
    family by the likelihood, and by least squares.
    """
    if not channel.test or any(run.run.woven for run in channel.test):
        return None
    plain = [one for one in search.candidates if one.shared and len(one.parts) == 1 and not one.free_start]
    hits: list[tuple[float, Finding]] = []
    for leader in (scored for table in search.tables for scored in table.values()):
        if not (leader.linear_gain > 0.0 and leader.candidate.shared):
            continue
        # The likelihood looks at what is fast; of a slow course least squares see more.
        of_family = [candidate for candidate in plain if candidate.family == leader.candidate.family]
        # There is one: what is late as a whole or has a free start is made of the plain ones of its family.
        closest = min(of_family, key=lambda one: channel.residual_rms([*search.present, one]))
        for candidate in (leader.candidate, closest):
            after = fit(channel, [*search.present, candidate])
            without = score_test(channel, base.after, settled_as=after).rms
            with_it, floor = score_test(channel, after).rms, channel.floor.sd
            large = without**2 - with_it**2 >= (FLOORS_BY_TEST * floor) ** 2
            if large and explained_share(without, with_it, floor) >= LEAST_EXPLAINED:
                hits.append((with_it, Finding(candidate, leader.gain, leader.gain, by_test=True)))
    return chosen_by_test(hits)


def chosen_by_test(hits: Sequence[tuple[float, Finding]]) -> Finding | None:
    """Return the effect that leaves the least rms of the test; other names are not told apart from it."""
    if not hits:
        return None
    by_name: dict[str, Finding] = {}
    for _, finding in sorted(hits, key=lambda hit: hit[0]):
        by_name.setdefault(finding.name, finding)
    best, *others = by_name.values()
    best.family_gains = {name: finding.gain for name, finding in by_name.items()}
    best.alternatives = {other.name: other.candidate for other in others[: MOST_NAMES - 1]}
    return best
