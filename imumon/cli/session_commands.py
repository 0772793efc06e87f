"""``imumon mark``, ``recover``: a session while it is recorded, and after it was interrupted."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from imumon.cli.common import PATH, device_help, json_option, print_json, say, warn
from imumon.errors import ImumonError, Reason


@click.command("mark")
@click.argument("session", type=PATH)
@click.argument("text")
@click.option("--start", is_flag=True, help="A part of the recording called TEXT begins here.")
@click.option("--stop", is_flag=True, help="The part called TEXT ends here.")
def mark(session: Path, text: str, start: bool, stop: bool) -> None:
    """Put TEXT into SESSION, which is being recorded: an event in the recording, and a lane in the view.

    \b
    imumon mark sessions/NAME "heater on"
    imumon mark sessions/NAME turning --start
    """
    from imumon.run.marks import ask_for_mark
    from imumon.transport.reader import EventKind

    if start and stop:
        raise ImumonError(Reason.BAD_CONFIG, "--start and --stop are both given", "give one of them")
    kind = EventKind.START if start else EventKind.STOP if stop else EventKind.MARK
    ask_for_mark(session, kind, text)


@click.command("recover")
@click.argument("session", type=PATH)
@click.option(
    "--device", help=device_help + "  Only where session.yaml is lost and wire.mcap does not hold it."
)
@json_option
def recover(session: Path, device: str | None, as_json: bool) -> None:
    """Finish SESSION, which was interrupted or damaged: its recording and its counters.

    \b
    imumon recover sessions/NAME

    A lost or damaged session.yaml is written anew from wire.mcap.  A file that is replaced is kept beside the
    new one as NAME.original.  A session that is whole is left as it is.
    """
    from imumon.run.recovery import recover as recovered

    result = recovered(session, device)
    for sentence in result.done or ["the session is whole; nothing was written"]:
        say("INFO", sentence)
    for original in result.originals:
        say("INFO", f"the original is {original}")
    warn(result.warnings)
    if as_json:
        before = asdict(result.before)
        before.pop("metadata")
        found = {"session": result.session, "done": result.done, "originals": result.originals}
        print_json({**found, "warnings": result.warnings, "before": before})
