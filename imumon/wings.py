"""The wings of imumon, listed here."""

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


@cache
def wings() -> tuple[Wing, ...]:
    """Return the wings, each of which is imported for its object alone."""
    return tuple(import_module(package).WING for package in BUILT_IN)


def offers(hook: str) -> list[Any]:
    """Return what the wings bring under the name of a field of `Wing` that is one place in code."""
    return [resolve_name(place) for wing in wings() if (place := getattr(wing, hook))]


def firmware_of(protocol: str) -> Any:
    """Return what makes a virtual device of this protocol answer commands; None when nothing does."""
    place = next((wing.firmware[protocol] for wing in wings() if protocol in wing.firmware), None)
    return None if place is None else resolve_name(place)
