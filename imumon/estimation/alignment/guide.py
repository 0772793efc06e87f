"""Instructions for the positions of a gyrocompass: rest, turn, rest again, done."""

from __future__ import annotations

import math

from imumon.estimation.alignment.status import Status

LEAST_S, LONGEST_S = 20.0, 300.0
"""Shortest and longest time in a position."""


class Guide:
    """Gives the next instruction to the operator, from the status of the alignment.

    A position is held until its white noise alone allows the wanted sigma.  Two positions are best half a
    turn apart, three a third of a turn, and so on; the gyros measure the actual turn.

    Parameters
    ----------
    positions : int
        Number of positions; with one there are no instructions.
    """

    def __init__(self, positions: int) -> None:
        self.positions = positions
        self.instruction = ""
        """The present instruction."""
        self.done = False
        self._turn_from = 0
        """Number of the position in which the last turn was requested."""

    def update(self, status: Status) -> list[str]:
        """Return a new instruction, if there is one, (0 or 1)."""
        settled, hopeless = status.settled_s is not None, status.hopeless
        if self.positions == 1:
            self.done = settled or hopeless
            return []
        before, turned = self.instruction, math.degrees(status.turned)
        angle = 360.0 / self.positions
        at, last = status.positions, status.positions >= self.positions
        held = status.position_s >= LEAST_S and status.position_sd <= status.wanted_sd
        held |= status.position_s >= LONGEST_S
        if status.phase == "disturbed":
            if self._turn_from >= at and not last:
                self.instruction = (
                    f"turned by {turned:.0f}° so far; stop at about {angle:.0f}° and let it rest"
                )
                before = self.instruction  # shown on the status line only
        elif not last and held:
            self.instruction = f"turn the unit now by about {angle:.0f}° about the vertical"
            self._turn_from = at
        elif last and (settled or hopeless or status.position_s >= LONGEST_S):
            self.instruction, self.done = "done", True
        elif at:
            self.instruction = f"position {at} of {self.positions}: do not touch the unit"
            if at > 1:
                self.instruction += f" (turned by {turned:.1f}°)"
        return [self.instruction] if self.instruction != before else []
