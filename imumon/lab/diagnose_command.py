"""``imumon diagnose``: what the bias model of a unit leaves over, by name."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    PATH,
    json_option,
    print_json,
    print_rows,
    results_folder,
    warn,
    with_warnings,
)
from imumon.cli.progress import reading_bar
from imumon.errors import bad_config

if TYPE_CHECKING:
    from imumon.lab.diagnosis.diagnose import Diagnosis
    from imumon.lab.diagnosis.runs import Run
    from imumon.models.model import BiasModel
    from imumon.recordings.source import Count

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
def command(
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
    from imumon.lab.diagnosis.diagnose import diagnose, parse_declared
    from imumon.lab.diagnosis.extended import extended_model, with_model
    from imumon.lab.diagnosis.page import write_page
    from imumon.lab.diagnosis.report import write_report
    from imumon.models.curves.polynomial import CUBIC

    if declared is not None and model_path is not None:
        raise bad_config("--model and --declared are both given", "give one: each says what is assumed")
    model = model_of(model_path) if model_path is not None else None
    assumed = declared if declared is not None else CUBIC
    parse_declared(assumed)
    runs: list[list[Run]] = []
    warned = with_warnings(lambda: dict.fromkeys(t for group in runs for run in group for t in run.warnings))
    with warned, results_folder(out), reading_bar([*train, *test], quiet=as_json) as tell:
        sensors = channels.split(",")
        runs += [read(path, map_path, at_rest, sensors, tell.count) for path in (*train, *test)]
        split = len(train)
        training = [run for group in runs[:split] for run in group]
        testing = [run for group in runs[split:] for run in group]
        beside = chosen_drivers(drivers)
        diagnosis = diagnose(training, testing, assumed, tell, sensors, model, beside)
        diagnosis.given = _given(click.get_current_context())
        written = {"report": "report.html", "numbers": "report.json"}
        if with_model(diagnosis):
            extended_model(diagnosis).write(out / "model.yaml")
            written["model"] = "model.yaml"
        write_report(diagnosis, out / "report.json")
        write_page(diagnosis, out / "report.html", tell)
    _show(diagnosis, out, written, as_json=as_json)


def _show(diagnosis: Diagnosis, out: Path, written: Mapping[str, str], *, as_json: bool) -> None:
    """Print the verdicts, what was written, and the next step."""
    from imumon.lab.diagnosis.report import conclusion, next_step, report

    warn(diagnosis.caveats)
    if as_json:
        print_json(report(diagnosis, out))
    print_rows({verdict.name: verdict.summary for verdict in diagnosis.verdicts})
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


def chosen_drivers(text: str) -> list[str] | None:
    """Return the drivers that ``--drivers`` names; None for all."""
    return {"all": None, "none": []}.get(text, text.split(","))


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
