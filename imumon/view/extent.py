"""How far a vertical axis reaches beyond its lines: over the present bands, and never into rounding.

Rerun's axis follows the lines alone, so that a band is cut off, and it magnifies what is constant until the
rounding fills the panel.  An invisible line beside the drawn ones says what has to be seen now.
"""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.view.rows import Rows

STEP_NS = 1_000_000_000
"""So often the ends are logged anew."""
RECENT_S = 10.0
"""They reach over the bands of so much time, which breathe with motion; wider ones of before are cut off."""


def entity(drawn: str) -> str:
    """Return the entity of the invisible line beside what is drawn."""
    return f"{drawn}/extent"


def declare_extent(rec: rr.RecordingStream, drawn: str) -> None:
    """Log that the line is not to be seen."""
    unseen = rr.SeriesLines(names=["", ""], colors=[[0, 0, 0, 0]] * 2, widths=[0.0, 0.0])
    rec.log(entity(drawn), unseen, static=True)


class Extents:
    """Logs the ends of axes: live once a second, a recording at its end.

    On the way they would cost a recording a fifth of its bytes.

    Parameters
    ----------
    live : bool
        Whether a person is watching.
    """

    def __init__(self, rec: rr.RecordingStream, *, live: bool) -> None:
        self._rec, self._live = rec, live
        self._ends: dict[str, tuple[float, float, int, Rows]] = {}
        self._second: int | None = None

    def set(self, drawn: str, ends: tuple[float, float], row: Rows) -> None:
        """Let the axis of what is drawn reach over these ends, from the time of a row on."""
        now = 0 if row.clock is None else int(row.clock[0])
        low, high, before, _ = self._ends.get(drawn, (*ends, now, row))
        if abs(now - before) > 1e9 * RECENT_S:  # or the clock has gone back
            low, high = ends
        self._ends[drawn] = min(low, ends[0]), max(high, ends[1]), now, row
        if self._live and now // STEP_NS != self._second:
            self._second = now // STEP_NS
            self.finish()

    def finish(self) -> None:
        """Log what was not logged."""
        for drawn, (low, high, _, row) in self._ends.items():
            row.send(self._rec, entity(drawn), np.array([[low, high]]))
        self._ends.clear()
