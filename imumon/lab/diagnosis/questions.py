"""What a diagnosis leaves open: effects that are not told apart, and what may be behind the unexplained.

Each answer that is possible is a whole model, fitted to the training, so that the next experiment can be
tried on units that have it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imumon.effects.base import ACCEL
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.choice import Finding
from imumon.lab.diagnosis.fit import Fit, fit
from imumon.lab.diagnosis.search import Search

NOTHING = "nothing"
"""The answer that there is slow noise and no effect; alone: is it noise, or something that the course of
the temperature makes?"""
MOST_ANSWERS = 2
"""Effects that are thought of behind what is unexplained."""


@dataclass(frozen=True, slots=True)
class Answer:
    """An effect that may be the one, or `NOTHING`, the model that has it, and whether that carries over."""

    name: str
    fit: Fit
    carries: bool = True


Question = list[Answer]
"""Which of these is it?"""


def questions(channel: Channel, found: Search, kept: Sequence[Finding], unexplained: bool) -> list[Question]:
    """Return what is open in a channel in which these findings are claimed."""
    claimed, opened = [finding.candidate for finding in kept], list[Question]()
    for finding in kept:
        if finding.alike:
            beside = [other for other in claimed if other is not finding.candidate]
            either = [finding.candidate, *finding.others.values()]
            opened.append([_answer(channel, beside, one) for one in either])
    if unexplained and found.tables:
        leaders = sorted(found.tables[-1].values(), key=lambda one: -one.gain)
        tried = [one.candidate for one in leaders if one.fit > 0.0]
        further = [one for one in tried if one not in claimed and _may_be_tried(one)][:MOST_ANSWERS]
        nothing = Answer(NOTHING, fit(channel, claimed))
        opened.append([nothing, *(_answer(channel, claimed, one) for one in further)])
    return opened


def _may_be_tried(candidate: Candidate) -> bool:
    """Tell whether a chamber, or poses, can make an effect show itself in another run."""
    inputs = {name for part in candidate.parts for name in part.effect.inputs}
    return candidate.scope in ("shared", "either") and inputs <= {ACCEL}


def _answer(channel: Channel, beside: Sequence[Candidate], one: Candidate) -> Answer:
    model = fit(channel, [*beside, one])
    return Answer(one.family, model, all(part.carries for part in model.parts[-len(one.parts) :]))
