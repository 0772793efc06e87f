"""Small scenarios for the tests: a unit without errors, to which each test adds its own."""

from __future__ import annotations

from typing import Any

from imumon.simulation.unit import Scenario


def scenario(unit: dict[str, Any] | None = None, **changes: Any) -> Scenario:
    """Return a scenario of a unit that has no errors but these, in a room at 20 degC."""
    plain: dict[str, Any] = {
        "format": "imumon-scenario/1",
        "unit": {"thermometer": {"step_degc": 0, "noise_degc": 0}} | (unit or {}),
        "rate_hz": 100,
        "duration_s": 10,
        "latitude_deg": 40.93,
        "chamber": {"start_degc": 20},
    }
    return Scenario.model_validate(plain | changes)
