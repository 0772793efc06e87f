"""What stands beside the verdict: how the effects rank, what is left of each run, what is open.

Each answer that is possible to an open question is a whole model, fitted to the training, so that the next
experiment can be tried on units that have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding, Scored, Table
from imumon.lab.diagnosis.fit import Fit, TestScore, fit, score_test
from imumon.lab.diagnosis.search import Search

MOST_RANKED = 6
"""Effects in the ranking of the report."""
NOTHING = "nothing"
"""The answer that there is slow noise and no effect; alone: is it noise, or something that the course of
the temperature makes?"""
MOST_ANSWERS = 2
"""Effects that are tried behind what is unexplained."""


@dataclass(frozen=True, slots=True)
class Ranked:
    """An effect alone beside the baseline: gain in BIC, and the rms that it leaves of training and of the
    test, by what it predicts of that; NaN without one."""

    name: str
    gain: float
    train_rms: float
    test_rms: float


@dataclass(frozen=True, slots=True)
class RunLeft:
    """What a run is left with before and after: rms, and the mean of what is left after; NaN where nothing
    counts."""

    name: str
    test: bool
    blocks: int
    before: float = float("nan")
    after: float = float("nan")
    mean: float = float("nan")

    @classmethod
    def of(cls, name: str, test: bool, before: FloatArray, after: FloatArray) -> Self:
        """Return that of a run with these residuals."""
        if not len(after):
            return cls(name, test, 0)
        first, last = (float(np.sqrt(np.mean(values**2))) for values in (before, after))
        return cls(name, test, len(after), first, last, float(after.mean()))


@dataclass(frozen=True, slots=True)
class Answer:
    """An effect that may be the one, or `NOTHING`, the model that has it, and whether that carries over."""

    name: str
    fit: Fit
    carries: bool = True


Question = list[Answer]
"""Which of these is it?"""


def ranking(channel: Channel, found: Search) -> list[Ranked]:
    """Return the effects that gain most, by what each does alone, whether or not any is named."""
    ranked = []
    for one in _leaders(found.tables[0] if found.tables else {})[:MOST_RANKED]:
        fitted = fit(channel, [one.candidate])
        ranked.append(Ranked(one.family, one.gain, fitted.train_rms, score_test(channel, fitted).rms))
    return ranked


def _leaders(table: Table) -> list[Scored]:
    """Return the best of each family, the best of all first."""
    return sorted(table.values(), key=lambda one: -one.gain)


def runs_left(channel: Channel, before: Fit, after: Fit, tests: tuple[TestScore, TestScore]) -> list[RunLeft]:
    """Return what each run of training and test is left with."""
    bounds = np.cumsum([len(run) for run in channel.train])[:-1]
    both = (np.split(one.train, bounds) for one in (before, after))
    rows = [RunLeft.of(run.name, False, *left) for run, *left in zip(channel.train, *both, strict=True)]
    both = (one.residual for one in tests)
    for run, use, *left in zip(channel.test, tests[1].counted, *both, strict=True):
        rows.append(RunLeft.of(run.name, True, *(values[use] for values in left)))
    return rows


def questions(channel: Channel, found: Search, kept: Sequence[Finding], unexplained: bool) -> list[Question]:
    """Return what is open in a channel in which these findings are claimed."""
    claimed, opened = [finding.candidate for finding in kept], list[Question]()
    for finding in kept:
        if finding.alike:
            beside = [other for other in claimed if other is not finding.candidate]
            either = [finding.candidate, *finding.others.values()]
            opened.append([_answer(channel, beside, one) for one in either])
    if unexplained and found.tables:
        tried = [one.candidate for one in _leaders(found.tables[-1]) if one.fit > 0.0]
        further = [one for one in tried if one not in claimed and _may_be_tried(one)][:MOST_ANSWERS]
        nothing = Answer(NOTHING, fit(channel, claimed))
        opened.append([nothing, *(_answer(channel, claimed, one) for one in further)])
    return opened


def _may_be_tried(candidate: Candidate) -> bool:
    """Return whether a chamber, or poses, can make an effect show itself in another run."""
    inputs = {name for part in candidate.parts for name in part.effect.inputs}
    return candidate.scope in ("shared", "either") and inputs <= {ACCEL}


def _answer(channel: Channel, beside: Sequence[Candidate], one: Candidate) -> Answer:
    return Answer(one.family, fit(channel, [*beside, one]), one.carries)
