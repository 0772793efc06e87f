"""What is claimed of a channel: what training proves and the test does not refute, or the test alone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding
from imumon.lab.diagnosis.fit import (
    CLEAN,
    EXPLAINED,
    MATERIAL,
    Fit,
    FittedPart,
    PartSigma,
    TestScore,
    begun,
    explained_share,
    explains,
    fit,
    goes_on,
    score_test,
    sigmas,
)
from imumon.lab.diagnosis.search import MOST_NAMES, Search
from imumon.lab.diagnosis.verdict import ChannelVerdict, Claim

PROVEN_FLOORS = 8.0
"""What the test alone proves takes so many white floors out of its error, as a root of squares: false ones of
effects that are not in the library, took out at most 5.4, true ones of a chamber record at least 90."""


@dataclass(frozen=True, slots=True)
class _Model:
    """Findings, the model with them, what the baseline and this one leave of the test, why nothing else is
    claimed, and what the test refuted."""

    findings: list[Finding]
    after: Fit
    tests: tuple[TestScore, TestScore]
    remark: str = ""
    left_out: Sequence[dict[str, Any]] = ()

    @property
    def new(self) -> list[Finding]:
        """The findings that are not of the present model."""
        return [one for one in self.findings if not one.known]


def decide(found: Search, channel: Channel) -> ChannelVerdict:
    """Return the verdict on a channel, in the blocks that are scored, by what the search found in it."""
    floor = channel.limit  # what digits make of a smooth bias is no structure
    baseline = fit(channel.as_given(), [])
    kept = _claimed(channel, found, baseline)
    after, (test_before, test_after) = kept.after, kept.tests
    # Jumps of the test itself may make the prediction worse, whatever else was found.
    predicts = (not after.parts or after.carries) and not test_after.rms > test_before.rms
    if not predicts and not (goes_on(channel, after) and test_after.rms < test_before.rms):
        # The declared model then predicts as it did, and is what the model file has.
        test_after.rms = test_before.rms
    left = max(after.train_rms, test_after.left) if kept.new else after.train_rms
    covariance, spread = sigmas(found.channel, found.likelihood, [one.candidate for one in kept.findings])
    claims, parts = [], iter(after.parts[len(channel.kept) :])
    for finding, sigma in zip(kept.findings, spread, strict=True):
        own = list(islice(parts, len(finding.candidate.parts)))
        if not finding.known:
            claims.append(_claim(channel, finding, own, sigma, baseline))
    refit = ["curve"] if channel.declared.degree else []
    refit += [one.name for one in kept.findings if one.known]
    return ChannelVerdict(
        found=found,
        channel=channel,
        before=baseline,
        after=after,
        test_before=test_before,
        test_after=test_after,
        findings=kept.findings,
        claims=claims,
        unexplained=found.many_events or left >= CLEAN * floor,
        explained=explained_share(baseline.train_rms, after.train_rms, floor) if kept.new else 0.0,
        remark=kept.remark,
        left_out=kept.left_out,
        predicts=predicts,
        refit=refit if channel.known is not None and predicts else [],
        declared_covariance=covariance,
    )


def _claim(
    channel: Channel, finding: Finding, parts: list[FittedPart], sigma: list[PartSigma], baseline: Fit
) -> Claim:
    """Return a finding with what it does alone."""
    alone = _fit(channel, [finding])
    share = explained_share(baseline.train_rms, alone.train_rms, channel.floor.sd)
    size = float(np.sqrt(max(baseline.train_rms**2 - alone.train_rms**2, 0.0)))
    return Claim(finding, parts, share, size, score_test(channel, alone).rms, sigma)


def _claimed(channel: Channel, found: Search, baseline: Fit) -> _Model:
    """Return what of the findings stays: what training or the test proves, and the test does not refute."""
    floor = channel.limit

    def model(findings: list[Finding]) -> _Model:
        after = _fit(channel, findings)
        return _Model(
            findings, after, (score_test(channel, baseline, like=after), score_test(channel, after))
        )

    # A jump that is too small to matter beside the rest is not told from the steps of a walk.
    lasting = [one for one in found.findings if one.candidate.scope != "event"]
    small = found.many_events or _fit(channel, lasting).train_rms < MATERIAL * channel.floor.sd
    nothing = model([one for one in found.findings if one.known])
    stay, left_out = _not_worse(channel, lasting if small else found.findings)
    kept = replace(model(stay), left_out=left_out)
    if kept.new and (why := _refuted(channel, baseline, kept, floor)):
        best = max(kept.new, key=lambda finding: finding.gain)
        kept = replace(
            nothing, left_out=left_out, remark=f"the best of the known effects is {best.name}, but {why}"
        )
    elif found.many_events:
        kept = replace(kept, remark="there is more than one jump in a run")
    left = kept.tests[1].left if kept.new else np.inf
    wanting = not kept.new or (kept.after.carries and left >= CLEAN * floor)
    if wanting and nothing.after.train_rms >= CLEAN * floor:
        one = _proven_by_test(channel, found, nothing)
        if one is not None:
            by_test = model([*nothing.findings, one])
            # What training proves goes first unless it leaves twice as much of the test.
            if 2.0 * by_test.tests[1].rms < left:
                return replace(by_test, left_out=left_out)
    return kept


def _not_worse(channel: Channel, findings: Sequence[Finding]) -> tuple[list[Finding], list[dict[str, Any]]]:
    """Return the findings without those that the test refutes, being worse with them, and what those did.

    What does not carry over is estimated in the test with both, and predicts nothing that could be refuted.
    """
    kept, left_out = list(findings), list[dict[str, Any]]()
    while kept and channel.test:
        everything = _fit(channel, kept)
        carried = {part.effect.label for part in everything.parts if part.carries}
        with_it, trials = score_test(channel, everything).estimated_rms, []
        for finding in kept:
            rest = _fit(channel, [one for one in kept if one is not finding])
            without = score_test(channel, rest, like=everything).estimated_rms
            if without < with_it and finding.name in carried:
                trials.append((without, finding))
        if not trials:
            break
        without, worst = min(trials, key=lambda trial: trial[0])
        left_out.append({"name": worst.name, "test_rms_with": with_it, "test_rms_without": without})
        kept.remove(worst)
    return kept, left_out


def _refuted(channel: Channel, baseline: Fit, model: _Model, floor: float) -> str:
    """Return what of training, or of the test, refutes a model; empty where nothing does.

    What is estimated in the test counts only where nothing is left: a level and a jump take away some of
    whatever is slow.
    """
    test_before, test_after = model.tests
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
    likelihood tells a loop that was gone through once from a wander.  But no wander goes the same way again.
    Only effects count that make the training likelier, by more than their coefficients cost, and only a test
    that is not woven into the training.  The test chooses here, so effects of other names that explain it as
    well are not told apart.
    """
    before = nothing.after
    if not channel.test or any(_woven(channel, run) for run in channel.test):
        return None
    also = [finding.candidate for finding in nothing.findings]
    hits: list[tuple[float, Finding]] = []
    for candidate, gain in _tried(channel, found, also):
        after = fit(channel, [*also, candidate])
        without, left = score_test(channel, before, like=after).rms, score_test(channel, after).rms
        large = without**2 - left**2 >= (PROVEN_FLOORS * channel.floor.sd) ** 2
        if large and explained_share(without, left, channel.floor.sd) >= EXPLAINED:
            hits.append((left, Finding(candidate, gain, gain, {candidate.family: gain}, by_test=True)))
    return chosen_by_test(hits)


def _tried(channel: Channel, found: Search, also: Sequence[Candidate]) -> Iterator[tuple[Candidate, float]]:
    """Yield the candidates that the test may prove, and the gain of their family.

    The likelihood looks at what is fast; of a slow course least squares see more.  So the best of each family
    is yielded by either.
    """
    for table in found.tables:
        for name, leader in table.items():
            if leader.fit > 0.0 and leader.candidate.carries:
                yield leader.candidate, leader.gain
                plain = [one for one in found.tried if len(one.parts) == 1 and not one.free_start]
                rest = [one for one in plain if one.family == name and one.carries]
                yield min(rest, key=lambda one: channel.residual_rms([*also, one])), leader.gain


def chosen_by_test(hits: Sequence[tuple[float, Finding]]) -> Finding | None:
    """Return, of effects with what they leave of the test, the one that leaves least; effects of other names
    are not told apart from it."""
    if not hits:
        return None
    by_name: dict[str, Finding] = {}
    for _, finding in sorted(hits, key=lambda hit: hit[0]):
        by_name.setdefault(finding.name, finding)
    best, *others = by_name.values()
    best.rivals = {name: finding.gain for name, finding in by_name.items()}
    best.others = {one.name: one.candidate for one in others[: MOST_NAMES - 1]}
    return best


def _woven(channel: Channel, run: RunBlocks) -> bool:
    """Return whether a test lies between parts of the training: any smooth course joins their ends."""
    at = begun(channel, run)
    return at is not None and bool(run.time_s[0] < channel.train[at].time_s[-1])


def _fit(channel: Channel, findings: Sequence[Finding]) -> Fit:
    return fit(channel, [finding.candidate for finding in findings])
