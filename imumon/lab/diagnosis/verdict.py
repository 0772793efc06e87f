"""The verdict on a channel: one table of named predicates, evaluated top down, and its words."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import PROVEN, Finding
from imumon.lab.diagnosis.fit import MATERIAL, Fit, FittedPart, PartSigma, TestScore, goes_on
from imumon.lab.diagnosis.likelihood import WALK_S
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
    sigmas: list[PartSigma] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class SlowNoise:
    """The noise that is likeliest beside what was found, as `report.json` has it.

    Parameters
    ----------
    flicker, random_walk : float
        r and q of the likelihood, variances over that of the white noise.
    flicker_rms, random_walk_per_sqrt_s : float
        The same in the unit of the channel, over the correlation times of the likelihood.
    heavy_tails : float
        Gain in BIC of innovations with heavy tails.
    """

    flicker: float
    random_walk: float
    flicker_rms: float
    random_walk_per_sqrt_s: float
    heavy_tails: float

    @classmethod
    def of(cls, found: Search) -> Self:
        """Return the noise of what was found."""
        flicker, walk = noise = found.fitted(found.model)[1]
        of = found.channel.values, found.channel.design(found.model), noise
        sd, tails = found.likelihood.scale(*of), found.likelihood.tails(*of)
        return cls(flicker, walk, float(np.sqrt(flicker) * sd), float(np.sqrt(walk / WALK_S) * sd), tails)

    @property
    def jumps(self) -> bool:
        """Whether it jumps or comes in bursts, as no Gaussian noise does."""
        return self.heavy_tails > PROVEN


@dataclass(slots=True)
class ChannelVerdict:
    """What is claimed of a channel, and how well it does."""

    channel: Channel
    before: Fit
    after: Fit
    """Declared and extended model."""
    test_before: TestScore
    test_after: TestScore
    claims: list[Claim]
    unexplained: bool
    """More than 1.8 floors are left in training or, beside what is claimed, in the test."""
    explained: float
    remark: str
    left_out: Sequence[dict[str, Any]]
    """What was found but made the test worse."""
    predicts: bool
    """Whether the extended model goes into the model file; else the declared one does: nothing of what is
    claimed carries over, or the levels of the test make the prediction worse with it."""
    slow: SlowNoise
    questions: list[list[dict[str, Any]]]
    refit: list[str]
    """What was fitted anew of the present model, its curve first; empty when that stays as it is."""
    turns: list[dict[str, Any]]
    """Of `report.json`: what was done in each stage of the search, and what was left."""
    ranking: list[dict[str, Any]]
    runs: list[dict[str, Any]]
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

    def curve(self) -> list[tuple[float, float, float]]:
        """Return temperature, bias and its sigma at both ends and the middle of what training covered."""
        declared = self.channel.declared
        at = declared.middle_degc + declared.half_span_degc * np.array([-1.0, 0.0, 1.0])
        columns = declared.columns(at, len(self.after.declared))
        values = columns @ self.after.declared
        spread = np.sqrt(np.einsum("ij,jk,ik->i", columns, self.declared_covariance, columns))
        return list(zip(at.tolist(), values.tolist(), spread.tolist(), strict=True))


def _details(verdict: ChannelVerdict) -> Iterator[str]:
    """Yield the numbers of a verdict, then its reasons."""
    yield _left_in_training(verdict)
    if verdict.unexplained:
        yield "what is left is structure or slow noise that no known effect explains"
    if verdict.remark:
        yield verdict.remark
    for item in verdict.left_out:
        yield f"{item['name']} was found but made the test worse"
    pairs = [(one.finding.alike[0], other) for one in verdict.claims for other in one.finding.alike[1:]]
    if pairs:
        yield f"to separate: {'; '.join(dict.fromkeys(separated_by(*pair) for pair in pairs))}"
    if verdict.claims and verdict.before.train_rms < MATERIAL * verdict.channel.floor.sd:
        yield "present, too small to matter"
    if verdict.row.state == "not proven" and verdict.channel.test:
        yield "slow noise may do that, or something is missing"
    if verdict.hidden:
        share = verdict.channel.blind / verdict.channel.floor.sd
        yield f"steps as coarse may make up to {share:.1f} of a smooth bias"


def _left_in_training(verdict: ChannelVerdict) -> str:
    floor = verdict.channel.floor.sd
    before, after = (one.train_rms / floor for one in (verdict.before, verdict.after))
    if not verdict.claims and not verdict.refit:
        return f"the declared model leaves {before:.2f} white floors in training{_left_in_test(verdict)}"
    anew = "" if verdict.claims else f"{', '.join(verdict.refit)} fitted anew, "
    return f"{anew}{before:.1f} white floors become {after:.2f} in training{_left_in_test(verdict)}"


def _left_in_test(verdict: ChannelVerdict) -> str:
    """Return what is left of the test; only that says whether it is all."""
    before, after, floor = verdict.test_before, verdict.test_after, verdict.channel.floor.sd
    if not verdict.channel.test:
        return "; without a test that is no proof"
    if not np.isfinite(after.rms):
        return "; no proof: the test has too little inside what training covered"
    covered = "" if after.coverage == 1.0 else f", over the {after.coverage:.0%} of it that training covered"
    if not verdict.claims and not verdict.refit:
        return f", {before.rms / floor:.2f} in the test{covered}"
    predicted = verdict.predicts and verdict.after.carries
    predicted |= goes_on(verdict.channel, verdict.after) and after.rms < before.rms
    value, how = (after.rms, "predicted") if predicted else (after.estimated_rms, "estimated in the test")
    return f", {before.rms / floor:.1f} become {value / floor:.2f} in the test{covered} ({how})"
