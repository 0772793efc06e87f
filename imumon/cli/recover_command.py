"""``imumon recover``: a session that was interrupted or damaged, made whole."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from imumon.cli.common import PATH, device_help, json_option, print_json, say, warn


@click.command("recover")
@click.argument("session", type=PATH)
@click.option(
    "--device", help=device_help + "  Only where session.yaml is lost and wire.mcap does not hold it."
)
@json_option
def command(session: Path, device: str | None, as_json: bool) -> None:
    """Finish SESSION, which was interrupted or damaged: its recording, its counters, its view.

    \b
    imumon recover sessions/NAME

    A lost or damaged session.yaml is written anew from wire.mcap.  A file that is replaced is kept beside the
    new one as NAME.original.  A session that is whole is left as it is.
    """
    from imumon.run.recovery import recover

    result = recover(session, device)
    for sentence in result.done:
        say("INFO", sentence)
    for original in result.originals:
        say("INFO", f"the original is {original}")
    if not result.done:
        say("INFO", "the session is whole; nothing was written")
    warn(result.warnings)
    if as_json:
        before = asdict(result.before)
        before.pop("metadata")
        found = {"session": result.session, "done": result.done, "originals": result.originals}
        print_json({**found, "warnings": result.warnings, "before": before})
