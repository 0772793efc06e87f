"""``imumon mark``: a word of the user in a recording that goes on."""

from __future__ import annotations

from pathlib import Path

import click

from imumon.cli.common import PATH
from imumon.errors import ImumonError, Reason


@click.command("mark")
@click.argument("session", type=PATH)
@click.argument("text")
@click.option("--start", is_flag=True, help="A part of the recording called TEXT begins here.")
@click.option("--stop", is_flag=True, help="The part called TEXT ends here.")
def command(session: Path, text: str, start: bool, stop: bool) -> None:
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
