"""The verdict on a channel, by what is claimed: the first row of `VERDICTS` that holds.

Predicates of `VERDICTS` are properties of `ChannelVerdict`; what is left is by the model with the claims.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by

from .candidates import Channel, Finding
from .claims import CLEAN_RESIDUAL, SMALL_RESIDUAL, Hypothesis, choose_claims
from .fit import FittedPart, PartSigma, Score, sigmas
from .search import AxisSearch, Note


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
# What is added to the sentence of what is claimed, where a predicate holds.
BESIDE_CLAIMS = {
    "not_told_apart": ", not told apart",
    "by_test": ", chosen by the test alone, so this test is no independent proof",
    "unexplained": ", and more that is unexplained",
    "hidden": "; too few digits to tell whether there is more",
}


class Claim(NamedTuple):
    """An effect that is claimed, with its parts, and their sigmas, as fitted beside the other claims."""

    finding: Finding
    parts: list[FittedPart]
    sigmas: list[PartSigma]


@dataclass(kw_only=True)
class ChannelVerdict(Hypothesis):
    """What is claimed of a channel, and how well it does."""

    search: AxisSearch
    claims: list[Claim]
    left_out: list[Note]  # what was found but made the test worse
    # Of the declared coefficients, (degree + 1, degree + 1), as fitted in the blocks of the search.
    declared_covariance: FloatArray

    @property
    def name(self) -> str:
        """Name of the channel."""
        return self.channel.name

    @property
    def predicts(self) -> bool:
        """Whether `after` goes into the model file; else `before` does."""
        # Jumps of the test itself may make the prediction worse, whatever else was found.
        worse = self.test_after.rms > self.test_before.rms  # False without a test: NaN
        return not worse and (not self.after.parts or self.after.carries_over)

    @property
    def goes_on(self) -> bool:
        """Whether the test continues a training run, and is predicted better by what only that run has."""
        return self.test_after.continues_training and self.test_after.rms < self.test_before.rms

    @property
    def prediction(self) -> Score:
        """The score that counts as the prediction of the test: of `after` where that predicts it."""
        return self.test_after if self.predicts or self.goes_on else self.test_before

    @property
    def test_rms(self) -> float:
        """rms that is left of the test, predicted, or, of claims, estimated if less; NaN without a test."""
        predicted, estimated = self.prediction.rms, self.test_after.estimated_rms
        return float(np.fmin(predicted, estimated)) if self.claims else predicted

    @property
    def refit(self) -> list[str]:
        """What was fitted anew of the present model, its curve first; empty where it stays."""
        if self.channel.present_effects is None or not self.predicts:
            return []
        effects = [finding.name for finding in self.findings if finding.of_present_model]
        return ["curve", *effects] if self.channel.degree else effects

    @property
    def unexplained(self) -> bool:
        """1.8 total floors or more are left in training, or in the test after the named effects; or a
        session has two jumps."""
        # Without a test its rms is NaN, and `max` returns the first.
        left = max(self.after.train_rms, self.test_rms if self.claims else 0.0)
        return self.search.repeated_event or left >= SMALL_RESIDUAL * self.channel.total_floor

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
        """The resolution (quantization) of the samples may make as much as is left."""
        # Even where nothing is left: a bias that stays within a step is not read at all.
        if self.unexplained or not self.channel.coarse or self.faulty:
            return False
        # True of NaN, too: without a test.
        return not self.test_rms >= CLEAN_RESIDUAL * self.channel.total_floor

    @property
    def clean(self) -> bool:
        """Less than 1.3 white floors are left in the test."""
        return self.prediction.rms < CLEAN_RESIDUAL * self.channel.floor.sd

    @property
    def shifted(self) -> bool:
        """Less than 1.8 total floors are left of training, and of the test but for a constant of each run."""
        small, score = SMALL_RESIDUAL * self.channel.total_floor, self.prediction
        runs = [r[c] for r, c in zip(score.predicted_residual, score.counts, strict=True) if c.any()]
        return score.rms >= small > max(self.after.train_rms, *(float(run.std()) for run in runs))

    @property
    def row(self) -> Row:
        """The verdict: the first row of the table whose predicate holds."""
        return next(row for row in VERDICTS if not row.predicate or getattr(self, row.predicate))

    @property
    def in_short(self) -> str:
        """The verdict in few words; of claims A and B, B an alternative to A: "(A or another B) and B"."""
        findings = [claim.finding for claim in self.claims]
        another = {finding.name: f"another {finding.name}" for finding in findings}
        sets = [[one.name, *(another.get(name, name) for name in one.alternatives)] for one in findings]
        each = [" or ".join(names) for names in sets]
        in_brackets = [f"({one})" if " or " in one and len(each) > 1 else one for one in each]
        text = self.row.sentence.format(names=" and ".join(dict.fromkeys(in_brackets)))
        if self.row.predicate == "claimed":
            text += "".join(more for predicate, more in BESIDE_CLAIMS.items() if getattr(self, predicate))
        return text

    @property
    def summary(self) -> str:
        """The verdict with its numbers and reasons."""
        if self.faulty:
            return "; ".join([*self.channel.faults, self.in_short])
        reasons = [_numbers(self), *filter(None, [self.remark])]
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
    floor, score = verdict.channel.floor.sd, verdict.prediction
    train_before, train_after = verdict.before.train_rms / floor, verdict.after.train_rms / floor
    changed = verdict.claims or verdict.refit
    if changed:
        anew = "" if verdict.claims else f"{', '.join(verdict.refit)} fitted anew, "
        text = f"{anew}{train_before:.1f} white floors become {train_after:.2f} in training"
    else:
        text = f"the declared model leaves {train_before:.2f} white floors in training"
    if not verdict.channel.test:
        return f"{text}; without a test that is no proof"
    if not np.isfinite(score.rms):
        return f"{text}; no proof: the test has too little inside what training covered"
    covered = "" if score.coverage == 1.0 else f", over the {score.coverage:.0%} of it that training covered"
    before = verdict.test_before.rms / floor
    if not changed:
        return f"{text}, {before:.2f} in the test{covered}"
    if verdict.goes_on or (verdict.predicts and verdict.after.carries_over):
        after, how = score.rms, "predicted"
    else:
        after, how = verdict.test_after.estimated_rms, "estimated in the test"
    return f"{text}, {before:.1f} become {after / floor:.2f} in the test{covered} ({how})"


def decide(search: AxisSearch, channel: Channel) -> ChannelVerdict:
    """Return the verdict on a channel, in the blocks that are scored, by what the search found in it."""
    claimed, left_out = choose_claims(channel, search)
    model = [finding.candidate for finding in claimed.findings]
    # In the blocks of the search on purpose: its likelihood knows the noise.
    covariance, sigmas_of_each = sigmas(search.channel, search.survey, search.likelihood, model)
    parts = iter(claimed.after.parts[len(channel.fixed_effects) :])  # those of one finding after another
    parts_of_each = [[next(parts) for _ in candidate.parts] for candidate in model]
    each = map(Claim, claimed.findings, parts_of_each, sigmas_of_each)
    return ChannelVerdict(
        **vars(claimed),
        search=search,
        claims=[claim for claim in each if not claim.finding.of_present_model],
        left_out=left_out,
        declared_covariance=covariance,
    )
