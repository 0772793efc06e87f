"""What several commands share: options, output for people and programs."""

import json
import math
import os
import shutil
import socket
import sys
import textwrap
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TextIO

import click

from imumon.errors import ImumonError, bad_config
from imumon.files import plain
from imumon.harmless import for_log, for_terminal
from imumon.run import PUBLISHED

if TYPE_CHECKING:
    from rich.console import Console

    from imumon.recordings.folder import Session
    from imumon.run.setup import Setup

INTERRUPTED = threading.Event()
"""Set by Ctrl-C where that does nothing else: libraries make other errors of KeyboardInterrupt, or none."""
ABSURD = 1e5
"""A limit from here on protects the program, and is of no interest in a help text."""


def described_range(kind: click.IntRange | click.FloatRange) -> str:
    """Return the limits of a number, of which there is a lower one, as people write them."""
    low, high = kind.min, kind.max
    if high is None or high >= ABSURD:
        return f"above {low:g}" if kind.min_open else f"{low:g} or more"
    return f"above {low:g}, up to {high:g}" if kind.min_open else f"{low:g} to {high:g}"


class Number(click.FloatRange):
    """A number in a range; NaN, which compares as if it were in any range, is refused."""

    def __init__(self, name: str = "number", **limits: Any) -> None:
        super().__init__(**limits)
        self.name = name

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number = math.nan
        with suppress(ValueError):
            number = float(value)
        if math.isnan(number):
            unit = " of seconds, without a unit" if self.name == "seconds" else ""
            self.fail(f"{value} is not a number{unit}", param, ctx)
        if self.max is not None and self.max >= ABSURD and number > self.max:
            self.fail(f"{value} is not in the range up to {self.max:g}", param, ctx)
        return float(super().convert(value, param, ctx))

    _describe_range = described_range


class Whole(click.IntRange):
    """A whole number in a range."""

    name = "number"
    _describe_range = described_range


SECONDS = Number("seconds", min=0, min_open=True, max=1e9)
"""A length of time; the system cannot wait for much more."""
PATH = click.Path(path_type=Path)
path_option = partial(click.option, type=PATH)
path_argument = partial(click.argument, type=PATH)
TABLE = "Table to write: NAME.parquet, .csv, .npz, .mat, or .mcap (ROS 2)."
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object on standard output."
)
baud_option = click.option(
    "--baud", type=Whole(min=1), help="Baud rate; the device file's first when not given."
)
seed_option = click.option(
    "-s", "--seed", default=0, show_default=True, type=Whole(min=0), help="Seed of all noise."
)
seconds_option = click.option("--seconds", type=SECONDS, help="Stop after this time.")
session_option = path_option(
    "--out", help="Session folder of the recording; default: a new one in ./sessions."
)
pipeline_option = path_option(
    "--pipeline",
    help="Pipeline file (YAML): place, bias model and parameters of the estimators.",
)
model_option = path_option("--model", help="Model of the bias over temperature, a file of imumon calibrate.")
serial_option = click.option("--serial", help="Serial number of the unit, for the catalog.")
columns_option = click.option("--columns", help="Columns of the table, separated by commas; default: all.")
window_option = click.option(
    "--window",
    default=30,
    show_default=True,
    type=Number("seconds", min=1, max=86_400),
    help="Length of time that the strips of the view show.",
)
bind_option = click.option(
    "--bind", default="127.0.0.1", show_default=True, help="Address that the web view is served on."
)
rate_option = click.option(
    "--rate",
    type=Number(min=1e-3, max=1e6),
    metavar="HZ",
    help="Packets per second of a device that sends no time; default: the device file's rate_hz.",
)
latitude_option = click.option(
    "--latitude",
    type=Number(min=-90, max=90),
    help="Latitude of the place, degrees north; needed to separate the earth's rotation.",
)
heading_option = click.option(
    "--heading",
    type=Number(min=-360, max=360),
    help="Direction of the x axis, degrees clockwise from true north, where it is known.",
)
live_view_option = click.option(
    "--view",
    type=click.Choice(["native", "web", "terminal", "none"]),
    help="Default: native with a display, else web; terminal shows numbers where the command runs.",
)
truth_option = click.option(
    "--truth",
    is_flag=True,
    help="For a simulated session: print the errors against its true values (rms, rms over standard"
    " deviation, largest).",
)
device_help = "Name of a known device (imumon devices) or path of a device file."


def print_json(data: Mapping[str, Any]) -> None:
    """Print one JSON object; NaN, which JSON does not know, becomes null."""
    click.echo(json.dumps(plain(data), indent=2))


def print_result(as_json: bool, data: Mapping[str, Any], rows: Mapping[str, str]) -> None:
    """Write what a command did: rows for a person on standard error, with ``--json`` the data on output."""
    if as_json:
        print_json(data)
    print_rows(rows)


def print_listing(as_json: bool, data: Mapping[str, Any], lines: Iterable[str]) -> None:
    """Write what there is on standard output: lines for a person, with ``--json`` the data."""
    if as_json:
        print_json(data)
    else:
        for line in lines:
            show(line)


def split_columns(text: str | None, option: str = "--columns") -> list[str] | None:
    """Split the ``a,b,c`` of an option; None stays None.

    Raises BAD_CONFIG when a name is empty or there twice.
    """
    if text is None:
        return None
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise bad_config(f"{option} {text!r}: a name is empty or there twice")
    return names


def note(text: str = "", *, color: str | None = None, control: str | None = None) -> None:
    """Write a line on standard error, or what controls the terminal and a text behind it.

    A terminal that was closed or a full disk below a log stops no recording.
    """
    with suppress(OSError):
        styled = click.style(for_terminal(text), fg=color)
        click.echo((control or "") + styled, err=True, nl=control is None)


def show(text: str) -> None:
    """Write on standard output."""
    click.echo(for_terminal(text))


def console(*, error: bool = False) -> "Console":
    """Return what draws tables and bars; texts in them are no markup."""
    from rich.console import Console

    return Console(stderr=error, markup=False, emoji=False, highlight=False)


def print_table(columns: Sequence[Any], rows: Iterable[Sequence[str]]) -> None:
    """Write a table on standard output; a column is its heading, or a `rich.table.Column`."""
    from rich.box import SIMPLE
    from rich.table import Table

    table = Table(*columns, box=SIMPLE, padding=(0, 1, 0, 0))
    for row in rows:
        table.add_row(*row)
    console().print(table)


def log(level: str, text: str) -> None:
    """Write a log line on standard error."""
    note(f"{level:5} {for_log(text)}", color={"WARN": "yellow", "ERROR": "red"}.get(level))


def warn(texts: Iterable[str]) -> None:
    """Write warnings as log lines on standard error."""
    for text in texts:
        log("WARN", text)


@contextmanager
def with_warnings(warnings: Callable[[], Iterable[str]]) -> Iterator[None]:
    """Write warnings also where an `ImumonError` comes instead of a result: they may give the reason."""
    try:
        yield
    except ImumonError:
        warn(warnings())
        raise


CLEAR_LINE = "\r\x1b[2K"
"""Empties the line of a terminal in which the cursor is."""


def is_terminal() -> bool:
    """Return whether standard error is a terminal that can draw."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


View = Literal["native", "web", "terminal", "none"]


def chosen_view(view: View | None, bind: str = "127.0.0.1") -> View:
    """Return where the view is to be shown, and report what stands against it.

    Raises BAD_CONFIG where a view is to be drawn in a terminal and there is none, or served on an address
    that is none of this computer.
    """
    from imumon.view.viewer import LOCALHOST, has_display

    mode = view or ("native" if has_display() else "web")
    if mode == "terminal" and not is_terminal():
        raise bad_config(
            "--view terminal: standard error is no terminal",
            "run it in a terminal, or use --view web or none",
        )
    if mode == "native" and not has_display():
        what = "--view native: there is no display here, so no window opens; --view web shows the run in a"
        warn([f"{what} browser, monitor --view terminal where it runs"])
    if mode == "web" and bind not in (LOCALHOST, "localhost"):
        try:
            socket.create_server((bind, 0)).close()
        except (OSError, UnicodeError) as error:
            raise bad_config(
                f"--bind {bind}: is no IPv4 address of this computer",
                "`ip -4 addr` lists them; 0.0.0.0 is all",
            ) from error
        warn([f"--bind {bind}: every computer that reaches this one can read the live view"])
    return mode


def labelled(rows: Mapping[str, str], columns: int | None = None) -> list[str]:
    """Return lines with a label each, below each other; folded between words to so many columns."""
    width = max(map(len, rows), default=0) + 4
    look: Any = {"subsequent_indent": " " * width, "break_long_words": False, "break_on_hyphens": False}
    lines = []
    for label, text in rows.items():
        start, whole = f"  {label}".ljust(width), for_log(text)
        folded = [] if columns is None else textwrap.wrap(whole, columns, initial_indent=start, **look)
        lines += folded or [start + whole]
    return lines


def columns_of(stream: TextIO) -> int | None:
    """Return the width of a terminal; None where it is none, so that lines in files stay whole."""
    return shutil.get_terminal_size().columns if stream.isatty() else None


def print_rows(rows: Mapping[str, str]) -> None:
    """Write labelled lines on standard error."""
    for line in labelled(rows, columns_of(sys.stderr)):
        note(line)


_SETUP_OPTIONS = (
    pipeline_option,
    model_option,
    click.option(
        "--zupt",
        type=click.Choice(["standard", "thermal", "learned"]),
        help="How the gyro bias is carried through motion after it was measured at rest (zero-velocity"
        " update, ZUPT): held constant (standard without --model), along the curve of --model (thermal),"
        " or along a curve that is learned in this run (learned).  Default: thermal with --model, else"
        " learned.",
    ),
    click.option("--random-error", type=click.Choice(["drift", "sr_rsukf"]), hidden=True),
    click.option(
        "--published",
        metavar="NAME,...",
        help="Run methods from papers beside imumon's own, to compare them; the results are unchanged,"
        " columns are added.  Any of: " + ", ".join(PUBLISHED) + ".",
    ),
    latitude_option,
    heading_option,
)


def setup_options(command: Callable[..., int]) -> Callable[..., int]:
    """Add the options; the command gets them as keywords named as they are."""
    for option in reversed(_SETUP_OPTIONS):
        command = option(command)
    return command


def make_setup(given: Mapping[str, Any], session: "Session | None" = None) -> "Setup":
    """Return the setup of a run: the pipeline file, else that of the session, changed by the options.

    Raises BAD_CONFIG when a file cannot be read, or the parts contradict each other.
    """
    from imumon.run.setup import Setup, load_setup, recorded_setup

    setup = Setup() if session is None else recorded_setup(session)
    if (path := given.get("pipeline")) is not None:
        setup = load_setup(path)
    changes = {
        "zupt_mode": given.get("zupt"),
        "latitude_deg": given.get("latitude"),
        "heading_deg": given.get("heading"),
    }
    if (path := given.get("model")) is not None:
        from imumon.models.model import load_model

        changes["model"] = load_model(path)
    if (method := given.get("random_error")) is not None:
        changes["random_error"] = setup.random_error.model_copy(update={"method": method})
    if (names := given.get("published")) is not None:
        chosen = [name for name in map(str.strip, names.split(",")) if name]
        if wrong := [name for name in chosen if name not in PUBLISHED or chosen.count(name) > 1]:
            raise click.BadParameter(
                f"{wrong[0]}: expected {', '.join(PUBLISHED)}, each once", param_hint="--published"
            )
        changes["published"] = chosen
    return setup.with_options(**changes)
