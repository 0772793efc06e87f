"""What is claimed of a channel: what training proves and the test does not refute, or the test alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from imumon.lab.diagnosis.alternatives import questions, ranking, runs_left
from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding
from imumon.lab.diagnosis.fit import (
    CLEAN,
    EXPLAINED,
    MATERIAL,
    Fit,
    PartSigma,
    TestScore,
    begun,
    explained_share,
    explains,
    fit,
    fit_baseline,
    goes_on,
    mean_rms,
    score_test,
    sigmas,
)
from imumon.lab.diagnosis.search import MOST_NAMES, Search, Stage
from imumon.lab.diagnosis.verdict import ChannelVerdict, Claim, SlowNoise

PROVEN_FLOORS = 8.0
"""What the test alone proves takes so many white floors out of its error, as a root of squares: false ones of
effects that are not in the library, took out at most 5.4, true ones of a chamber record at least 90."""


@dataclass(frozen=True, slots=True)
class _Model:
    """Findings, the model with them, what the baseline and this one leave of the test, and why nothing else
    is claimed."""

    findings: list[Finding]
    after: Fit
    tests: tuple[TestScore, TestScore]
    remark: str = ""

    @property
    def claims(self) -> bool:
        """Whether any of the findings is not of the present model."""
        return any(not one.known for one in self.findings)


def decide(channel: Channel, found: Search) -> ChannelVerdict:
    """Return the verdict on a channel: what is claimed of it by what the search found in it."""
    shape = replace(channel.declared, degree=found.channel.declared.degree)
    channel = replace(channel, declared=shape, kept=found.channel.kept)
    baseline = fit_baseline(channel)
    floor = channel.limit  # what digits make of a smooth bias is no structure
    kept, refuted = _claimed(channel, found, baseline, floor)
    after, (test_before, test_after) = kept.after, kept.tests
    # Jumps of the test itself may make the prediction worse, whatever else was found.
    predicts = (not after.parts or after.carries) and not test_after.rms > test_before.rms
    if not predicts and not (goes_on(channel, after) and test_after.rms < test_before.rms):
        # The declared model then predicts as it did, and is what the model file has.
        test_after.rms = test_before.rms
    left = max(after.train_rms, test_after.left) if kept.claims else after.train_rms
    unexplained = found.many_events or left >= CLEAN * floor
    covariance, spread = sigmas(found.channel, found.likelihood, [one.candidate for one in kept.findings])
    return ChannelVerdict(
        channel=channel,
        before=baseline,
        after=after,
        test_before=test_before,
        test_after=test_after,
        claims=_claims(channel, baseline, after, kept.findings, spread),
        unexplained=unexplained,
        explained=explained_share(baseline.train_rms, after.train_rms, floor) if kept.claims else 0.0,
        left_out=refuted,
        remark=kept.remark,
        predicts=predicts,
        slow=SlowNoise.of(found),
        questions=questions(channel, found, kept.findings, unexplained),
        refit=_refit(channel, found, kept.findings) if after is not baseline and predicts else [],
        stages=_stages(channel, found, baseline),
        ranking=ranking(channel, found),
        runs=runs_left(channel, baseline, after, kept.tests),
        declared_covariance=covariance,
    )


def _claimed(
    channel: Channel, found: Search, baseline: Fit, floor: float
) -> tuple[_Model, list[dict[str, Any]]]:
    """Return what of the findings stays, and those that the test refutes.

    That is what training or the test proves, and the test does not refute.
    """
    # A jump that is too small to matter beside the rest is not told from the steps of a walk.
    lasting = [one for one in found.findings if one.candidate.scope != "event"]
    small = found.many_events or _fit(channel, lasting).train_rms < MATERIAL * channel.floor.sd
    stay, refuted = _not_worse(channel, lasting if small else found.findings)
    known = [one for one in found.findings if one.known]
    before = _fit(channel, known) if found.refit else baseline
    nothing = _Model(known, before, _scores(channel, baseline, before))
    after = _fit(channel, stay)
    kept = _Model(stay, after, _scores(channel, baseline, after))
    if kept.claims and channel.test and not np.isfinite(kept.tests[1].rms):
        unscored = dict.fromkeys(("test_rms_with", "test_rms_without"), float("nan"))
        refuted += [{"name": one.name, **unscored} for one in stay if not one.known]
        kept = nothing
    elif kept.claims and (why := _too_little(baseline, after, kept.tests, floor)):
        best = max(found.findings, key=lambda finding: finding.gain)
        kept = replace(nothing, remark=f"the best of the known effects is {best.name}, but {why}")
    if found.many_events and not kept.remark:
        kept = replace(kept, remark="there is more than one jump in a run")
    left = kept.tests[1].left if kept.claims else np.inf
    wanting = not kept.claims or (kept.after.carries and left >= CLEAN * floor)
    if wanting and before.train_rms >= CLEAN * floor:
        one = _proven_by_test(channel, found, before, known)
        if one is not None:
            after = _fit(channel, [*known, one])
            by_test = _Model([*known, one], after, _scores(channel, baseline, after))
            # What training proves goes first unless it leaves twice as much of the test.
            if 2.0 * by_test.tests[1].rms < left:
                return by_test, refuted
    return kept, refuted


def _too_little(baseline: Fit, after: Fit, both: tuple[TestScore, TestScore], floor: float) -> str:
    """Return what is too little of training, or of the test, to claim anything; empty where it is enough.

    What is estimated in the test counts only where nothing is left: a level and a jump take away some of
    whatever is slow.
    """
    what, before, left = "the training", baseline.train_rms, after.train_rms
    if explains(before, left, floor):
        if not both[1].left >= CLEAN * floor or explains(both[0].rms, both[1].rms, floor):
            return ""
        what, before, left = "the test", both[0].rms, both[1].rms
    share = max(0.0, explained_share(before, left, floor))
    floors = f"{before / floor:.1f} white floors become {left / floor:.1f}"
    return f"it explains only {share:.0%} of {what}: {floors}"


def _not_worse(channel: Channel, findings: Sequence[Finding]) -> tuple[list[Finding], list[dict[str, Any]]]:
    """Return the findings without those that the test refutes, being worse with them, and what those did."""
    kept = list(findings)
    left_out: list[dict[str, Any]] = []
    while kept and channel.test:
        everything = _fit(channel, kept)
        trials = [_trial(channel, kept, finding, everything) for finding in kept]
        worst = min(range(len(kept)), key=lambda at: trials[at][0])
        if not trials[worst][0] < 0:
            break
        left_out.append(trials[worst][1])
        kept.pop(worst)
    return kept, left_out


def _trial(
    channel: Channel, kept: Sequence[Finding], finding: Finding, everything: Fit
) -> tuple[float, dict[str, Any]]:
    """Return by how much the test confirms a finding (negative when it refutes it), and the numbers.

    What does not carry over is estimated in the test with both, and predicts nothing that could be refuted.
    """
    carries = any(part.carries for part in everything.parts if part.effect.label == finding.name)
    with_it = score_test(channel, everything)
    without = score_test(channel, _fit(channel, [one for one in kept if one is not finding]), like=everything)
    count = [a & b for a, b in zip(with_it.counted, without.counted, strict=True)]
    rms = mean_rms(with_it.estimated, count), mean_rms(without.estimated, count)
    record = {"name": finding.name, "test_rms_with": rms[0], "test_rms_without": rms[1]}
    return (rms[1] ** 2 - rms[0] ** 2 if carries and np.isfinite(rms).all() else 0.0), record


def _proven_by_test(
    channel: Channel, found: Search, before: Fit, beside: Sequence[Finding]
) -> Finding | None:
    """Return the effect that predicts the test best, if it explains it, where training proves nothing.

    Noise that wanders as fast as it does within minutes may go anywhere within the hour, so that no
    likelihood tells a loop that was gone through once from a wander.  But no wander goes the same way again.
    `beside` is what is fitted anew of the present model.  Only effects count that make the training
    likelier, by more than their coefficients cost, and only a test that is not woven into the training.
    The test chooses here, so effects of other names that explain it as well are not told apart.
    """
    if not channel.test or any(_woven(channel, run) for run in channel.test):
        return None
    also = [finding.candidate for finding in beside]
    hits: list[tuple[float, Finding]] = []
    for name, leader in [item for table in found.tables for item in table.items()]:
        if leader.fit <= 0.0 or leader.candidate.scope in ("run", "event"):
            continue
        # The likelihood looks at what is fast; of a slow course least squares see more.
        fits = [(one, fit(channel, [*also, one])) for one in found.of_family(name)]
        slow = min(fits, key=lambda one: one[1].train_rms, default=None)
        for candidate in (leader.candidate, *([slow[0]] if slow is not None else [])):
            after = fit(channel, [*also, candidate])
            without, left = score_test(channel, before, like=after).rms, score_test(channel, after).rms
            large = without**2 - left**2 >= (PROVEN_FLOORS * channel.floor.sd) ** 2
            explains = large and explained_share(without, left, channel.floor.sd) >= EXPLAINED
            if explains and all(part.carries for part in after.parts):
                size = float(np.sqrt(max(before.train_rms**2 - after.train_rms**2, 0.0)))
                gain = leader.gain
                hits.append((left, Finding(candidate, gain, gain, {name: gain}, [], size, by_test=True)))
    return chosen_by_test(hits)


def chosen_by_test(hits: Sequence[tuple[float, Finding]]) -> Finding | None:
    """Return, of effects with what they leave of the test, the one that leaves least; effects of other names
    are not told apart from it."""
    if not hits:
        return None
    findings = [finding for _, finding in sorted(hits, key=lambda hit: hit[0])]
    by_name: dict[str, Finding] = {}
    for finding in findings:
        by_name.setdefault(finding.name, finding)
    names = list(by_name)[:MOST_NAMES]
    best = findings[0]
    best.rivals = {name: finding.gain for name, finding in by_name.items()}
    best.alike = names if len(names) > 1 else []
    best.others = {name: by_name[name].candidate for name in names[1:]}
    return best


def _woven(channel: Channel, run: RunBlocks) -> bool:
    """Return whether a test lies between parts of the training: any smooth course joins their ends."""
    at = begun(channel, run)
    return at is not None and bool(run.time_s[0] < channel.train[at].time_s[-1])


def _fit(channel: Channel, findings: Sequence[Finding]) -> Fit:
    return fit(channel, [finding.candidate for finding in findings])


def _scores(channel: Channel, before: Fit, after: Fit) -> tuple[TestScore, TestScore]:
    """Return the scores of two models over the blocks that count for the second."""
    return score_test(channel, before, like=after), score_test(channel, after)


def _claims(
    channel: Channel, before: Fit, after: Fit, kept: Sequence[Finding], spread: Sequence[list[PartSigma]]
) -> list[Claim]:
    claims, parts = [], iter(after.parts[len(channel.kept) :])
    for finding, sigma in zip(kept, spread, strict=True):
        own = list(islice(parts, len(finding.candidate.parts)))
        if not finding.known:
            alone = _fit(channel, [finding])
            share = explained_share(before.train_rms, alone.train_rms, channel.floor.sd)
            claims.append(Claim(finding, own, share, score_test(channel, alone).rms, sigma))
    return claims


def _refit(channel: Channel, found: Search, kept: Sequence[Finding]) -> list[str]:
    """Return what is fitted anew of the present model."""
    if channel.known is None:
        return []
    curve = ["curve"] if found.channel.declared.degree else []
    return [*curve, *(one.name for one in kept if one.known)]


def _stages(channel: Channel, found: Search, baseline: Fit) -> list[Stage]:
    """Return the stages of the search with what is left after each, in training and test."""
    stages = [Stage("what was assumed", ()), *found.stages]
    models = [baseline, *(fit(channel, stage.model) for stage in found.stages)]
    return [
        replace(stage, train_rms=model.train_rms, test_rms=score_test(channel, model).rms)
        for stage, model in zip(stages, models, strict=True)
    ]
