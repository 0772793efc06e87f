"""``imumon plan``: the next experiment, where a diagnosis leaves a question open."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.cli.common import PATH, Number, json_option, print_json, print_rows, results_folder, say
from imumon.cli.progress import reading_bar, rounded_time

if TYPE_CHECKING:
    from imumon.lab.diagnosis.planning import Plan

QUESTION_S = 180.0
"""Longest search for the answer to a question."""


@click.command("plan")
@click.argument("report", type=PATH)
@click.option("--out", required=True, type=PATH, help="Folder for chamber profiles and scenarios.")
@click.option(
    "--hours",
    type=Number(min=0, min_open=True, max=48),
    default=8,
    show_default=True,
    help="Longest experiment, hours.",
)
@json_option
def command(report: Path, out: Path, hours: float, as_json: bool) -> None:
    """Find the shortest experiment for each question that REPORT, of imumon diagnose, leaves open.

    \b
    imumon plan report/report.json --out plan

    Experiments are tried on simulated units that have what was fitted, each effect in question in turn, with
    the noise that was found.
    """
    from imumon.lab.diagnosis.planning import load_report, open_questions, plan, write_plan

    content = load_report(report)
    questions = open_questions(content)
    if questions and not as_json:
        at_most = rounded_time(QUESTION_S * len(questions))
        say("INFO", f"questions that are open: {len(questions)}; the search takes at most about {at_most}")
    with results_folder(out), reading_bar([report], quiet=as_json) as tell:
        plans = [plan(content, question, hours * 3600.0, tell) for question in questions]
        files = [write_plan(content, at + 1, made, out) for at, made in enumerate(plans)]
    described = [_described(made, paths) for made, paths in zip(plans, files, strict=True)]
    if as_json:
        print_json({"questions": described})
    if not plans:
        print_rows({"plan": "the report leaves no question open"})
    for at, (made, paths) in enumerate(zip(plans, files, strict=True)):
        print_rows({f"{at + 1}": _plan_rows(made)} | {path.name: str(path) for path in paths})


def _described(made: Plan, paths: list[Path]) -> dict[str, Any]:
    expected = made.expected
    return {
        "channel": made.question.channel,
        "also": list(made.question.also),
        "answers": [answer.name for answer in made.question.answers],
        "profile": None if made.profile is None else made.profile.title,
        "hours": None if made.profile is None else made.profile.duration_s / 3600.0,
        "expected_evidence_bic": None if expected is None else expected.value,
        "needed_bic": None if expected is None else expected.needed,
        "reached_bic": None if expected is None else expected.least,
        "why_not": made.why_not,
        "files": [str(path) for path in paths],
    }


def _plan_rows(made: Plan) -> str:
    also = f" (and {', '.join(made.question.also)})" if made.question.also else ""
    question = f"{made.question.channel}{also}: {made.question.name}?"
    if made.profile is None or made.expected is None:
        return f"{question} No experiment is planned: {made.why_not}"
    pair = made.expected
    return (
        f"{question} {made.profile.duration_s / 3600.0:.1f} h, {made.profile.title}: expected evidence for"
        f" {pair.truth} against {pair.rival} {pair.value:.0f} in BIC, {pair.needed:.0f} are needed;"
        f" {pair.least:.0f} is the least of three simulated units"
    )
