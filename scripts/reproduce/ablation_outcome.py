"""What an ablation measures in one scene."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Outcome:
    """One scene: rms error, error over sigma (rms and largest)."""

    scene: str
    error: float
    floor: float
    """Added to errors before their ratio, in their unit: what is next to nothing."""
    z: float
    largest: float
