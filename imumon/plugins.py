"""What other packages add to imumon: entry points, by their group."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from imumon.errors import ImumonError, Reason

STAGES = "imumon.stages"
"""Callables without arguments that return a stage (`imumon.pipeline.Estimator`)."""
DEVICES = "imumon.devices"
"""Folders of device files."""
EFFECTS = "imumon.effects"
"""Effects (`imumon.effects.base.Effect`), under the name that they have."""


@cache
def plugins(group: str, needed: str, fits: Callable[[str, Any], bool]) -> dict[str, Any]:
    """Return what installed packages offer in a group, by name.

    Raises BAD_CONFIG when one cannot be imported or is something else, or two have the same name.

    Parameters
    ----------
    needed : str
        What is offered there, in words.
    fits : callable
        Tells of a name and what is offered under it whether it is that.
    """
    found: dict[str, Any] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        package = entry.dist.name if entry.dist is not None else "an unknown package"
        what, hint = f"{entry.name} of {package} ({group})", f"mend or remove it: pip uninstall {package}"
        try:
            offered = entry.load()
        except Exception as error:
            said = f"{what} cannot be imported: {type(error).__name__}: {error}"
            raise ImumonError(Reason.BAD_CONFIG, said, hint) from error
        if not fits(entry.name, offered):
            raise ImumonError(Reason.BAD_CONFIG, f"{what} is no {needed}: {offered!r}", hint)
        if entry.name in found:
            raise ImumonError(Reason.BAD_CONFIG, f"two packages offer {entry.name} as {group}", "remove one")
        found[entry.name] = offered
    return found
