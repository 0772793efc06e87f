"""How far a vertical axis reaches beyond its lines: over the present bands, and never into rounding.

Rerun's axis follows the lines alone, so that a band is cut off, and it magnifies what is constant until the
rounding fills the panel.  An invisible line beside the drawn ones says what has to be seen now.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import rerun as rr

from imumon.view.rows import Rows

STEP_NS = 1_000_000_000
"""So often the ends are logged anew."""
RECENT_NS = 10 * STEP_NS
"""They reach over the bands of so much time, which breathe with motion; wider ones of before are cut off."""
LATEST_S = 3.0
"""Of the invisible line a live view looks at so much."""


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
        self._recent: dict[str, deque[tuple[int, float, float]]] = {}
        self._rows: dict[str, Rows] = {}

    def set(self, drawn: str, ends: tuple[float, float], row: Rows) -> None:
        """Let the axis of what is drawn reach over these ends, from the time of a row on."""
        now = 0 if row.clock is None else int(row.clock[0])
        recent = self._recent.setdefault(drawn, deque())
        same = bool(recent) and recent[-1][0] // STEP_NS == now // STEP_NS
        before = recent.pop() if same else (now, *ends)
        recent.append((now, min(before[1], ends[0]), max(before[2], ends[1])))
        while abs(now - recent[0][0]) > RECENT_NS:  # or the clock has gone back
            recent.popleft()
        self._rows[drawn] = row
        if self._live and not same:
            self.finish()

    def finish(self) -> None:
        """Log what was not logged."""
        for drawn, row in self._rows.items():
            _, lows, highs = zip(*self._recent[drawn], strict=True)
            row.send(self._rec, entity(drawn), np.array([[min(lows), max(highs)]]))
        self._rows.clear()
