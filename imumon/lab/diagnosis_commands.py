"""``imumon diagnose``, ``learn``, ``plan``: what a bias model leaves over, and how to find out."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.cli.common import (
    PATH,
    Number,
    json_option,
    log,
    print_json,
    print_rows,
    warn,
    with_warnings,
)
from imumon.cli.progress import reading_bar, rounded_time
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, bad_config, bad_data
from imumon.files import check_output, results_folder

if TYPE_CHECKING:
    from imumon.lab.diagnosis.diagnose import Diagnosis
    from imumon.lab.diagnosis.planning import Plan
    from imumon.lab.diagnosis.runs import Run
    from imumon.models.model import BiasModel
    from imumon.recordings.folder import Session
    from imumon.recordings.source import Count

QUESTION_S = 180.0
"""Longest search for the answer to a question of a plan."""
SEVERAL = ("--train", "--test")
COMMAND_LINE = click.core.ParameterSource.COMMANDLINE


class _SeveralValues(click.Command):
    """Takes ``--train A B --test C`` as ``--train A --train B --test C``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Name the option before each of its values."""
        spread: list[str] = []
        option = ""
        for text in args:
            if text.startswith("-"):
                option = text if text in SEVERAL else ""
                if option:
                    continue
            spread += [option, text] if option else [text]
        return super().parse_args(ctx, spread)


@click.command("diagnose", cls=_SeveralValues)
@click.option(
    "--train", required=True, multiple=True, type=PATH, help="Session or table to learn from; repeatable."
)
@click.option("--test", multiple=True, type=PATH, help="Session or table for the proof; repeatable.")
@click.option(
    "--declared",
    default=None,
    help="Bias model that is assumed: 'polynomial N' in temperature, '+ offset' for a constant of each run;"
    " default: polynomial 3.",
)
@click.option(
    "--model",
    "model_path",
    type=PATH,
    help="Instead of --declared: a model file of imumon calibrate, or a session that ran with it.",
)
@click.option(
    "--channels",
    default="gyro,accel,clock",
    help="Channels to diagnose: gyro,accel,clock (the default; clock: that of the device, where arrival times"
    " are recorded), mag, pressure, temperature, or any recorded columns.",
)
@click.option(
    "--map",
    "map_path",
    type=PATH,
    help="YAML file for tables: column and unit of each quantity, as in imumon import --help.",
)
@click.option(
    "--drivers",
    default="all",
    help="Other recorded quantities that may drive an effect: all (each that varies, the default), none, or"
    " NAME,...",
)
@click.option(
    "--at-rest", is_flag=True, help="The unit was at rest all the time, whatever the samples look like."
)
@click.option("--out", required=True, type=PATH, help="Folder for the report and the extended model.")
@json_option
def diagnose(
    train: tuple[Path, ...],
    test: tuple[Path, ...],
    declared: str | None,
    model_path: Path | None,
    channels: str,
    map_path: Path | None,
    drivers: str,
    at_rest: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Find which effect a bias model over temperature lacks, and prove it on data that are not in the fit.

    \b
    imumon diagnose --train soak1 soak2 --test soak3 --out report
    imumon diagnose --model unit.yaml --train soak1 --test soak2 --out report

    The recordings are of a unit at rest, each from power-on.  Two or more for training, with rising and
    falling temperature, give the clearest answer.
    """
    from imumon.lab.diagnosis.diagnose import diagnose as find_effects
    from imumon.lab.diagnosis.diagnose import parse_declared
    from imumon.lab.diagnosis.extended import extended_model, with_model
    from imumon.lab.diagnosis.page import write_page
    from imumon.lab.diagnosis.report import write_report
    from imumon.models.curves.polynomial import CUBIC

    if declared is not None and model_path is not None:
        raise bad_config("--model and --declared are both given", "give one: each sets what is assumed")
    model = model_of(model_path) if model_path is not None else None
    assumed = declared if declared is not None else CUBIC
    parse_declared(assumed)
    runs: list[list[Run]] = []
    warned = with_warnings(lambda: dict.fromkeys(t for group in runs for run in group for t in run.warnings))
    with warned, results_folder(out), reading_bar([*train, *test], quiet=as_json) as progress:
        sensors = [name.strip() for name in channels.split(",")]
        runs += [read(path, map_path, at_rest, sensors, progress.count) for path in (*train, *test)]
        split = len(train)
        training = [run for group in runs[:split] for run in group]
        testing = [run for group in runs[split:] for run in group]
        named = [name.strip() for name in drivers.split(",")]
        beside = {"all": None, "none": []}.get(drivers, named)
        diagnosis = find_effects(training, testing, assumed, progress, sensors, model, beside)
        diagnosis.options = _given(click.get_current_context())
        written = {"report": "report.html", "numbers": "report.json"}
        if with_model(diagnosis):
            extended_model(diagnosis).write(out / "model.yaml")
            written["model"] = "model.yaml"
        write_report(diagnosis, out / "report.json")
        write_page(diagnosis, out / "report.html", progress)
    _show(diagnosis, out, written, as_json=as_json)


def _show(diagnosis: Diagnosis, out: Path, written: Mapping[str, str], *, as_json: bool) -> None:
    from imumon.lab.diagnosis.page import error_text
    from imumon.lab.diagnosis.report import conclusion, next_step, report

    warn(diagnosis.caveats)
    if "model" not in written and (out / "model.yaml").exists():
        warn([f"{out / 'model.yaml'} is of an earlier diagnosis: none of these channels goes into a model"])
    if as_json:
        print_json(report(diagnosis, out))
    print_rows({verdict.name: verdict.summary for verdict in diagnosis.verdicts})
    print_rows({f"error of {one.name}": error for one in diagnosis.verdicts if (error := error_text(one))})
    print_rows({what: str(out / name) for what, name in written.items()})
    print_rows({"conclusion": conclusion(diagnosis)})
    step = next_step(diagnosis, out)
    print_rows({"next": f"{step.what} {step.why} {step.command}".strip()})


def _given(context: click.Context) -> str:
    """Return the options of a diagnosis as they were given, to repeat it with another test."""
    words: list[str] = []
    for option in context.command.params:
        name = str(option.name)
        if name in ("test", "out", "as_json") or context.get_parameter_source(name) != COMMAND_LINE:
            continue
        value = context.params[name]
        values = value if isinstance(value, tuple) else () if value is True else (value,)
        words += [option.opts[0], *map(str, values)]
    return shlex.join(words)


def model_of(path: Path) -> BiasModel:
    """Read a model file, or the model of a session that ran with one."""
    from imumon.models.model import load_model
    from imumon.recordings.folder import is_session, open_session
    from imumon.run.setup import recorded_setup

    if not is_session(path):
        return load_model(path)
    model = recorded_setup(open_session(path)).bias_model
    if model is None:
        raise bad_config(f"{path} ran without a bias model", "give a model file")
    return model


def read(
    path: Path,
    map_path: Path | None,
    at_rest: bool,
    sensors: Sequence[str] | None = None,
    count: Count = lambda _: None,
) -> list[Run]:
    """Read a recording as runs from power-on, for a diagnosis of these sensors."""
    from imumon.estimation.gyro_bias.stage import RestDetector
    from imumon.lab.diagnosis.runs import SENSORS, read_runs

    return read_runs(path, map_path, lambda _: [RestDetector()], at_rest, sensors or SENSORS, count)


@click.command("learn")
@click.argument("folder", metavar="DIR", type=PATH)
@click.option(
    "--model", "model_path", type=PATH, help="The present bias model: a file, or a session that ran with it."
)
@click.option("--device", help="Sessions of this device; needed where DIR has several.")
@click.option("--serial", help="Sessions of the unit of this serial number; needed where DIR has several.")
@click.option("--out", required=True, type=PATH, help="Model file to write; none is replaced.")
@json_option
def learn(
    folder: Path,
    model_path: Path | None,
    device: str | None,
    serial: str | None,
    out: Path,
    as_json: bool,
) -> int:
    """Diagnose all sessions at rest of a unit in DIR, the latest as the test, and write the better model.

    \b
    imumon learn sessions --model unit.yaml --out better.yaml

    Sessions with motion, and those that are too short, are left out.  If no better model is found, no file is
    written, and the exit code is 1.
    """
    from imumon.lab.diagnosis.diagnose import diagnose as find_effects
    from imumon.lab.diagnosis.extended import extended_model, with_model
    from imumon.lab.diagnosis.report import report
    from imumon.recordings.folder import sessions_in

    check_output(out)
    model = model_of(model_path) if model_path is not None else None
    found = sessions_in(folder, lambda text: warn([text]))
    sessions = _of_one(found, {"device": device, "serial": serial}, folder)
    of_units = set() if model is None else {model.of_another(one.metadata.serial) for one in sessions}
    warn(filter(None, of_units))
    with reading_bar([session.path for session in sessions], quiet=as_json) as progress:
        usable = [runs for session in sessions if (runs := _resting_runs(session, progress.count))]
        if not usable:
            raise bad_data(f"no session in {folder} can be used", "record the unit at rest for an hour")
        *earlier, last = usable
        training = [run for runs in earlier or [last] for run in runs]
        diagnosis = find_effects(training, last if earlier else [], progress=progress, model=model)
    warn(text for text in diagnosis.caveats if text not in of_units)
    better = any(verdict.predicts and (verdict.claims or verdict.refit) for verdict in with_model(diagnosis))
    if better:
        extended_model(diagnosis).write(out)
    if as_json:
        print_json(report(diagnosis) | {"out": out if better else None})
    print_rows({verdict.name: verdict.summary for verdict in diagnosis.verdicts})
    print_rows({"model": str(out) if better else "nothing better was found: none is written"})
    return EXIT_OK if better else EXIT_NEGATIVE


def _of_one(sessions: list[Session], wanted: dict[str, str | None], folder: Path) -> list[Session]:
    """Return the sessions of one unit, the oldest first: of one device and serial number, where known.

    `wanted` is the device and the serial number that were given.
    """
    for key, value in wanted.items():
        found = [session for session in sessions if value in (None, getattr(session.metadata, key))]
        names = sorted({name for session in found if (name := getattr(session.metadata, key)) is not None})
        if not found:
            what = "no session" if value is None else f"no session of {key} {value}"
            raise bad_data(f"there is {what} in {folder}", "give the folder of the sessions")
        if len(names) > 1:
            seen = f"{folder} has sessions of {key} {', '.join(names)}"
            raise bad_config(seen, f"name the unit that is meant: --{key} NAME")
        sessions = found
    return sessions


def _resting_runs(session: Session, count: Count) -> list[Run]:
    """Return the runs of a session that can be used, and report why others cannot."""
    from imumon.lab.diagnosis.runs import MOSTLY

    try:
        runs = read(session.path, None, at_rest=False, count=count)
    except ImumonError as error:
        warn([f"{session.path.name} is left out: {error.line}"])
        return []
    warn(f"{run.name} is left out: it moves" for run in runs if run.rest_share < MOSTLY)
    return [run for run in runs if run.rest_share >= MOSTLY]


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
def plan(report: Path, out: Path, hours: float, as_json: bool) -> None:
    """Find the shortest experiment for each question that REPORT, of imumon diagnose, leaves open.

    \b
    imumon plan report/report.json --out plan

    Experiments are tried on simulated units that have what was fitted, each effect in question in turn, with
    the noise that was found.
    """
    from imumon.config import load_yaml
    from imumon.lab.diagnosis import planning

    content = load_yaml(report / "report.json" if report.is_dir() else report, planning.Report)
    questions = planning.open_questions(content)
    if questions and not as_json:
        at_most = rounded_time(QUESTION_S * len(questions))
        log("INFO", f"questions that are open: {len(questions)}; the search takes at most about {at_most}")
    with results_folder(out), reading_bar([report], quiet=as_json) as progress:
        plans = [planning.plan(content, question, hours * 3600.0, progress) for question in questions]
        files = [planning.write_plan(content, at + 1, made, out) for at, made in enumerate(plans)]
    written = {path for paths in files for path in paths}
    warn(f"{path} is of an earlier plan" for path in sorted({*out.glob("[0-9]*-*")} - written))
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
