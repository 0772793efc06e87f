"""What stands beside the verdict: how the effects rank, what is left of each run, what is open.

Each answer that is possible to an open question is a whole model, fitted to the training, so that the next
experiment can be tried on units that have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding, Scored, Table
from imumon.lab.diagnosis.fit import Fit, TestScore, fit, root_mean_square, score_test
from imumon.lab.diagnosis.search import Search

MOST_RANKED = 6
"""Effects in the ranking of the report."""
NOTHING = "nothing"
"""The answer that there is slow noise and no effect."""
MOST_ANSWERS = 2
"""Effects that are tried behind what is unexplained."""


def ranking(channel: Channel, found: Search) -> list[dict[str, Any]]:
    """Return the effects that gain most, by what each does alone, whether or not any is named.

    `gain` in BIC over the baseline, and the rms that it leaves of training and of the test, by what it
    predicts of that; NaN without one.
    """
    ranked = []
    for one in _leaders(found.tables[0] if found.tables else {})[:MOST_RANKED]:
        fitted = fit(channel, [one.candidate])
        tested = score_test(channel, fitted).rms
        row = {"name": one.family, "gain": one.gain, "train_rms": fitted.train_rms, "test_rms": tested}
        ranked.append(row)
    return ranked


def _leaders(table: Table) -> list[Scored]:
    """Return the best of each family, the best of all first."""
    return sorted(table.values(), key=lambda one: -one.gain)


def runs_left(
    channel: Channel, before: Fit, after: Fit, tests: tuple[TestScore, TestScore]
) -> list[dict[str, Any]]:
    """Return what each run of training and test is left with: rms before and after, and the mean after; NaN
    where nothing counts."""
    rows, start = [], 0
    for run in channel.train:
        rows.append(
            _run_left(run.name, False, before.train[start:][: len(run)], after.train[start:][: len(run)])
        )
        start += len(run)
    for at, (run, use) in enumerate(zip(channel.test, tests[1].counted, strict=True)):
        rows.append(_run_left(run.name, True, *(one.residual[at][use] for one in tests)))
    return rows


def _run_left(name: str, test: bool, before: FloatArray, after: FloatArray) -> dict[str, Any]:
    mean = float(after.mean()) if len(after) else float("nan")
    rms = {"before": root_mean_square(before), "after": root_mean_square(after)}
    return {"name": name, "test": test, "blocks": len(after), **rms, "mean": mean}


def questions(
    channel: Channel, found: Search, kept: Sequence[Finding], unexplained: bool
) -> list[list[dict[str, Any]]]:
    """Return what is open in a channel in which these findings are claimed: each question as its answers.

    An answer is an effect that may be the one, or `NOTHING`, whether it carries over, and the model that has
    it, with effects as in a model file.
    """
    claimed, opened = [finding.candidate for finding in kept], []
    for finding in kept:
        if finding.others:
            beside = [other for other in claimed if other is not finding.candidate]
            either = [finding.candidate, *finding.others.values()]
            opened.append([_answer(channel, beside, one) for one in either])
    if unexplained and found.tables:
        tried = [one.candidate for one in _leaders(found.tables[-1]) if one.fit > 0.0]
        further = [one for one in tried if one not in claimed and _may_be_tried(one)][:MOST_ANSWERS]
        opened.append([_answer(channel, claimed, one) for one in (None, *further)])
    return opened


def _may_be_tried(candidate: Candidate) -> bool:
    """Return whether a chamber, or poses, can make an effect show itself in another run."""
    inputs = {name for part in candidate.parts for name in part.effect.inputs}
    return candidate.scope in ("shared", "either") and inputs <= {ACCEL}


def _answer(channel: Channel, beside: Sequence[Candidate], one: Candidate | None) -> dict[str, Any]:
    model = fit(channel, beside if one is None else [*beside, one])
    return {
        "name": NOTHING if one is None else one.family,
        "carries": one is None or one.carries,
        "declared": model.declared.tolist(),
        "effects": [part.effect.model_dump() for part in model.parts if part.carries],
    }
