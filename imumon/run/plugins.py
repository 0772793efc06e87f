"""The plug-ins that are installed: of which package each is, what it brings, and whether it loads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

from imumon.errors import ImumonError
from imumon.plugins import DEVICES, EFFECTS, STAGES, WINGS, entries, load, package_of


@dataclass(frozen=True, slots=True)
class Installed:
    """An entry point of an installed package."""

    group: str
    name: str
    package: str
    version: str
    brings: tuple[str, ...] = ()
    """Columns of a stage, devices of a folder, the sensors of an effect; empty when it does not load."""
    problem: str = ""
    """Why it does not load; empty when it does."""


def installed() -> list[Installed]:
    """Return the plug-ins of all groups, each loaded for a try."""
    return [_tried(entry, bring) for group, bring in _BRINGS.items() for entry in entries(group)]


def _tried(entry: EntryPoint, bring: Callable[[EntryPoint], list[str]]) -> Installed:
    known = (entry.group, entry.name, *package_of(entry))
    try:
        return Installed(*known, tuple(bring(entry)))
    except ImumonError as error:
        return Installed(*known, problem=error.seen)


def _columns(entry: EntryPoint) -> list[str]:
    from imumon.stage import STAGE, is_callable, made_by

    return [column.name for column in made_by(load(entry, STAGE, is_callable)).columns]


def _devices(entry: EntryPoint) -> list[str]:
    from imumon.protocols.device import FOLDER, is_folder, load_device

    files = sorted(Path(load(entry, FOLDER, is_folder).offered).glob("*.yaml"))
    return [load_device(str(file)).name for file in files]


def _sensors(entry: EntryPoint) -> list[str]:
    from imumon.effects.offered import EFFECT, guarded, is_effect

    return [*guarded(load(entry, EFFECT, is_effect)).sensors]


def _wing(entry: EntryPoint) -> list[str]:
    from imumon.wings import NEEDED, is_wing

    return [*load(entry, NEEDED, is_wing).offered.commands]


_BRINGS: dict[str, Callable[[EntryPoint], list[str]]] = {
    STAGES: _columns, DEVICES: _devices, EFFECTS: _sensors, WINGS: _wing,
}  # fmt: skip
