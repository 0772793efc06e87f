"""The verdict on a channel: one table of named predicates, evaluated top down, and its words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding
from imumon.lab.diagnosis.fit import MATERIAL, Fit, FittedPart, PartSigma, TestScore, goes_on
from imumon.lab.diagnosis.search import Search

State = Literal["named", "unexplained", "nothing missing", "too few digits", "not proven", "faulty"]


class Row(NamedTuple):
    """A verdict: the first row of the table whose predicate holds."""

    predicate: str
    """Of `ChannelVerdict`; empty where it always holds."""
    state: State
    """Which kind of verdict it is, in `report.json`."""
    sentence: str
    """With the names of what is claimed."""


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
    """Declared and extended model."""
    test_before: TestScore
    test_after: TestScore
    findings: Sequence[Finding]
    """What is in the extended model."""
    claims: list[Claim]
    """Those of the findings that the present model has not."""
    unexplained: bool
    """More than 1.8 floors are left in training or, beside what is claimed, in the test."""
    explained: float
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

    # The predicates of the table, as the documentation defines them

    @property
    def claimed(self) -> bool:
        """Training proves effects, the test does not refute them, and of both 60 % is explained or less than
        1.8 floors are left; or the test alone proves one."""
        return bool(self.claims)

    @property
    def faulty(self) -> bool:
        """Faults of the samples hide any effect."""
        return bool(np.isinf(self.channel.blind))

    @property
    def by_test(self) -> bool:
        """An effect that makes training likelier explains 60 % of the test, where training proves nothing or
        leaves more than twice as much of it."""
        return any(claim.finding.by_test for claim in self.claims)

    @property
    def not_told_apart(self) -> bool:
        """Effects of other names fit as well."""
        return any(claim.finding.alike for claim in self.claims)

    @property
    def hidden(self) -> bool:
        """Steps of the samples may make as much as is left.

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
        text = self.in_short if self.faulty else f"{self.in_short}: {'; '.join(_details(self))}"
        return "; ".join([*(fault.text for fault in self.channel.faults), text])


def _details(verdict: ChannelVerdict) -> Iterator[str]:
    """Yield the numbers of a verdict, then its reasons."""
    yield _numbers(verdict)
    if verdict.remark:
        yield verdict.remark
    for item in verdict.left_out:
        yield f"{item['name']} was found but made the test worse"
    pairs = [(one.finding.name, other) for one in verdict.claims for other in one.finding.others]
    if pairs:
        yield f"to separate: {'; '.join(dict.fromkeys(separated_by(*pair) for pair in pairs))}"
    if verdict.hidden:
        share = verdict.channel.blind / verdict.channel.floor.sd
        yield f"steps as coarse may make up to {share:.1f} of a smooth bias"


def _numbers(verdict: ChannelVerdict) -> str:
    """Return what is left, in white floors, of training and of the test: only that says whether it is all."""
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
