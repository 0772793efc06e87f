"""The verdict on a channel: one table of named predicates, evaluated top down, and its words.

Claimed is what training proves and the test does not refute, or what the test alone proves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by
from imumon.lab.diagnosis.candidates import Channel, Finding
from imumon.lab.diagnosis.fit import Fit, FittedPart, PartSigma, TestScore, fit, goes_on, score_test, sigmas
from imumon.lab.diagnosis.search import MOST_NAMES, Search

CLEAN = 1.8
"""Residual below which it is explained, in limits (`Channel.limit`: the white floor and what rounding adds to
it, the same where digits are fine): slow noise of 1.5 floors leaves that."""
MATERIAL = 1.3
"""Residual below which what is missing is too small to matter, 0.83 floors, in limits."""
EXPLAINED = 0.6
"""Share of the excess, the square above that of the limit, that has to be explained before anything is named,
in training and in the test.  With it nothing is named in any of 99 channels with wanders, walks, telegraph
noise, bursts and a hidden supply; on a chamber record true effects have 0.67 to 0.99."""


class Row(NamedTuple):
    """A verdict: the first row of the table whose `predicate`, of `ChannelVerdict`, holds; an empty one does.

    `state` is the kind of verdict in `report.json`, and the sentence has the names of what is claimed.
    """

    predicate: str
    state: str
    sentence: str


VERDICTS = (
    Row("faulty", "faulty", "the data is at fault, and no effect is looked for"),
    Row("claimed", "named", "{names}"),
    Row("unexplained", "unexplained", "unexplained"),
    Row("hidden", "too few digits", "too few digits to tell"),
    Row("clean", "nothing missing", "nothing is missing"),
    Row("", "not proven", "nothing is proven"),
)
BESIDE_CLAIMS = {
    "not_told_apart": ", not told apart",
    "by_test": ", proven by the test alone, so the error there is no longer unseen",
    "unexplained": ", and more that is unexplained",
    "hidden": "; too few digits to tell whether there is more",
}
"""What is added to the sentence of what is claimed, where a predicate holds."""
PROVEN_FLOORS = 8.0
"""What the test alone proves takes so many white floors out of its error, as a root of squares: false ones of
effects that are not in the library, took out at most 5.4, true ones of a chamber record at least 90."""


@dataclass(slots=True)
class Claim:
    """An effect that is claimed, with its evidence; `parts` and `sigmas` are those of the whole model.

    `explained` is the share, and `size` the rms, that it takes away from training alone; `test_alone` is what
    it then leaves of the test.
    """

    finding: Finding
    parts: list[FittedPart]
    explained: float
    size: float
    test_alone: float
    sigmas: list[PartSigma]


@dataclass(slots=True)
class ChannelVerdict:
    """What is claimed of a channel, and how well it does."""

    found: Search
    channel: Channel
    """In the blocks that are scored, where the search may have been in shorter ones."""
    before: Fit
    after: Fit
    """Declared and extended model, and how they do on the test."""
    test_before: TestScore
    test_after: TestScore
    findings: Sequence[Finding]
    """What is in the extended model."""
    claims: list[Claim]
    """Those of the findings that the present model has not."""
    unexplained: bool
    """More than 1.8 floors are left in training, or in the test after the named effects; or a session has two
    jumps."""
    remark: str
    left_out: Sequence[dict[str, Any]]
    """What was found but made the test worse."""
    predicts: bool
    """Whether the extended model goes into the model file; else the declared one does: nothing of what is
    claimed carries over, or the levels of the test make the prediction worse with it."""
    refit: list[str]
    """What was fitted anew of the present model, its curve first; empty when that stays as it is."""
    declared_covariance: FloatArray
    """Of the coefficients of the declared model, (degree + 1, degree + 1)."""

    @property
    def name(self) -> str:
        """Name of the channel."""
        return self.channel.name

    @property
    def claimed(self) -> bool:
        """(a) the effects that pass explain 60 % of the excess or leave less than 1.8 floors, in training and
        in the test; or (b) one effect takes away 8 floors and 60 % of the excess of the test."""
        return bool(self.claims)

    @property
    def faulty(self) -> bool:
        """One value of the samples is far too frequent (saturation, dead band, dropouts)."""
        return bool(np.isinf(self.channel.blind))

    @property
    def by_test(self) -> bool:
        """The effect was chosen by the test, as in (b).

        Training proves none, or what it proves leaves more than twice as much of the test.
        """
        return any(claim.finding.by_test for claim in self.claims)

    @property
    def not_told_apart(self) -> bool:
        """Effects of other names fit as well."""
        return any(claim.finding.alike for claim in self.claims)

    @property
    def hidden(self) -> bool:
        """The resolution (quantization) of the samples may make as much as is left.

        Even where nothing is left: a bias that stays within a step is not read at all.
        """
        channel, test = self.channel, self.test_after
        if self.unexplained or not channel.coarse or self.faulty:
            return False
        left = test.left if self.claims else test.rms
        return not left >= MATERIAL * channel.limit

    @property
    def clean(self) -> bool:
        """Less than 1.3 floors are left in the test."""
        return self.test_after.rms < MATERIAL * self.channel.floor.sd

    @property
    def row(self) -> Row:
        """The verdict: the first row of the table whose predicate holds."""
        return next(row for row in VERDICTS if not row.predicate or getattr(self, row.predicate))

    @property
    def in_short(self) -> str:
        """The verdict in a few words."""
        each = [" or ".join(claim.finding.alike) or claim.finding.name for claim in self.claims]
        names = [f"({name})" if " or " in name and len(each) > 1 else name for name in dict.fromkeys(each)]
        text = self.row.sentence.format(names=" and ".join(names))
        if self.row.predicate == "claimed":
            text += "".join(more for name, more in BESIDE_CLAIMS.items() if getattr(self, name))
        return text

    @property
    def summary(self) -> str:
        """The verdict with its numbers and reasons."""
        if self.faulty:
            return "; ".join([*self.channel.faults, self.in_short])
        reasons = [_numbers(self), *([self.remark] if self.remark else [])]
        reasons += [f"{item['name']} was found but made the test worse" for item in self.left_out]
        pairs = [(one.finding.name, other) for one in self.claims for other in one.finding.others]
        if pairs:
            reasons.append(f"to separate: {'; '.join(dict.fromkeys(separated_by(*pair) for pair in pairs))}")
        if self.hidden:
            share = self.channel.blind / self.channel.floor.sd
            reasons.append(f"steps as coarse may make up to {share:.1f} of a smooth bias")
        return "; ".join([*self.channel.faults, f"{self.in_short}: {'; '.join(reasons)}"])


def _numbers(verdict: ChannelVerdict) -> str:
    """Return what is left, in white floors, of training and of the test: only that shows if it is all."""
    floor, score = verdict.channel.floor.sd, verdict.test_after
    before, after = verdict.before.train_rms / floor, verdict.after.train_rms / floor
    changed = bool(verdict.claims or verdict.refit)
    text = f"the declared model leaves {before:.2f} white floors in training"
    if changed:
        anew = "" if verdict.claims else f"{', '.join(verdict.refit)} fitted anew, "
        text = f"{anew}{before:.1f} white floors become {after:.2f} in training"
    if not verdict.channel.test:
        return f"{text}; without a test that is no proof"
    if not np.isfinite(score.rms):
        return f"{text}; no proof: the test has too little inside what training covered"
    covered = "" if score.coverage == 1.0 else f", over the {score.coverage:.0%} of it that training covered"
    before = verdict.test_before.rms / floor
    if not changed:
        return f"{text}, {before:.2f} in the test{covered}"
    predicted = verdict.predicts and verdict.after.carries
    predicted |= goes_on(verdict.channel, verdict.after) and score.rms < verdict.test_before.rms
    value, how = (score.rms, "predicted") if predicted else (score.estimated_rms, "estimated in the test")
    return f"{text}, {before:.1f} become {value / floor:.2f} in the test{covered} ({how})"


# What is claimed


def explained_share(before: float, after: float, floor: float) -> float:
    """Return the share of the excess of the mean square over the white floor that is explained, or 0."""
    excess = before**2 - floor**2
    return 1.0 - (after**2 - floor**2) / excess if excess > 0 and np.isfinite(after) else 0.0


def explains(before: float, after: float, floor: float) -> bool:
    """Return whether a model that leaves `after` explains enough of what another left to be named."""
    return after < CLEAN * floor or explained_share(before, after, floor) >= EXPLAINED


class _Model(NamedTuple):
    """Findings, the model with them, and what the baseline and this one leave of the test."""

    findings: list[Finding]
    after: Fit
    tests: tuple[TestScore, TestScore]
    remark: str = ""
    """Why nothing else is claimed."""

    @property
    def new(self) -> list[Finding]:
        """The findings that are not of the present model."""
        return [one for one in self.findings if not one.known]


def decide(found: Search, channel: Channel) -> ChannelVerdict:
    """Return the verdict on a channel, in the blocks that are scored, by what the search found in it."""
    baseline, left_out = fit(channel.as_given(), []), list[Any]()
    kept = _claimed(channel, found, baseline, left_out)
    after, (test_before, test_after) = kept.after, kept.tests
    # Jumps of the test itself may make the prediction worse, whatever else was found.
    predicts = (not after.parts or after.carries) and not test_after.rms > test_before.rms
    if not predicts and not (goes_on(channel, after) and test_after.rms < test_before.rms):
        # The declared model then predicts as it did, and is what the model file has.
        test_after.rms = test_before.rms
    left = max(after.train_rms, test_after.left) if kept.new else after.train_rms
    covariance, spread = sigmas(found.channel, found.likelihood, [one.candidate for one in kept.findings])
    refit = ["curve"] if channel.degree else []
    refit += [one.name for one in kept.findings if one.known]
    return ChannelVerdict(
        found=found,
        channel=channel,
        before=baseline,
        after=after,
        test_before=test_before,
        test_after=test_after,
        findings=kept.findings,
        claims=_claims(channel, kept, baseline, spread),
        unexplained=found.many_events or left >= CLEAN * channel.limit,
        remark=kept.remark,
        left_out=left_out,
        predicts=predicts,
        refit=refit if channel.known is not None and predicts else [],
        declared_covariance=covariance,
    )


def _claims(channel: Channel, kept: _Model, baseline: Fit, spread: Sequence[list[PartSigma]]) -> list[Claim]:
    """Return what is claimed with its evidence: what each effect does alone."""
    claims, parts = [], iter(kept.after.parts[len(channel.kept) :])
    for finding, sigma in zip(kept.findings, spread, strict=True):
        own = list(islice(parts, len(finding.candidate.parts)))
        if not finding.known:
            alone = fit(channel, [finding.candidate])
            share = explained_share(baseline.train_rms, alone.train_rms, channel.floor.sd)
            size = float(np.sqrt(max(baseline.train_rms**2 - alone.train_rms**2, 0.0)))
            claims.append(Claim(finding, own, share, size, score_test(channel, alone).rms, sigma))
    return claims


def _claimed(channel: Channel, found: Search, baseline: Fit, left_out: list[Any]) -> _Model:
    """Return what of the findings stays: what training or the test proves, and the test does not refute."""
    floor = channel.limit

    def model(findings: list[Finding]) -> _Model:
        after = fit(channel, [one.candidate for one in findings])
        tests = score_test(channel, baseline, like=after), score_test(channel, after)
        return _Model(findings, after, tests)

    # A jump that is too small to matter beside the rest is not distinguished from the steps of a walk.
    lasting = [one for one in found.findings if one.candidate.scope != "event"]
    without = fit(channel, [one.candidate for one in lasting]).train_rms
    small = found.many_events or without < MATERIAL * channel.floor.sd
    nothing = model([one for one in found.findings if one.known])
    kept = model(_not_worse(channel, lasting if small else found.findings, left_out))
    if kept.new and (why := _refuted(channel, baseline, kept)):
        best = max(kept.new, key=lambda finding: finding.gain)
        kept = nothing._replace(remark=f"the best of the known effects is {best.name}, but {why}")
    elif found.many_events:
        kept = kept._replace(remark="there is more than one jump in a run")
    left = kept.tests[1].left if kept.new else np.inf
    wanting = not kept.new or (kept.after.carries and left >= CLEAN * floor)
    if wanting and nothing.after.train_rms >= CLEAN * floor:
        one = _proven_by_test(channel, found, nothing)
        by_test = None if one is None else model([*nothing.findings, one])
        # What training proves goes first unless it leaves twice as much of the test.
        if by_test is not None and 2.0 * by_test.tests[1].rms < left:
            return by_test
    return kept


def _not_worse(channel: Channel, findings: list[Finding], left_out: list[Any]) -> list[Finding]:
    """Return the findings without those that the test refutes, being worse with them: they are left out.

    What does not carry over is estimated in the test with both, and predicts nothing that could be refuted.
    """
    kept = list(findings)
    while kept and channel.test:
        everything = fit(channel, [one.candidate for one in kept])
        carried = {part.effect.label for part in everything.parts if part.carries}
        with_it, trials = score_test(channel, everything).estimated_rms, []
        for finding in (one for one in kept if one.name in carried):
            rest = fit(channel, [one.candidate for one in kept if one is not finding])
            without = score_test(channel, rest, like=everything).estimated_rms
            trials += [(without, finding)] if without < with_it else []
        if not trials:
            break
        without, worst = min(trials, key=lambda trial: trial[0])
        left_out.append({"name": worst.name, "test_rms_with": with_it, "test_rms_without": without})
        kept.remove(worst)
    return kept


def _refuted(channel: Channel, baseline: Fit, model: _Model) -> str:
    """Return what of training, or of the test, refutes a model; empty where nothing does.

    What is estimated in the test counts only where nothing is left, for it takes away some of all slow noise.
    """
    floor, (test_before, test_after) = channel.limit, model.tests
    if channel.test and not np.isfinite(test_after.rms):
        return "no block of the test can be scored with it"
    what, before, left = "the training", baseline.train_rms, model.after.train_rms
    if explains(before, left, floor):
        if not test_after.left >= CLEAN * floor or explains(test_before.rms, test_after.rms, floor):
            return ""
        what, before, left = "the test", test_before.rms, test_after.rms
    share = max(0.0, explained_share(before, left, floor))
    floors = f"{before / floor:.1f} white floors become {left / floor:.1f}"
    return f"it explains only {share:.0%} of {what}: {floors}"


def _proven_by_test(channel: Channel, found: Search, nothing: _Model) -> Finding | None:
    """Return the effect that predicts the test best, if it explains it, where training proves nothing.

    Noise that wanders as fast as it does within minutes may go anywhere within the hour, so that no
    likelihood separates a loop gone through once from a wander.  But no wander goes the same way again.
    Only effects count that make the training likelier, by more than their coefficients cost: the best of each
    family by the likelihood, and by least squares.  The test chooses here, so effects of other names that
    explain it as well are not told apart.
    """
    if not channel.test or any(one.run.woven for one in channel.test):
        return None
    before, also = nothing.after, [finding.candidate for finding in nothing.findings]
    plain = [one for one in found.tried if one.carries and len(one.parts) == 1 and not one.free_start]
    hits: list[tuple[float, Finding]] = []
    for leader in (one for table in found.tables for one in table.values()):
        if not (leader.fit > 0.0 and leader.candidate.carries):
            continue
        # The likelihood looks at what is fast; of a slow course least squares see more.
        rest = [one for one in plain if one.family == leader.family]
        closest = min(rest, key=lambda one: channel.residual_rms([*also, one]))
        for candidate in (leader.candidate, closest):
            after = fit(channel, [*also, candidate])
            without, left = score_test(channel, before, like=after).rms, score_test(channel, after).rms
            large = without**2 - left**2 >= (PROVEN_FLOORS * channel.floor.sd) ** 2
            if large and explained_share(without, left, channel.floor.sd) >= EXPLAINED:
                hits.append((left, Finding(candidate, leader.gain, leader.gain, by_test=True)))
    return chosen_by_test(hits)


def chosen_by_test(hits: Sequence[tuple[float, Finding]]) -> Finding | None:
    """Return the effect that leaves least of the test; those of other names are not told apart from it."""
    if not hits:
        return None
    by_name: dict[str, Finding] = {}
    for _, finding in sorted(hits, key=lambda hit: hit[0]):
        by_name.setdefault(finding.name, finding)
    best, *others = by_name.values()
    best.rivals = {name: finding.gain for name, finding in by_name.items()}
    best.others = {one.name: one.candidate for one in others[: MOST_NAMES - 1]}
    return best
