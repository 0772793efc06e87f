"""``imumon catalog``, ``report``: the sessions of a folder, and the units that they are of."""

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli import common
from imumon.cli.progress import bar
from imumon.errors import bad_data
from imumon.files import check_output, results_folder

if TYPE_CHECKING:
    from .catalog.units import Unit

HEADS = (
    "unit", "device", "sessions", "h", "first", "last", "°C", "σ, °/h", "models",
    "drift, °/h/month", "outliers",
)  # fmt: skip


@click.command("catalog")
@common.path_argument("folder", metavar="DIR")
@common.path_option(
    "--results", help="Folder of results of imumon batch replay; new sessions are added to"
    " it.  Default: DIR/catalog."
)  # fmt: skip
@common.path_option("--out", help="Folder for sessions.parquet, units.parquet and models.parquet.")
@common.json_option
def catalog(folder: Path, results: Path | None, out: Path | None, as_json: bool) -> None:
    """List the units of the sessions in DIR: temperatures, σ, losses, models, their drift, and outliers.

    \b
    imumon catalog sessions

    A new session is replayed once.  Serial numbers are those given when recording (--serial), or those in
    the models made of the sessions.
    """
    from .catalog.tables import tables, write_tables

    with nullcontext() if out is None else results_folder(out):
        units, left_out = read(folder, results, quiet=as_json)
        rows = tables(units)
        written = [] if out is None else write_tables(rows, out)
    common.warn(f"{row['session']}: {row['error']}" for row in rows["sessions"] if row["error"])
    if as_json:
        common.print_json(
            rows | {"left_out": [{"session": place, "error": why} for place, why in left_out.items()]}
        )
    else:
        _show([_row(unit) for unit in units])
    common.print_rows({path.name: str(path) for path in written})


def read(folder: Path, results: Path | None, quiet: bool) -> "tuple[list[Unit], dict[str, str]]":
    """Return the units of the sessions in a folder, and what was left out and why, with the progress.

    What was left out is warned of, and what recordings lack.
    """
    from .catalog.tables import find_outliers
    from .catalog.units import read_models, read_sessions, units_of

    if not folder.is_dir():
        raise bad_data(f"{folder} is no folder", "give the folder of the sessions")
    with bar("reading", None, quiet=quiet) as progress:
        entries, left_out = read_sessions(folder, results or folder / "catalog", progress)
    units = units_of(entries, read_models(folder))
    common.warn(f"{place} is left out: {why}" for place, why in left_out.items())
    common.warn(f"{entry.session.path}: {text}" for entry in entries for text in entry.lacking)
    find_outliers(units)
    return units, left_out


def _row(unit: "Unit") -> list[str]:
    from imumon.lab.diagnosis.page import shown

    from .catalog.tables import day, drifts
    from .catalog.units import BEST, COLDEST, HOTTEST, WORST

    factor, _ = shown("rad/s")
    row, drift_text = unit.row, "-"
    known = [drift for drift in drifts(unit) if drift.per_month == drift.per_month]
    if known:
        worst = max(known, key=lambda one: abs(one.per_month))
        slope, sd = factor * worst.per_month, factor * worst.per_month_sd
        drift_text = f"{worst.channel} {slope:+.2g} ± {sd:.1g}"
    return [
        unit.name, unit.device, str(row["sessions"]), f"{row['hours']:.2f}",
        day(row["first"]), day(row["last"]), _from_to(row[COLDEST], row[HOTTEST]),
        _from_to(factor * row[BEST], factor * row[WORST]), str(row["models"]), drift_text,
        str(len(unit.outliers)),
    ]  # fmt: skip


def _from_to(low: float, high: float) -> str:
    return f"{low:.3g} to {high:.3g}" if low == low else "-"


def _show(rows: Sequence[Sequence[str]]) -> None:
    """Print a table, or where that is wider than the terminal a line for each value."""
    from rich.table import Column

    widths = [2 + max(map(len, cells)) for cells in zip(HEADS, *rows, strict=True)]  # with what is between
    if 1 + sum(widths) <= common.console().width:
        common.print_table([Column(head, no_wrap=True) for head in HEADS], rows)
        return
    for row in rows:
        lines = common.labelled(dict(zip(HEADS, row, strict=True)), common.columns_of(sys.stdout))
        common.show("\n".join([*lines, ""]))


@click.command("report")
@click.argument("what", metavar="SESSION|UNIT")
@common.path_option("--out", required=True, help="Page to write: NAME.html.")
@common.path_option(
    "--sessions",
    default=Path("sessions"),
    show_default=True,
    help="Where the sessions of a UNIT are.",
)
def report(what: str, out: Path, sessions: Path) -> None:
    """Write the record of a SESSION, or of the UNIT with this serial number, as one HTML page.

    \b
    imumon report sessions/NAME --out record.html
    imumon report 0380123 --sessions sessions --out unit.html
    """
    check_output(out, replace=True, suffix=".html")
    from imumon.recordings.folder import is_session, open_session

    from .catalog.page import write_session, write_unit

    if is_session(Path(what)):
        common.warn(write_session(open_session(Path(what)), out))
    else:
        units, _ = read(sessions, None, quiet=False) if sessions.is_dir() else ([], {})
        known = [unit for unit in units if unit.name == what]
        if len(known) != 1:
            there = ", ".join(f"{unit.name} ({unit.device})" for unit in known or units) or "none"
            raise bad_data(
                f"{what} is neither a session nor one unit of which there are sessions in {sessions}",
                f"there are: {there}; --sessions DIR names another folder",
            )
        write_unit(known[0], out)
    common.print_rows({"record": str(out)})
