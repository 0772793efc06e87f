"""Sessions for batches: small ones, as many as are needed."""

from __future__ import annotations

from pathlib import Path

from imumon.protocols.device import device_text, parse_device
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario


def tiny(
    folder: Path, seconds: float = 0.5, seed: int = 0, scenario: str = "bench", rate_hz: float | None = None
) -> Path:
    """Make a session of a simulated unit; return its folder."""
    text, source = device_text("ax1")
    known = parse_device(text, source)
    plan = load_scenario(scenario).model_copy(update={"duration_s": seconds})
    record_session(
        plan.played(rate_hz or plan.rate_hz, known.axes), known, text, seed, folder, lambda _: None
    )
    return folder
