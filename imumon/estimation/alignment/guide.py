"""Guides a person through the positions of a gyrocompass: rest, turn, rest again, done."""

from __future__ import annotations

import math

from imumon.estimation.alignment.status import Status

LEAST_S, LONGEST_S = 20.0, 300.0
"""A position is held at least and at most so long."""


class Guide:
    """Says what to do next, from the status of the alignment.

    A position is held until white noise alone leaves the sigma wanted in it.  Two positions are best half a
    turn apart, three a third of a turn, and so on; the gyros measure what the turn really was.

    Parameters
    ----------
    positions : int
        How many are wanted; with one there is nothing to turn.
    """

    def __init__(self, positions: int) -> None:
        self.positions = positions
        self.order = ""
        """What the person is to do now."""
        self.done = False
        self._told = 0

    def said(self, status: Status) -> list[str]:
        """Return what is new to say."""
        settled, hopeless = status.settled_s is not None, status.hopeless
        if self.positions == 1:
            self.done = settled or hopeless
            return []
        before, turned = self.order, math.degrees(status.turned)
        angle = 360.0 / self.positions
        at, last = status.positions, status.positions >= self.positions
        held = status.position_s >= LEAST_S and status.position_sd <= status.wanted_sd
        held |= status.position_s >= LONGEST_S
        if status.phase == "disturbed":
            if self._told >= at and not last:
                self.order = f"turned by {turned:.0f}° so far; stop at about {angle:.0f}° and let it rest"
                before = self.order  # told on the line, not line by line
        elif not last and held:
            self.order = f"turn the unit now by about {angle:.0f}° about the vertical"
            self._told = at
        elif last and (settled or hopeless or status.position_s >= LONGEST_S):
            self.order, self.done = "done", True
        elif at:
            self.order = f"position {at} of {self.positions}: do not touch the unit"
            if at > 1:
                self.order += f" (turned by {turned:.1f}°)"
        return [self.order] if self.order != before else []
