"""From what the search found to what is claimed: gate, test, materiality, and a sentence for each channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks, WhiteFloor
from imumon.diagnosis.candidates import Candidate, Pool
from imumon.diagnosis.fitting import Declared, Fit, TestScore, fit, mean_rms, score
from imumon.diagnosis.selection import Finding, Outcome
from imumon.effects.library import EFFECTS, separated_by

CLEAN = 1.8
"""Residual in white floors below which nothing is missing; slow noise of the same size as the white is
allowed."""
EXPLAINED = 0.6
"""Share of the excess over the white floor that has to be explained before anything is named."""
CONFIRMED = 0.3
MATERIAL = 1.3
"""With a declared model that leaves less than so many floors, what is missing is too small to matter."""


@dataclass(slots=True)
class Claim:
    """An effect that is claimed, with its evidence."""

    finding: Finding
    fitted: Fit
    explained: float
    test_alone: float


@dataclass(slots=True)
class ChannelVerdict:
    """What is said of a channel.

    Parameters
    ----------
    before, after : Fit
        Declared and extended model.
    test_before, test_after : TestScore or None
        None without a test.
    left_out : list of dict
        What was found but made the test worse.
    foretells : bool
        Whether the extended model goes into the model file; else the declared one does: nothing of what is
        claimed carries over, or the levels of the test make the prediction worse with it.
    """

    name: str
    unit: str
    temperature: str
    floor: WhiteFloor
    declared: Declared
    before: Fit
    after: Fit
    test_before: TestScore | None
    test_after: TestScore | None
    claims: list[Claim]
    unexplained: bool
    summary: str
    explained: float
    noise: tuple[float, float]
    left_out: list[dict[str, Any]] = field(default_factory=list)
    remark: str = ""
    foretells: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A channel with its data: what `judge` needs."""

    name: str
    unit: str
    temperature: str
    floor: WhiteFloor
    declared: Declared
    train: Sequence[RunBlocks]
    test: Sequence[RunBlocks]
    pool: Pool
    inside: tuple[float, float]

    @property
    def values(self) -> FloatArray:
        """Block means over all training runs."""
        return np.concatenate([run.mean[self.name] for run in self.train])

    def fitted(self, found: Sequence[Candidate]) -> Fit:
        """Return the declared model with these candidates, fitted."""
        return fit(self.train, self.temperature, self.values, self.declared, found, self.pool)

    def scored(self, model: Fit, like: Fit) -> TestScore | None:
        """Return the score of a model in the test over the blocks that count for `like`; None without a
        test."""
        if not self.test:
            return None
        from imumon.diagnosis.fitting import settled

        mask = [settled(run, self.temperature, like) for run in self.test]
        return score(self.test, self.name, self.temperature, self.declared, model, self.inside, mask)


def explained_share(before: float, after: float, floor: float) -> float:
    """Return which share of the excess of the mean square over the white floor is explained."""
    excess = before**2 - floor**2
    return 1.0 - (after**2 - floor**2) / excess if excess > 0 else 0.0


def judge(case: Case, outcome: Outcome) -> ChannelVerdict:
    """Return what is claimed of a channel, and what is not and why."""
    findings = [
        finding
        for finding in outcome.findings
        if not (outcome.many_jumps and EFFECTS[finding.name].scope == "event")
    ]
    before = case.fitted([])
    kept, left_out = _not_worse(case, findings)
    after = case.fitted([finding.candidate for finding in kept])
    floor = case.floor.sd
    share = explained_share(before.train_rms, after.train_rms, floor)
    remark = ""
    passes = after.train_rms < CLEAN * floor or share >= EXPLAINED
    if outcome.many_jumps or (kept and not passes):
        best = max(outcome.findings, key=lambda finding: finding.gain)
        why = (
            "there is more than one jump in a run" if outcome.many_jumps else f"it explains only {share:.0%}"
        )
        remark = f"the best of the known effects is {best.name}, but {why}"
        kept, after = [], before
    score_after = case.scored(after, after)
    score_before = case.scored(before, after)
    foretells = not after.parts or any(part.carries for part in after.parts)
    if score_after is not None and score_before is not None:
        # Jumps of the test itself may make the prediction worse, whatever else was found.
        foretells &= not score_after.rms > score_before.rms
        if not foretells:
            # The declared model then predicts as it did, and is what the model file has.
            score_after.rms = score_before.rms
    unexplained = _unexplained(before, after, kept, floor, outcome)
    verdict = ChannelVerdict(
        name=case.name,
        unit=case.unit,
        temperature=case.temperature,
        floor=case.floor,
        declared=case.declared,
        before=before,
        after=after,
        test_before=score_before,
        test_after=score_after,
        claims=[_claim(case, before, kept, at) for at in range(len(kept))],
        unexplained=unexplained,
        summary="",
        explained=share if kept else 0.0,
        noise=outcome.noise,
        left_out=left_out,
        remark=remark,
        foretells=foretells,
    )
    verdict.summary = summary(verdict)
    return verdict


def _unexplained(before: Fit, after: Fit, kept: Sequence[Finding], floor: float, outcome: Outcome) -> bool:
    if outcome.many_jumps:
        return True
    return (after if kept else before).train_rms >= CLEAN * floor


def _not_worse(case: Case, findings: Sequence[Finding]) -> tuple[list[Finding], list[dict[str, Any]]]:
    """Return the findings without those that the test refutes, and what those did.

    A finding is refuted when the test is worse with it.  So is one that carries over when the test gets
    better by less than `CONFIRMED` of what the finding says it should: the mean square of what it adds to
    the prediction.  At last nothing stays that makes the prediction as a whole worse.
    """
    kept = list(findings)
    left_out: list[dict[str, Any]] = []
    while kept and case.test:
        everything = case.fitted([finding.candidate for finding in kept])
        trials = [_trial(case, kept, finding, everything) for finding in kept]
        worst = min(range(len(kept)), key=lambda at: trials[at][0])
        if not trials[worst][0] < 0:
            break
        left_out.append(trials[worst][1])
        kept.pop(worst)
    while kept and (record := _worst_foretold(case, kept)) is not None:
        left_out.append(record)
        kept = [finding for finding in kept if finding.name != record["name"]]
    return kept, left_out


def _worst_foretold(case: Case, kept: Sequence[Finding]) -> dict[str, Any] | None:
    """Return the numbers of the finding without which the prediction is best, if with all it is worse than
    the declared one; else None."""
    everything = case.fitted([finding.candidate for finding in kept])
    before, after = case.scored(case.fitted([]), everything), case.scored(everything, everything)
    if before is None or after is None or not after.rms > before.rms:
        return None
    if not all(part.carries for part in everything.parts):
        return None  # the level of the test is another anyway: following it has shown what they are worth
    without = {}
    for finding in kept:
        others = case.fitted([other.candidate for other in kept if other is not finding])
        scored = case.scored(others, everything)
        assert scored is not None
        without[finding.name] = scored.rms
    name = min(without, key=lambda one: without[one])
    return {"name": name, "test_rms_with": after.rms, "test_rms_without": without[name]}


def _trial(
    case: Case, kept: Sequence[Finding], finding: Finding, everything: Fit
) -> tuple[float, dict[str, Any]]:
    """Return by how much the test confirms a finding (negative when it refutes it), and the numbers."""
    others = case.fitted([other.candidate for other in kept if other is not finding])
    carries = any(part.carries for part in everything.parts if part.effect.name == finding.name)
    with_it, without = case.scored(everything, everything), case.scored(others, everything)
    assert with_it is not None
    assert without is not None
    count = [a & b for a, b in zip(with_it.quiet, without.quiet, strict=True)]
    # Of what can be followed only the part that was not yet is in the way of judging the others.
    left = with_it.tracked, without.tracked
    if carries and not np.isfinite(mean_rms(left[0], count)):
        # Too near to jumps throughout: then what was foretold has to do.
        left, count = (with_it.residual, without.residual), with_it.counted
    rms = mean_rms(left[0], count), mean_rms(left[1], count)
    record = {"name": finding.name, "test_rms_with": rms[0], "test_rms_without": rms[1]}
    if not np.isfinite(rms).all():
        return 0.0, record
    better = rms[1] ** 2 - rms[0] ** 2
    if not carries:
        return better, record
    change = [a - b for a, b in zip(*left, strict=True)]
    return better - CONFIRMED * mean_rms(change, count) ** 2, record


def _claim(case: Case, before: Fit, kept: Sequence[Finding], at: int) -> Claim:
    finding = kept[at]
    alone = case.fitted([finding.candidate])
    scored = case.scored(alone, alone)
    return Claim(
        finding=finding,
        fitted=alone,
        explained=explained_share(before.train_rms, alone.train_rms, case.floor.sd),
        test_alone=float("nan") if scored is None else scored.rms,
    )


def summary(verdict: ChannelVerdict) -> str:
    """Return one sentence on a channel."""
    floor = verdict.floor.sd
    before, after = verdict.before.train_rms / floor, verdict.after.train_rms / floor
    if not verdict.claims:
        worse = "".join(f"; {item['name']} was found but made the test worse" for item in verdict.left_out)
        if verdict.unexplained:
            what = f" ({verdict.remark})" if verdict.remark else ""
            return (
                f"unexplained: the declared model leaves {before:.1f} white floors, structure or slow noise"
                f" that none of the known effects explains{what}{worse}"
            )
        return f"nothing is missing: {before:.2f} white floors are left by the declared model{worse}"
    names = []
    for claim in verdict.claims:
        alike = claim.finding.alike
        if alike:
            asked = "; ".join(dict.fromkeys(separated_by(alike[0], other) for other in alike[1:]))
            names.append(f"{' or '.join(alike)} (not told apart on this data; to separate: {asked})")
        else:
            names.append(claim.finding.name)
    text = f"{', and '.join(names)}: {before:.1f} white floors become {after:.2f} in training"
    test = verdict.test_after, verdict.test_before
    if test[0] is not None and test[1] is not None and np.isfinite(test[0].rms):
        carried = verdict.foretells and any(part.carries for part in verdict.after.parts)
        score_after = test[0].rms if carried else test[0].tracked_rms
        how = "predicted" if carried else "tracked"
        if np.isfinite(score_after):
            text += f", {test[1].rms / floor:.1f} become {score_after / floor:.2f} in the test ({how})"
        else:
            text += "; the test has too little that is not near to a jump to be followed"
    if before < MATERIAL:
        text += "; present, too small to matter"
    if verdict.unexplained:
        text += "; the remainder is unexplained"
    return text


def claims_table(verdicts: Sequence[ChannelVerdict]) -> Mapping[str, list[str]]:
    """Return the claimed names of each channel."""
    return {verdict.name: [claim.finding.name for claim in verdict.claims] for verdict in verdicts}
