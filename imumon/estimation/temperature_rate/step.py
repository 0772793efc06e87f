"""The quantization step of a sensor, found from how its readings differ."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

TINY = 1e-6
"""°C; two readings closer than this are the same, and no step is smaller."""
SUPPORT_NEEDED, CHANGES_NEEDED = 8, 100
"""Changes after which a step is known; and after which it is known that there is none."""
MISFIT_ALLOWED = 0.2
ROUNDED = 0.2
"""Steps of 0.0625 °C written with two digits change by 0.06 or 0.07 °C: off by a sixth."""
FAR_STEPS = 8.5
"""Changes of more steps than this tell nothing: rounding of the step would make any of them a multiple."""
MEMORY = 1.0 / 32.0
FIRST_STEP = 0.1
"""Step assumed before one is seen, when none is declared, °C."""
COARSEST = 1.0
"""°C; as long as a reading has never changed, its steps may be those of the coarsest thermometers.  A first
change by more than two of these is none: a fault of the sensor."""
FINEST_STEP = 1e-4
"""°C; finer steps are none."""


@dataclass(slots=True)
class StepFinder:
    """Finds the step of one sensor and says when it is not the declared one."""

    declared: float | None = None
    """The step in °C that the sensor is said to have."""
    size: float = FIRST_STEP
    """The step as far as it is known, °C."""
    support: int = 0
    seen: int = 0
    """Changes that are multiples of it, and all since it was first seen."""
    misfit: float = 0.0
    """Share of changes that are no multiples of it."""

    def __post_init__(self) -> None:
        """Begin with the declared step."""
        if self.declared is not None:
            if not self.declared > TINY:
                raise ValueError(f"a step of {self.declared} °C")
            self.size = self.declared

    @property
    def step(self) -> float | None:
        """The step in °C, None as long as the readings show none."""
        known = self.support >= SUPPORT_NEEDED and self.misfit < MISFIT_ALLOWED
        return self.size if known and self.size >= FINEST_STEP else None

    @property
    def unseen(self) -> bool:
        """Whether nothing is known of the step, neither said nor seen."""
        return self.declared is None and self.seen == 0

    @property
    def stepless(self) -> bool:
        """Whether enough changes were seen and are not multiples of any step."""
        return self.size < FINEST_STEP or (self.seen > 2 * SUPPORT_NEEDED and self.step is None)

    def learn(self, changes: Iterable[float]) -> None:
        """Learn from differences of readings: the step is the least, of which the others are multiples."""
        for difference in changes:
            change = abs(difference)
            if not change > TINY or (self.support == 0 and change > 2.0 * COARSEST):
                continue
            self.seen += 1
            ratio = change / self.size
            if self.support == 0 or ratio < 0.75:
                # A declared or assumed step gives way to the first change; a larger one to a smaller.
                self.size, self.misfit, self.support, self.seen = change, 0.0, 1, 1
            elif ratio <= FAR_STEPS:
                whole = round(ratio)
                if abs(ratio - whole) < ROUNDED:
                    self.support += 1
                    self.misfit -= MEMORY * self.misfit
                    if whole == 1:
                        self.size += (change - self.size) / min(self.support, 64)
                else:
                    self.misfit += MEMORY * (1.0 - self.misfit)

    def contradiction(self) -> str | None:
        """Return what the readings show instead of the declared step, or None."""
        if self.declared is None:
            return None
        if self.step is not None and abs(self.step / self.declared - 1.0) > MISFIT_ALLOWED:
            return f"the readings change in steps of {self.step:.4g} °C, not of {self.declared:.4g} °C"
        if self.step is None and self.seen >= CHANGES_NEEDED:
            return f"the readings do not change in steps of {self.declared:.4g} °C, nor in any other"
        return None
