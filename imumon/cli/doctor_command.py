"""``imumon doctor``: what this computer lacks."""

from __future__ import annotations

from pathlib import Path

import click

from imumon.cli.common import PATH, json_option, print_json, show
from imumon.errors import EXIT_NEGATIVE, EXIT_OK

COLOURS = {"good": "green", "warning": "yellow", "fault": "red"}


@click.command("doctor")
@click.argument("folder", type=PATH, default=Path("sessions"))
@json_option
def command(folder: Path, as_json: bool) -> int:
    """Check packages, compiled code, disk, ports, viewer and display, and print what to do.

    \b
    imumon doctor

    FOLDER is where sessions are written.  Exits with 1 when something does not work.
    """
    from imumon.run.doctor import State, examine

    findings = list(examine(folder))
    faults = sum(finding.state is State.FAULT for finding in findings)
    if as_json:
        found = [{**finding._asdict(), "state": finding.state.value} for finding in findings]
        print_json({"findings": found, "faults": faults})
        return EXIT_NEGATIVE if faults else EXIT_OK
    for finding in findings:
        state = click.style(f"{finding.state.value:<8}", fg=COLOURS[finding.state.value])
        click.echo(state, nl=False)
        show(f"{finding.subject}: {finding.seen}")
        if finding.remedy:
            show(f"{'':<8}  -> {finding.remedy}")
    return EXIT_NEGATIVE if faults else EXIT_OK
