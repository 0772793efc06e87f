"""Decide which of the effects found are claimed: by share explained, by the test, and by size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.channel import Channel
from imumon.diagnosis.fit import (
    CLEAN,
    MATERIAL,
    Fit,
    FittedPart,
    PartSigma,
    TestScore,
    evidence_of_test,
    explained_share,
    explains,
    fit,
    fit_given,
    goes_on,
    mean_rms,
    score,
    sigmas,
)
from imumon.diagnosis.gains import PROVEN
from imumon.diagnosis.likelihood import WALK_S
from imumon.diagnosis.looking import Ranked, RunLeft, ranking, runs_left
from imumon.diagnosis.proven_by_test import proven_by_test
from imumon.diagnosis.questions import Question, questions
from imumon.diagnosis.selection import Finding, Search, Step
from imumon.effects.library import separated_by

TOO_FEW = "too few digits to tell"
BY_TEST = "the test alone proves it: in training noise as slow as the one that is seen might go as far"


@dataclass(slots=True)
class Claim:
    """An effect that is claimed, with its evidence; `parts` and `sigmas` are those of the whole model.

    `test_gain` is the evidence of the test for it, beside the rest; NaN where it predicts nothing.
    """

    finding: Finding
    parts: list[FittedPart]
    explained: float
    test_alone: float
    sigmas: list[PartSigma] = field(default_factory=list)
    test_gain: float = float("nan")


@dataclass(frozen=True, slots=True)
class SlowNoise:
    """Flicker, rms over the correlation times of the likelihood, and random walk per root of a second.

    `tails` is the gain in BIC of innovations with heavy tails: where that is large it is no such noise.
    """

    flicker: float = 0.0
    walk: float = 0.0
    tails: float = 0.0

    @classmethod
    def of(cls, found: Search) -> Self:
        """Return that of the model that was found."""
        noise, channel, sd = found.null()[1], found.channel, found.noise_sd()
        flicker, walk = np.sqrt(noise)
        tails = found.likelihood.tails(channel.values, channel.design(found.found), noise)
        return cls(float(flicker * sd), float(walk * sd / np.sqrt(WALK_S)), tails)

    @property
    def jumps(self) -> bool:
        """Whether it jumps or comes in bursts, as no Gaussian noise does."""
        return self.tails > PROVEN


@dataclass(slots=True)
class ChannelVerdict:
    """What is said of a channel."""

    channel: Channel
    before: Fit
    after: Fit
    """Declared and extended model."""
    test_before: TestScore | None
    test_after: TestScore | None
    """None without a test."""
    claims: list[Claim]
    unexplained: bool
    summary: str
    explained: float
    noise: tuple[float, float]
    left_out: list[dict[str, Any]] = field(default_factory=list)
    """What was found but made the test worse."""
    remark: str = ""
    predicts: bool = True
    """Whether the extended model goes into the model file; else the declared one does: nothing of what is
    claimed carries over, or the levels of the test make the prediction worse with it."""
    slow: SlowNoise = SlowNoise()
    """In the unit of the channel."""
    questions: list[Question] = field(default_factory=list)
    """What is open."""
    refit: list[str] = field(default_factory=list)
    """What was fitted anew of a model that was given, its curve first; empty when that stays as it is."""
    turns: list[Step] = field(default_factory=list)
    """The turns of the loop."""
    ranking: list[Ranked] = field(default_factory=list)
    """The effects that gain most at first, each alone."""
    runs: list[RunLeft] = field(default_factory=list)
    """What each run is left with."""
    declared_covariance: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """Of the coefficients of the declared model, (degree + 1, degree + 1)."""

    @property
    def name(self) -> str:
        """That of the channel."""
        return self.channel.name

    @property
    def hidden(self) -> bool:
        """Whether the digits hide what is as large as matters: nothing that is seen is beyond them.

        What is left may be theirs alone then, or something that is missing; nobody could tell, not even
        where nothing is left, as a bias that stays within a step is not read at all.
        """
        channel, test = self.channel, self.test_after
        if self.unexplained or not channel.coarse or np.isinf(channel.blind):
            return False
        left = np.nan if test is None else test.left if self.claims else test.rms
        return not left >= MATERIAL * channel.limit

    def curve(self) -> list[tuple[float, float, float]]:
        """Return temperature, bias and its sigma at both ends and the middle of what training covered."""
        declared = self.channel.declared
        at = declared.middle_degc + declared.half_span_degc * np.array([-1.0, 0.0, 1.0])
        columns = declared.columns(at, len(self.after.declared))
        values = columns @ self.after.declared
        spread = np.sqrt(np.einsum("ij,jk,ik->i", columns, self.declared_covariance, columns))
        return list(zip(at.tolist(), values.tolist(), spread.tolist(), strict=True))


def settle(channel: Channel, found: Search) -> ChannelVerdict:
    """Return what is claimed of a channel."""
    verdict = _settled(channel, found)
    _add_looks(verdict, found)
    return verdict


def _add_looks(verdict: ChannelVerdict, found: Search) -> None:
    """Add what a person looks at beside the verdict: ranking, runs, and how well the parameters are known."""
    channel, claims = verdict.channel, verdict.claims
    tests = verdict.test_before, verdict.test_after
    both = None if tests[0] is None or tests[1] is None else (tests[0], tests[1])
    verdict.ranking = ranking(channel, found)
    verdict.runs = runs_left(channel, verdict.before, verdict.after, both)
    known = [one for one in found.findings if one.known]
    model = [*known, *(claim.finding for claim in claims)]
    spread = sigmas(found.channel, found.likelihood, [one.candidate for one in model])
    verdict.declared_covariance = spread.declared
    for claim, parts in zip(claims, spread.parts[len(known) :], strict=True):
        claim.sigmas = parts
        if channel.test and any(part.carries for part in claim.parts):
            lesser = _fit(channel, _others(model, claim.finding))
            claim.test_gain = evidence_of_test(channel, verdict.after, lesser)


def _settled(channel: Channel, found: Search) -> ChannelVerdict:
    """Return what is claimed after the runners-up of what the test refutes have had their turn.

    A runner-up has seen the test refute another, so it has to explain in the test, too, what it claims.
    """
    verdict = judge(channel, found, [])
    while verdict.left_out and not found.many_events:
        refuted = [item["name"] for item in verdict.left_out]
        kept = [finding for finding in found.findings if finding.known or finding.name not in refuted]
        if not found.resume(kept, refuted):
            break
        further = judge(channel, found, verdict.left_out)
        verdict.turns = further.turns
        if not _shown(further) or not _better(further, verdict):
            break
        settled = len(further.left_out) == len(verdict.left_out)
        verdict = further
        if settled:
            break
    return verdict


def _better(one: ChannelVerdict, other: ChannelVerdict) -> bool:
    """Tell whether a verdict leaves less of the test than another."""
    left, before = one.test_after, other.test_after
    if left is None or before is None:
        return False
    return left.rms < before.rms or left.estimated_rms < before.estimated_rms


def _shown(verdict: ChannelVerdict) -> bool:
    """Tell whether there is a test and it shows what training does."""
    before, after = verdict.test_before, verdict.test_after
    return before is not None and after is not None and _shows(before, after, verdict.channel.floor.sd)


def _shows(before: TestScore, after: TestScore, floor: float) -> bool:
    """Tell whether a test, too, shows what training does; one that cannot be scored does not.

    What is estimated in the test counts only where nothing is left: a level and a jump take away some of
    whatever is slow.
    """
    return np.isfinite(after.rms) and (after.left < CLEAN * floor or explains(before.rms, after.rms, floor))


@dataclass(frozen=True, slots=True)
class _Kept:
    """The findings that stay, the model with them, why no others do, and those that the test refutes."""

    findings: list[Finding]
    after: Fit
    remark: str
    refuted: list[dict[str, Any]]

    @property
    def claims(self) -> bool:
        """Whether any of them is not of a model that was given."""
        return any(not one.known for one in self.findings)


def judge(channel: Channel, found: Search, left_out: Sequence[dict[str, Any]]) -> ChannelVerdict:
    """Return what is claimed of a channel, and what is not and why."""
    shape = replace(channel.declared, degree=found.channel.declared.degree)
    channel = replace(channel, declared=shape, kept=found.channel.kept)
    given = fit_given(channel)
    floor = channel.limit  # what the digits alone make of a smooth bias is no structure
    kept = _kept(channel, found, given, floor)
    after, claims = kept.after, kept.claims
    scores = _scores(channel, given, after)
    predicts = not after.parts or any(part.carries for part in after.parts)
    if scores is not None:
        # Jumps of the test itself may make the prediction worse, whatever else was found.
        predicts &= not scores[1].rms > scores[0].rms
        if not predicts and not (goes_on(channel, after) and scores[1].rms < scores[0].rms):
            # The declared model then predicts as it did, and is what the model file has.
            scores[1].rms = scores[0].rms
    verdict = ChannelVerdict(
        channel=channel,
        before=given,
        after=after,
        test_before=None if scores is None else scores[0],
        test_after=None if scores is None else scores[1],
        claims=_claims(channel, given, after, kept.findings),
        unexplained=found.many_events
        or after.train_rms >= CLEAN * floor
        or (claims and scores is not None and scores[1].left >= CLEAN * floor),
        summary="",
        explained=explained_share(given.train_rms, after.train_rms, floor) if claims else 0.0,
        noise=found.null()[1],
        left_out=[*left_out, *kept.refuted],
        remark=kept.remark,
        predicts=predicts,
        slow=SlowNoise.of(found),
        refit=_refit(channel, found, kept.findings) if after is not given and predicts else [],
        turns=_turns(channel, found, given),
    )
    verdict.questions = questions(channel, found, kept.findings, verdict.unexplained)
    verdict.summary = "; ".join([*(fault.text for fault in channel.faults), summary(verdict)])
    return verdict


def _kept(channel: Channel, found: Search, given: Fit, floor: float) -> _Kept:
    """Return what of the findings stays: what training or the test proves, and the test does not refute."""
    # A jump that is too small to matter beside the rest is not told from the steps of a walk.
    lasting = [one for one in found.findings if one.candidate.scope != "event"]
    small = found.many_events or _fit(channel, lasting).train_rms < MATERIAL * channel.floor.sd
    findings = lasting if small else list(found.findings)
    refit = [one for one in findings if one.known]
    before = _fit(channel, refit) if found.refit else given
    stay, refuted = _not_worse(channel, findings)
    kept = _Kept(stay, _fit(channel, stay), "", refuted)
    why = "there is more than one jump in a run" if found.many_events else ""
    if not why and kept.claims:
        why = _too_little(given, kept.after, _scores(channel, given, kept.after), floor)
    if why:
        best = max(found.findings, key=lambda finding: finding.gain)
        why = f"the best of the known effects is {best.name}, but {why}"
    if why or not kept.claims:
        kept = _Kept(refit, before, why, refuted)
        if not found.many_events and before.train_rms >= CLEAN * floor:
            one = proven_by_test(channel, found, before, refit)
            if one is not None:
                both = [*refit, one]
                kept = _Kept(both, _fit(channel, both), BY_TEST, refuted)
    scores = _scores(channel, given, kept.after)
    if scores is not None and kept.claims and not np.isfinite(scores[1].rms):
        nothing = {"test_rms_with": float("nan"), "test_rms_without": float("nan")}
        refuted += [{"name": one.name, **nothing} for one in kept.findings if not one.known]
        kept = _Kept(refit, before, kept.remark, refuted)
    return kept


def _too_little(given: Fit, after: Fit, scores: tuple[TestScore, TestScore] | None, floor: float) -> str:
    """Say what is too little of training, or of the test, to name anything; empty where it is enough."""
    if not explains(given.train_rms, after.train_rms, floor):
        return _little_of("the training", given.train_rms, after.train_rms, floor)
    if scores is None or not np.isfinite(scores[1].rms) or _shows(*scores, floor):
        return ""
    return _little_of("the test", scores[0].rms, scores[1].rms, floor)


def _little_of(what: str, before: float, after: float, floor: float) -> str:
    share = max(0.0, explained_share(before, after, floor))
    left = f"{before / floor:.1f} white floors become {after / floor:.1f}"
    return f"it explains only {share:.0%} of {what}: {left}"


def _refit(channel: Channel, found: Search, kept: Sequence[Finding]) -> list[str]:
    """Return what is fitted anew of a model that was given."""
    if channel.known is None:
        return []
    curve = ["curve"] if found.channel.declared.degree else []
    return [*curve, *(one.name for one in kept if one.known)]


def _turns(channel: Channel, found: Search, given: Fit) -> list[Step]:
    """Return the turns of the loop with what is left after each, in training and test."""
    steps = [Step("what was assumed", ()), *found.turns]
    models = [given, *(fit(channel, step.model) for step in found.turns)]
    tests = [score(channel, model).rms if channel.test else float("nan") for model in models]
    return [
        replace(step, train_rms=model.train_rms, test_rms=test)
        for step, model, test in zip(steps, models, tests, strict=True)
    ]


def _fit(channel: Channel, findings: Sequence[Finding]) -> Fit:
    return fit(channel, [finding.candidate for finding in findings])


def _scores(channel: Channel, before: Fit, after: Fit) -> tuple[TestScore, TestScore] | None:
    """Return the scores of two models over the blocks that count for the second; None without a test."""
    if not channel.test:
        return None
    return score(channel, before, like=after), score(channel, after)


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


def _others(kept: Sequence[Finding], finding: Finding) -> list[Finding]:
    return [other for other in kept if other is not finding]


def _trial(
    channel: Channel, kept: Sequence[Finding], finding: Finding, everything: Fit
) -> tuple[float, dict[str, Any]]:
    """Return by how much the test confirms a finding (negative when it refutes it), and the numbers."""
    carries = any(part.carries for part in everything.parts if part.effect.label == finding.name)
    with_it = score(channel, everything)
    without = score(channel, _fit(channel, _others(kept, finding)), like=everything)
    count = [a & b for a, b in zip(with_it.counted, without.counted, strict=True)]
    # What does not carry over is estimated in the test with both, and predicts nothing that could be refuted.
    rms = mean_rms(with_it.estimated, count), mean_rms(without.estimated, count)
    record = {"name": finding.name, "test_rms_with": rms[0], "test_rms_without": rms[1]}
    return (rms[1] ** 2 - rms[0] ** 2 if carries and np.isfinite(rms).all() else 0.0), record


def _claims(channel: Channel, before: Fit, after: Fit, kept: Sequence[Finding]) -> list[Claim]:
    claims, parts = [], iter(after.parts[len(channel.kept) :])
    for finding in kept:
        own = list(islice(parts, len(finding.candidate.parts)))
        if finding.known:
            continue
        alone = _fit(channel, [finding])
        share = explained_share(before.train_rms, alone.train_rms, channel.floor.sd)
        test_alone = score(channel, alone).rms if channel.test else float("nan")
        claims.append(Claim(finding, own, share, test_alone))
    return claims


def summary(verdict: ChannelVerdict) -> str:
    """Return one sentence on a channel."""
    floor = verdict.channel.floor.sd
    before, after = verdict.before.train_rms / floor, verdict.after.train_rms / floor
    if np.isinf(verdict.channel.blind):
        return "no effect is looked for beside that"
    if not verdict.claims and verdict.refit:
        return _refitted(verdict)
    if not verdict.claims:
        worse = "".join(f"; {item['name']} was found but {_why(item)}" for item in verdict.left_out)
        what = f" ({verdict.remark})" if verdict.remark else ""
        if verdict.unexplained:
            return (
                f"unexplained: the declared model leaves {before:.1f} white floors, structure or slow noise"
                f" that none of the known effects explains{what}{worse}"
            )
        return f"{_nothing(verdict, before)}{what}{worse}"
    names, named = [], set[str]()
    for claim in verdict.claims:
        alike = claim.finding.alike or [claim.finding.name]
        said = " or ".join(f"another {name}" if name in named else name for name in alike)
        asked = "; ".join(dict.fromkeys(separated_by(alike[0], other) for other in alike[1:]))
        names.append(f"{said} (not told apart on this data; to separate: {asked})" if asked else said)
        named.update(alike)
    text = f"{', and '.join(names)}: {before:.1f} white floors become {after:.2f} in training"
    text += _tested(verdict)
    if verdict.remark:
        text += f"; {verdict.remark}"
    if before < MATERIAL:
        text += "; present, too small to matter"
    if verdict.unexplained:
        text += "; the remainder is unexplained"
    if verdict.hidden:
        text += f"; {TOO_FEW} whether there is more: {_of_digits(verdict.channel)}"
    return text


def _why(item: dict[str, Any]) -> str:
    """Say why something that was found is left out."""
    unproven = np.isnan(item["test_rms_with"])
    return "no block of the test can be scored with it" if unproven else "made the test worse"


def _refitted(verdict: ChannelVerdict) -> str:
    """Say what was fitted anew of the model that was given, where that is all."""
    floor = verdict.channel.floor.sd
    before, after = (one.train_rms / floor for one in (verdict.before, verdict.after))
    text = f"{', '.join(verdict.refit)} fitted anew: {before:.1f} white floors become {after:.2f} in training"
    return text + _tested(verdict) + ("; the remainder is unexplained" if verdict.unexplained else "")


def _of_digits(channel: Channel) -> str:
    return f"steps as coarse may make up to {channel.blind / channel.floor.sd:.1f} of a smooth bias"


def _nothing(verdict: ChannelVerdict, before: float) -> str:
    """Say what a declared model leaves to which nothing was added; only the test can say that it is all."""
    test, floor = verdict.test_before, verdict.channel.floor.sd
    left = f"the declared model leaves {before:.2f} white floors in training"
    if verdict.hidden:
        tested = "" if test is None or not np.isfinite(test.rms) else f", {test.rms / floor:.2f} in the test"
        return f"{TOO_FEW}: {left}{tested}; {_of_digits(verdict.channel)}"
    if test is None:
        return f"no effect is proven: {left}; without a test that is no proof that nothing is missing"
    if not np.isfinite(test.rms):
        return f"no effect is proven: {left}; the test has too little inside what training covered"
    where = f"{test.rms / floor:.2f} in the test{_covered(test)}"
    if test.rms < MATERIAL * floor:
        return f"nothing is missing: {left}, {where}"
    return f"no effect is proven: {left}, {where}; slow noise may do that, or something is missing"


def _tested(verdict: ChannelVerdict) -> str:
    """Say what became of the test with the effects that are claimed."""
    before, after = verdict.test_before, verdict.test_after
    if before is None or after is None:
        return "; without a test nothing proves it"
    if not np.isfinite(after.rms):
        return "; no proof: the test has too little inside what training covered"
    predicted = any(part.carries for part in verdict.after.parts) and verdict.predicts
    predicted |= goes_on(verdict.channel, verdict.after) and after.rms < before.rms
    value, how = (after.rms, "predicted") if predicted else (after.estimated_rms, "estimated in the test")
    floor = verdict.channel.floor.sd
    return f", {before.rms / floor:.1f} become {value / floor:.2f} in the test{_covered(after)} ({how})"


def _covered(test: TestScore) -> str:
    if test.coverage == 1.0:
        return ""
    return f", over the {test.coverage:.0%} of it that are inside what training covered"
