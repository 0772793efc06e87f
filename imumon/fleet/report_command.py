"""``imumon report``: the calibration record of a session or a unit, as one page."""

from __future__ import annotations

from pathlib import Path

import click

from imumon.cli.common import PATH, print_rows, warn
from imumon.errors import bad_data
from imumon.files import check_output


@click.command("report")
@click.argument("what", metavar="SESSION|UNIT")
@click.option("--out", required=True, type=PATH, help="Page to write: NAME.html.")
@click.option(
    "--sessions",
    type=PATH,
    default=Path("sessions"),
    show_default=True,
    help="Where the sessions of a UNIT are.",
)
def command(what: str, out: Path, sessions: Path) -> None:
    """Write the record of a SESSION, or of the UNIT with this serial number, as one HTML page.

    \b
    imumon report sessions/NAME --out record.html
    imumon report 0380123 --sessions sessions --out unit.html
    """
    check_output(out, replace=True, suffix=".html")
    from imumon.fleet.catalog.page import write_session, write_unit
    from imumon.fleet.catalog_command import read
    from imumon.recordings.folder import is_session, open_session

    if is_session(Path(what)):
        warn(write_session(open_session(Path(what)), out))
    else:
        units, unusual, _ = read(sessions) if sessions.is_dir() else ([], [], {})
        known = {unit.name: unit for unit in units}
        if what not in known:
            raise bad_data(
                f"{what} is neither a session nor a unit of which there are sessions in {sessions}",
                f"there are: {', '.join(known) or 'none'}; --sessions DIR names another folder",
            )
        write_unit(known[what], unusual, out)
    print_rows({"record": str(out)})
