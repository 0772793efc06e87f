"""``imumon learn``: a better bias model of a unit, from all its sessions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import PATH, json_option, print_json, print_rows, warn
from imumon.cli.progress import reading_bar
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError, bad_config, bad_data
from imumon.files import check_output
from imumon.lab.diagnose_command import model_of, read

if TYPE_CHECKING:
    from imumon.lab.diagnosis.runs import Run
    from imumon.recordings.folder import Session
    from imumon.recordings.source import Count


@click.command("learn")
@click.argument("folder", metavar="DIR", type=PATH)
@click.option(
    "--model", "model_path", type=PATH, help="The present bias model: a file, or a session that ran with it."
)
@click.option("--device", help="Sessions of this device; needed where DIR has several.")
@click.option("--serial", help="Sessions of the unit of this serial number; needed where DIR has several.")
@click.option("--out", required=True, type=PATH, help="Model file to write; none is replaced.")
@json_option
def command(
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
    from imumon.lab.diagnosis.diagnose import diagnose
    from imumon.lab.diagnosis.extended import extended_model, with_model
    from imumon.lab.diagnosis.prepare import latest
    from imumon.lab.diagnosis.report import report
    from imumon.recordings.folder import sessions_in

    check_output(out)
    model = model_of(model_path) if model_path is not None else None
    found = sessions_in(folder, lambda text: warn([text]))
    sessions = _of_one(found, {"device": device, "serial": serial}, folder)
    if model is not None:
        warn(filter(None, {model.of_another(session.metadata.serial) for session in sessions}))
    with reading_bar([session.path for session in sessions], quiet=as_json) as tell:
        usable = [runs for session in sessions if (runs := _read(session, tell.count))]
        if not usable:
            raise bad_data(f"no session in {folder} can be used", "record the unit at rest for an hour")
        diagnosis = diagnose(*latest(usable), progress=tell, model=model)
    warn(diagnosis.caveats)
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
            raise bad_config(seen, f"say which unit is meant: --{key} NAME")
        sessions = found
    return sessions


def _read(session: Session, count: Count) -> list[Run]:
    """Return the runs of a session that can be used, saying why others cannot."""
    from imumon.lab.diagnosis.runs import MOSTLY

    try:
        runs = read(session.path, None, at_rest=False, count=count)
    except ImumonError as error:
        warn([f"{session.path.name} is left out: {error.line}"])
        return []
    warn(f"{run.name} is left out: it moves" for run in runs if run.rest_share < MOSTLY)
    return [run for run in runs if run.rest_share >= MOSTLY]
