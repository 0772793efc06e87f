"""The wings: those of imumon, listed here, and those of other packages, by their entry points."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import resolve_name
from typing import Any

from imumon.wing import Wing

BUILT_IN = (
    "imumon.papers",
    "imumon.lab",
    "imumon.logs",
    "imumon.publishing",
    "imumon.configure",
    "imumon.fleet",
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
    from imumon.plugins import WINGS, plugins  # not for --help: it loads importlib.metadata

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
