"""What a wing is: a folder with something that few need, which the core knows by this object alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Command(NamedTuple):
    """A command of the command line."""

    group: str
    """Heading in the help: one of `GROUPS`."""
    help: str
    """Line that the help shows."""
    module: str
    """Where it is: has `command`."""


GROUPS = (
    "Watch and record",
    "Data in and out",
    "Understand a unit",
    "Many units",
    "Devices",
    "Without hardware",
)
"""Headings of the help, in their order."""


class Wing(NamedTuple):
    """What a wing brings; places in code are written "module:name", and imported when they are needed."""

    name: str
    commands: Mapping[str, Command] = {}
    """By the name of the command."""
    firmware: Mapping[str, str] = {}
    """By the protocol of a device file, what makes a virtual device answer commands.

    It takes the device file and its rate in Hz.
    """
    live_output: str = ""
    """Option of `imumon monitor` that sends what is recorded elsewhere, too.

    It has the `name` of its parameter, the decorator `option`, `parse`, and `start`, which returns what is
    running: with `publish`, `text` for the status line, `as_data` and `rows`, `announce` and `close`.
    """
    stages: str = ""
    """Returns more stages behind those of the core.

    It takes the `Setup`, the parameters of the temperature rate and the stages before.
    """
    compare_models: str = ""
    """Writes the page of what two models leave of a session; see `imumon.lab.hooks.compare_models`."""
    import_log: str = ""
    """Makes a session of a log that needs no map; see `imumon.logs.importing.import_log`."""
