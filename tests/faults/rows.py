"""What an attack found, as a row of docs/appendix/reliability-results.md."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """A fault, how often it was tried, what came of it, and whether that is as promised."""

    fault: str
    times: int
    outcome: str
    held: bool = True
