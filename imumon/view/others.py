"""Float columns that no panel draws: a view for each stream and unit, never one for all."""

from __future__ import annotations

import numpy as np
import rerun as rr

from imumon.blocks import ColumnArray
from imumon.charts import AXIS_COLORS, BLUE, GREEN, RED
from imumon.view.axes import Axes
from imumon.view.extent import Extent, Reach, declare_extent
from imumon.view.items import ViewSetup
from imumon.view.layout import OTHER, Rows, read_as
from imumon.view.window import slow_window

DRAWN = "/view/other"
"""Columns that a person reads in another unit."""
PART_COLORS = {**AXIS_COLORS, "roll": RED, "pitch": GREEN, "yaw": BLUE}
"""Colour of a column by how its name ends."""


class Others:
    """Logs such columns, each to an entity of its own, once they have said something.

    Parameters
    ----------
    live : bool
        Whether a person is watching.
    """

    def __init__(self, rec: rr.RecordingStream, setup: ViewSetup, axes: Axes, *, live: bool) -> None:
        self._rec, self._setup, self._axes = rec, setup, axes
        self._window_s = slow_window(setup.window_s) if live else None
        self._extents: dict[str, Extent] = {}
        self._ends: dict[str, tuple[float, float]] = {}

    @property
    def views(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """A title and the entities of each view; the first holds how far the axis reaches."""
        return tuple(
            (title if len(names) > 1 else self._alone(names[0]), tuple(map(self._drawn, names)))
            for title, names in self._together().items()
        )

    def declare(self) -> None:
        """Log what does not change, for a new reader."""
        for name in self._extents:
            self._declare(name)

    def log(self, name: str, values: ColumnArray, rows: Rows) -> None:
        """Log a column; its stream, if any, stands before its name and a slash."""
        numbers = np.asarray(values, np.float64)
        if name not in self._extents:
            if not np.any(np.isfinite(numbers) & (numbers != 0.0)):  # it has not said anything yet
                return
            self._extents[name] = Extent(self._window_s)
            self._declare(name)
        kept = rows.extremes(numbers[:, np.newaxis]) & np.isfinite(numbers)
        if kept.any():
            _, factor = self._read_as(name)
            if factor != 1.0 and not rows.step_ns:
                rows.kept(kept).send(self._rec, path(name), numbers[kept])
            drawn = factor * numbers
            rows.kept(kept).send(self._rec, self._drawn(name), drawn[kept])
            self._log_extent(name, Reach(drawn[:, np.newaxis], np.zeros((len(drawn), 1))), rows)

    def _log_extent(self, name: str, reach: Reach, rows: Rows) -> None:
        together = self._together()
        ends = self._extents[name].ends(rows.clock, reach)
        if ends is None:
            return
        self._ends[name] = ends
        names = together[self._title(name)]
        found = [self._ends[one] for one in names if one in self._ends]
        whole = min(low for low, _ in found), max(high for _, high in found)
        self._axes.set(self._drawn(names[0]), whole, rows.kept(np.array([len(reach.values) - 1])))

    def _together(self) -> dict[str, list[str]]:
        """Return the names in each view, by its title."""
        found: dict[str, list[str]] = {}
        for name in sorted(self._extents):
            found.setdefault(self._title(name), []).append(name)
        return found

    def _read_as(self, name: str) -> tuple[str, float]:
        return read_as(self._setup, name.replace("/", "_"))

    def _drawn(self, name: str) -> str:
        """Return the entity of what is drawn: in another unit than the column, beside the exact one."""
        _, factor = self._read_as(name)
        return path(name) if factor == 1.0 else f"{DRAWN}/{name}"

    def _title(self, name: str) -> str:
        stream, _, _ = name.rpartition("/")
        unit = self._read_as(name)[0] or "no unit"
        return f"{stream}: {unit}" if stream else unit

    def _alone(self, name: str) -> str:
        unit, _ = self._read_as(name)
        return f"{name} [{unit}]" if unit else name

    def _declare(self, name: str) -> None:
        color = PART_COLORS.get(name.rpartition("_")[2])
        look = rr.SeriesLines(names=[name], colors=None if color is None else [list(color)])
        self._rec.log(self._drawn(name), look, static=True)
        declare_extent(self._rec, self._drawn(name))


def path(name: str) -> str:
    """Return the entity of the exact values of a column."""
    return f"{OTHER}/{name}"
