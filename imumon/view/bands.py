"""Panels that draw an estimate as a line inside its 2σ band, beside the readings it comes from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr

from imumon.charts import AXIS_COLORS, Color
from imumon.view.items import ViewSetup
from imumon.view.layout import FACTORS, Panel, Rows, Window, last_seconds, series_view, titled

SLOW_WINDOW_S = 600.0
"""What is drawn with a band is slow: so many seconds are shown at least."""
BAND_STEP_NS = 200_000_000
"""Estimates with a band are logged at the most five times a second; a replay gives every value."""
TWO_SIGMA = 4.0
"""Rerun draws a band of one square root of the variance on either side."""


@dataclass(frozen=True, slots=True)
class Band:
    """One estimate: its column, its name in the legend, its colour, the column of its standard deviation.

    Without a standard deviation it is drawn as a line.
    """

    value: str
    name: str
    color: Color
    sd: str | None = None


def with_sd(value: str, name: str, color: Color) -> Band:
    """Return an estimate with its standard deviation: ``_sd`` stands before the axis in its column's name."""
    quantity, _, axis = value.rpartition("_")
    return Band(value, name, color, f"{quantity}_sd_{axis}" if axis in AXIS_COLORS else f"{value}_sd")


def band_panel(
    key: str,
    place: str,
    title: str,
    bands: Sequence[Band],
    unit: str,
    *,
    beside: str | None = None,
    y_range: tuple[float, float] | None = None,
) -> Panel:
    """Return a panel that draws bands over the last ten minutes.

    Parameters
    ----------
    unit : str
        The unit that is drawn, one of `FACTORS`.
    beside : str, optional
        Entity of the readings, drawn in the same view.
    y_range : (low, high), optional
        Fixed range of the y axis; it follows the lines, not their bands, otherwise.
    """
    columns = tuple(name for band in bands for name in (band.value, band.sd) if name is not None)
    exact, drawn, factor = f"/samples/{key}", f"/view/{key}", FACTORS[unit]

    def declare(rec: rr.RecordingStream) -> None:
        rec.log(exact, rr.SeriesLines(names=list(columns)), static=True)
        for band in bands:
            style = rr.Measurements.from_fields(names=[band.name], colors=[list(band.color)], widths=[1.6])
            rec.log(f"{drawn}/{band.name}", style, static=True)

    def log(rec: rr.RecordingStream, rows: Rows) -> None:
        due = rows.thinned(BAND_STEP_NS)
        scalars = rr.Scalars.columns(scalars=rows.matrix(columns)[due])
        rec.send_columns(exact, indexes=rows.kept(due).indexes, columns=scalars)
        for band in bands:
            value = factor * rows.columns[band.value]
            sd = np.zeros_like(value) if band.sd is None else factor * rows.columns[band.sd]
            keep = due & np.isfinite(value) & np.isfinite(sd)
            if keep.any():
                measured = rr.Measurements.columns(values=value[keep], variances=TWO_SIGMA * sd[keep] ** 2)
                rec.send_columns(f"{drawn}/{band.name}", indexes=rows.kept(keep).indexes, columns=measured)

    def view(setup: ViewSetup, window: Window) -> Any:
        if window.ranges is not None:
            window = last_seconds(max(SLOW_WINDOW_S, setup.window_s))
        return series_view(drawn, titled(title, unit), window, y_range, beside)

    return Panel(key, place, columns, declare, log, view)
