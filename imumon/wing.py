"""The wings: folders with something that few need, which the core knows by an object `Wing` alone.

Those of imumon are listed here, those of other packages found by their entry points.
"""

from collections.abc import Mapping
from functools import cache
from importlib import import_module
from pkgutil import resolve_name
from typing import Any, NamedTuple


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


BUILT_IN = (
    "imumon.allan",
    "imumon.papers",
    "imumon.lab",
    "imumon.logs",
    "imumon.publishing",
    "imumon.configure",
    "imumon.fleet",
    "imumon.simulation",
)
"""Packages that have `WING`; their stages run in this order."""
NEEDED = "wing (imumon.wing.Wing)"
"""What a plug-in offers in the group `imumon.plugins.WINGS`, in words."""


@cache
def built_in() -> tuple[Wing, ...]:
    """Return the wings of imumon."""
    return tuple(import_module(package).WING for package in BUILT_IN)


def wings() -> tuple[Wing, ...]:
    """Return all wings, those of imumon first.

    Raises BAD_CONFIG when one of another package does not load.
    """
    from .plugins import WINGS, plugins  # not for --help: it loads importlib.metadata

    return *built_in(), *(plugin.offered for plugin in plugins(WINGS, NEEDED, is_wing))


def is_wing(name: str, offered: Any) -> bool:
    """Return whether a plug-in is a wing of this name."""
    return isinstance(offered, Wing) and offered.name == name


def offers(hook: str) -> list[Any]:
    """Return what the wings bring under the name of a field of `Wing` that is one place in code."""
    return [resolve_name(place) for wing in wings() if (place := getattr(wing, hook))]


def firmware_of(protocol: str) -> Any:
    """Return what makes a virtual device of this protocol answer commands; None when nothing does."""
    place = next((wing.firmware[protocol] for wing in wings() if protocol in wing.firmware), None)
    return None if place is None else resolve_name(place)
