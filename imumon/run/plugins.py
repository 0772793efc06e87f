"""The plug-ins that are installed: of which package each is, what it brings, and whether it loads."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path

from imumon.effects.offered import EFFECT, guarded, is_effect
from imumon.errors import ImumonError
from imumon.plugins import DEVICES, EFFECTS, STAGES, entries, load, package_of
from imumon.protocols.device import FOLDER, is_folder, load_device
from imumon.stage import STAGE, is_callable, made_by


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
    return [_tried(entry) for group in (STAGES, DEVICES, EFFECTS) for entry in entries(group)]


def _tried(entry: EntryPoint) -> Installed:
    known = (entry.group, entry.name, *package_of(entry))
    try:
        return Installed(*known, tuple(_brought(entry)))
    except ImumonError as error:
        return Installed(*known, problem=error.seen)


def _brought(entry: EntryPoint) -> list[str]:
    """Return the names of what an entry point brings."""
    if entry.group == STAGES:
        return [column.name for column in made_by(load(entry, STAGE, is_callable)).columns]
    if entry.group == DEVICES:
        files = sorted(Path(load(entry, FOLDER, is_folder).offered).glob("*.yaml"))
        return [load_device(str(file)).name for file in files]
    return [*guarded(load(entry, EFFECT, is_effect)).sensors]
