"""Float columns that no panel draws: a view for each stream and unit, never one for all."""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.blocks import ColumnArray
from imumon.charts import AXIS_COLORS, BLUE, GREEN, RED
from imumon.view.items import ViewSetup
from imumon.view.layout import read_as
from imumon.view.rows import Rows

OTHER, CONVERTED = "/samples/other", "/view/other"
"""Entities of columns that are read in their own unit, and in another."""
PART_COLORS = {**AXIS_COLORS, "roll": RED, "pitch": GREEN, "yaw": BLUE}
"""Colour of a column by how its name ends."""


class Others:
    """Logs such columns, each to an entity of its own, once they have a value other than zero."""

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup) -> None:
        self._rec, self._setup = rec, setup
        self._names: set[str] = set()

    @property
    def views(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """A title and the entities of each view; that of one column names it."""
        found: dict[tuple[str, str], list[str]] = {}
        for name in sorted(self._names):
            found.setdefault((name.rpartition("/")[0], self._read_as(name)[0]), []).append(name)
        views = []
        for (stream, unit), names in found.items():
            title = f"{stream}: {unit or 'no unit'}" if stream else unit or "no unit"
            if len(names) == 1:
                title = f"{names[0]} [{unit}]" if unit else names[0]
            views.append((title, tuple(map(self._drawn, names))))
        return tuple(views)

    def declare(self) -> None:
        """Log what does not change, for a new file."""
        for name in self._names:
            self._declare(name)

    def log(self, name: str, values: ColumnArray, rows: Rows) -> None:
        """Log a column; its stream, if any, stands before its name and a slash."""
        numbers = np.asarray(values, np.float64)
        if name not in self._names:
            if not np.any(np.isfinite(numbers) & (numbers != 0.0)):
                return
            self._names.add(name)
            self._declare(name)
        kept = rows.extremes(numbers[:, np.newaxis]) & np.isfinite(numbers)
        if kept.any():
            _, factor = self._read_as(name)
            rows.kept(kept).send(self._rec, self._drawn(name), factor * numbers[kept])

    def _read_as(self, name: str) -> tuple[str, float]:
        return read_as(self._setup, name.replace("/", "_"))

    def _drawn(self, name: str) -> str:
        """Return the entity of a column, by whether it is drawn in its own unit."""
        return f"{OTHER if self._read_as(name)[1] == 1.0 else CONVERTED}/{name}"

    def _declare(self, name: str) -> None:
        color = PART_COLORS.get(name.rpartition("_")[2])
        look = rr.SeriesLines(names=[name], colors=None if color is None else [list(color)])
        self._rec.log(self._drawn(name), look, static=True)
