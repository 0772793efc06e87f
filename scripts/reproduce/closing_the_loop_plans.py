"""Whether `imumon plan` keeps its word: the evidence that it expects, and what a diagnosis of that finds."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

from closing_the_loop_cases import Setting, make_case
from study import Cells, Options, Study, Table, spread

from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.planning import MARGIN, Plan, Report, open_questions, plan, scenario, simulated_run
from imumon.lab.diagnosis.report import NOTHING, report

KINDS = (
    "thermal_lag",
    "temperature_rate",
    "dead_time",
    "warm_up",
    "stress_relaxation",
    "drift",
    "hysteresis",
)
OUTSIDE = ("slow wander", "supply")
SIZES = (1.0, 3.0, 10.0)
MOST_S = 8 * 3600.0
FRESH = 100
"""First seed of the units that a plan is proven on: no plan was made for them."""


@dataclass(frozen=True, slots=True)
class Kept:
    """A plan and what came of it."""

    label: str
    question: str
    hours: float
    expected: float
    needed: float
    reached: float
    seconds: float


def planned(job: tuple[str, float, int]) -> list[Kept]:
    """Return the plans for the questions that a simulated case leaves open."""
    kind, size, seed = job
    case = make_case(Setting((kind,), size, label=kind), seed)
    content = report(diagnose(case.runs[:2], case.runs[2:], sensors=("gyro",)))
    known = Report.model_validate({key: content[key] for key in Report.model_fields})
    found = []
    for question in open_questions(known):
        began = time.perf_counter()
        made = plan(known, question, MOST_S)
        took = time.perf_counter() - began
        label = f"{kind} at {size:g}"
        if made.expected is None:
            found.append(Kept(label, question.name, math.nan, math.nan, math.nan, math.nan, took))
            continue
        hours = made.expected.profile.duration_s / 3600.0
        expected, reached = made.expected, _reached(known, made, seed)
        found.append(Kept(label, question.name, hours, expected.value, expected.needed, reached, took))
    return found


def _reached(known: Report, made: Plan, seed: int) -> float:
    """Return the evidence of a whole diagnosis, with one recording for training and one for the test."""
    assert made.expected is not None
    truth, rival = made.expected.truth, made.expected.rival
    answer = next(one for one in made.question.answers if one.name == truth)
    content = scenario(known, made.question.channel, made.expected.profile, answer)
    train, test = (simulated_run(content, FRESH + 2 * seed + at) for at in (0, 1))
    degree = len(answer.declared) - 1
    diagnosis = diagnose([train], [test], f"polynomial {degree}", sensors=(made.question.channel[:-2],))
    verdict = next(one for one in diagnosis.verdicts if one.name == made.question.channel)
    for claim in verdict.claims:
        gains = claim.finding.family_gains
        if claim.finding.name in (truth, rival):
            return gains.get(truth, 0.0) - (0.0 if rival == NOTHING else max(gains.get(rival, 0.0), 0.0))
    return 0.0


def tables(given: Options) -> Iterator[Table]:
    """Yield what was expected and reached, question by question and in all."""
    work = [(kind, size, seed) for kind in (*KINDS, *OUTSIDE) for size in SIZES for seed in given.seeds]
    groups = spread(planned, work[: 1 if given.quick else None], given.jobs)
    found = [one for group in groups for one in group]
    rows: list[Cells] = []
    for one in found:
        rows.append([one.label, one.question, one.hours, one.expected, one.needed, one.reached, one.seconds])
    able = [one for one in found if one.expected >= MARGIN * one.needed]
    within = sum(0.5 <= one.reached / one.expected <= 2.0 for one in able)
    enough = sum(one.reached >= one.needed for one in able)
    made = sum(not math.isnan(one.hours) for one in found)
    note = (
        f"{len(found)} questions; {made} with a profile; {len(able)} of them expected to decide."
        f"  Reached within a factor of 2: {within} of {len(able)}; enough: {enough} of {len(able)}."
    )
    heads = ["case", "open", "hours", "expected", "needed", "reached", "s"]
    yield Table("", heads, rows, note, ("", "", *[".1f"] * 5))


STUDY = Study(tables, seeds=4, first=900)
