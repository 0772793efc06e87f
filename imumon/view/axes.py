"""Tells the viewer how far vertical axes reach (`imumon.view.extent`): live now, a recording at its end."""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.view.extent import entity
from imumon.view.layout import Rows


class Axes:
    """Logs the ends of axes.

    A recording shows all of its time, of which the last ends are right; ends on the way would cost a fifth
    of its bytes.

    Parameters
    ----------
    live : bool
        Whether a person is watching.
    """

    def __init__(self, rec: rr.RecordingStream, *, live: bool) -> None:
        self._rec, self._live = rec, live
        self._ends: dict[str, tuple[tuple[float, float], Rows]] = {}

    def set(self, drawn: str, ends: tuple[float, float], row: Rows) -> None:
        """Let the axis of what is drawn end here, from the time of a row on."""
        self._ends[drawn] = ends, row
        if self._live:
            self.finish()

    def finish(self) -> None:
        """Log what was not logged."""
        for drawn, (ends, row) in self._ends.items():
            row.send(self._rec, entity(drawn), np.array([ends]))
        self._ends.clear()
