"""``imumon diagnose``, ``learn``, ``plan``: what a bias model leaves over, and how to find out."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.cli.common import (
    Number,
    json_option,
    log,
    path_argument,
    path_option,
    print_json,
    print_rows,
    warn,
    with_warnings,
)
from imumon.cli.progress import reading_bar, rounded_time
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, bad_config, bad_data
from imumon.files import check_output, results_folder

if TYPE_CHECKING:
    from imumon.models.model import BiasModel
    from imumon.recordings.folder import Session
    from imumon.recordings.source import Count

    from .diagnosis.diagnose import Diagnosis
    from .diagnosis.planning import Plan
    from .diagnosis.runs import Run


class _SeveralValues(click.Command):
    """Takes ``--train A B --test C`` as ``--train A --train B --test C``."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Name the option before each of its values."""
        spread: list[str] = []
        option = ""
        for text in args:
            if text in ("--train", "--test"):
                option = text
                continue
            option = "" if text.startswith("-") else option
            spread += [option, text] if option else [text]
        return super().parse_args(ctx, spread)


@click.command("diagnose", cls=_SeveralValues)
@path_option("--train", required=True, multiple=True, help="Session or table to learn from; repeatable.")
@path_option("--test", multiple=True, help="Session or table for the proof; repeatable.")
@click.option(
    "--declared",
    default=None,
    help="Bias model that is assumed: 'polynomial N' in temperature, '+ offset' for a constant of each run;"
    " default: polynomial 3.",
)
@path_option(
    "--model",
    "model_path",
    help="Instead of --declared: a model file of imumon calibrate, or a session that ran with it.",
)
@click.option(
    "--channels",
    default="gyro,accel,clock",
    help="Channels to diagnose: gyro,accel,clock (the default; clock: that of the device, where arrival times"
    " are recorded), mag, pressure, temperature, or any recorded columns.",
)
@path_option(
    "--map",
    "map_path",
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
@path_option("--out", required=True, help="Folder for the report and the extended model.")
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
    from imumon.models.curves.polynomial import CUBIC

    from .diagnosis import diagnose as engine
    from .diagnosis import extended, page, report
    from .diagnosis.runs import read_runs

    if declared is not None and model_path:
        raise bad_config("--model and --declared are both given", "give one: each sets what is assumed")
    model = model_of(model_path) if model_path else None
    assumed = declared if declared is not None else CUBIC
    engine.parse_declared(assumed)
    training: list[Run] = []
    testing: list[Run] = []
    warned = with_warnings(lambda: dict.fromkeys(t for run in (*training, *testing) for t in run.warnings))
    with warned, results_folder(out), reading_bar([*train, *test], quiet=as_json) as progress:
        sensors = [name.strip() for name in channels.split(",")]
        for runs, paths in ((training, train), (testing, test)):
            for path in paths:
                runs += read_runs(path, map_path, at_rest, sensors, progress.count)
        beside = {"all": None, "none": []}.get(drivers, [name.strip() for name in drivers.split(",")])
        diagnosis = engine.diagnose(training, testing, assumed, progress, sensors, model, beside)
        diagnosis.options = _given(click.get_current_context())
        written = {"report": "report.html", "numbers": "report.json"}
        if extended.with_model(diagnosis):
            extended.extended_model(diagnosis).write(out / "model.yaml")
            written["model"] = "model.yaml"
        report.write_report(diagnosis, out / "report.json")
        page.write_page(diagnosis, out / "report.html", progress)
    _show(diagnosis, out, written, as_json=as_json)


def _show(diagnosis: Diagnosis, out: Path, written: Mapping[str, str], *, as_json: bool) -> None:
    from .diagnosis import page, report

    warn(diagnosis.caveats)
    if "model" not in written and (out / "model.yaml").exists():
        warn([f"{out / 'model.yaml'} is of an earlier diagnosis: none of these channels goes into a model"])
    if as_json:
        print_json(report.report(diagnosis, out))
    print_rows({verdict.name: verdict.summary for verdict in diagnosis.verdicts})
    errors = {f"error of {one.name}": page.error_text(one) for one in diagnosis.verdicts}
    print_rows({name: error for name, error in errors.items() if error})
    print_rows({what: str(out / name) for what, name in written.items()})
    print_rows({"conclusion": report.conclusion(diagnosis)})
    step = report.next_step(diagnosis, out)
    print_rows({"next": f"{step.what} {step.why} {step.command}".strip()})


def _given(context: click.Context) -> str:
    """Return the options of a diagnosis as they were given, to repeat it with another test."""
    words: list[str] = []
    for option in context.command.params:
        name = str(option.name)
        source = context.get_parameter_source(name)
        if name in ("test", "out", "as_json") or source != click.core.ParameterSource.COMMANDLINE:
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
    if not model:
        raise bad_config(f"{path} ran without a bias model", "give a model file")
    return model


@click.command("learn")
@path_argument("folder", metavar="DIR")
@path_option("--model", "model_path", help="The present bias model: a file, or a session that ran with it.")
@click.option("--device", help="Sessions of this device; needed where DIR has several.")
@click.option("--serial", help="Sessions of the unit of this serial number; needed where DIR has several.")
@path_option("--out", required=True, help="Model file to write; none is replaced.")
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
    from imumon.recordings.folder import sessions_in

    from .diagnosis import diagnose as engine
    from .diagnosis import extended, report

    check_output(out)
    model = model_of(model_path) if model_path else None
    found = sessions_in(folder, lambda text: warn([text]))
    sessions = _of_one(found, {"device": device, "serial": serial}, folder)
    of_units = {model.of_another(one.metadata.serial) for one in sessions} if model else set()
    warn(filter(None, of_units))
    with reading_bar([session.path for session in sessions], quiet=as_json) as progress:
        usable = [runs for session in sessions if (runs := _resting_runs(session, progress.count))]
        if not usable:
            raise bad_data(f"no session in {folder} can be used", "record the unit at rest for an hour")
        *earlier, last = usable
        training = [run for runs in earlier or [last] for run in runs]
        diagnosis = engine.diagnose(training, last if earlier else [], progress=progress, model=model)
    warn(text for text in diagnosis.caveats if text not in of_units)
    carried = [one for one in extended.with_model(diagnosis) if one.predicts]
    better = any(one.claims or one.refit for one in carried)
    if better:
        extended.extended_model(diagnosis).write(out)
    if as_json:
        print_json(report.report(diagnosis) | {"out": out if better else None})
    print_rows({verdict.name: verdict.summary for verdict in diagnosis.verdicts})
    print_rows({"model": str(out) if better else "nothing better was found: none is written"})
    return EXIT_OK if better else EXIT_NEGATIVE


def _of_one(sessions: list[Session], wanted: dict[str, str | None], folder: Path) -> list[Session]:
    """Return the sessions of one unit, the oldest first: of one device and serial number, where known.

    `wanted` is the device and the serial number that were given.
    """
    for key, value in wanted.items():
        found = [session for session in sessions if value in (None, getattr(session.metadata, key))]
        names = sorted({name for session in found if (name := getattr(session.metadata, key))})
        if not found:
            of_unit = f" of {key} {value}" if value else ""
            raise bad_data(f"there is no session{of_unit} in {folder}", "give the folder of the sessions")
        if len(names) > 1:
            raise bad_config(
                f"{folder} has sessions of {key} {', '.join(names)}",
                f"name the unit that is meant: --{key} NAME",
            )
        sessions = found
    return sessions


def _resting_runs(session: Session, count: Count) -> list[Run]:
    from .diagnosis.runs import MOSTLY, read_runs

    try:
        runs = read_runs(session.path, count=count)
    except ImumonError as error:
        warn([f"{session.path.name} is left out: {error.line}"])
        return []
    warn(f"{run.name} is left out: it moves" for run in runs if run.rest_share < MOSTLY)
    return [run for run in runs if run.rest_share >= MOSTLY]


@click.command("plan")
@path_argument("report")
@path_option("--out", required=True, help="Folder for chamber profiles and scenarios.")
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

    from .diagnosis import planning

    content = load_yaml(report / "report.json" if report.is_dir() else report, planning.Report)
    questions = planning.open_questions(content)
    if questions and not as_json:
        log(
            "INFO",
            f"questions that are open: {len(questions)}; the search takes at most about"
            f" {rounded_time(180.0 * len(questions))}",
        )
    with results_folder(out), reading_bar([report], quiet=as_json) as progress:
        plans = [planning.plan(content, question, hours * 3600.0, progress) for question in questions]
        planned = [(made, planning.write_plan(content, at + 1, made, out)) for at, made in enumerate(plans)]
    written = {path for _, paths in planned for path in paths}
    warn(f"{path} is of an earlier plan" for path in sorted({*out.glob("[0-9]*-*")} - written))
    if as_json:
        print_json({"questions": [_described(made, paths) for made, paths in planned]})
    if not plans:
        print_rows({"plan": "the report leaves no question open"})
    for at, (made, paths) in enumerate(planned):
        print_rows({f"{at + 1}": _plan_rows(made)} | {path.name: str(path) for path in paths})


def _described(made: Plan, paths: list[Path]) -> dict[str, Any]:
    expected = made.expected
    return {
        "channel": made.question.channel,
        "also": list(made.question.also),
        "answers": [answer.name for answer in made.question.answers],
        "profile": None if expected is None else expected.profile.title,
        "hours": None if expected is None else expected.profile.duration_s / 3600.0,
        "expected_evidence_bic": None if expected is None else expected.value,
        "needed_bic": None if expected is None else expected.needed,
        "reached_bic": None if expected is None else expected.least,
        "why_not": made.why_not,
        "files": [str(path) for path in paths],
    }


def _plan_rows(made: Plan) -> str:
    also = f" (and {', '.join(made.question.also)})" if made.question.also else ""
    question = f"{made.question.channel}{also}: {made.question.name}?"
    if (pair := made.expected) is None:
        return f"{question} No experiment is planned: {made.why_not}"
    return (
        f"{question} {pair.profile.duration_s / 3600.0:.1f} h, {pair.profile.title}: expected evidence for"
        f" {pair.truth} against {pair.rival} {pair.value:.0f} in BIC, {pair.needed:.0f} are needed;"
        f" {pair.least:.0f} is the least of three simulated units"
    )
