"""The catalog in Rerun: a table of the units, and the drift of each over months."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.fleet.catalog.drift import Drift, drifts
from imumon.fleet.catalog.units import Unit
from imumon.harmless import for_html
from imumon.lab.diagnosis.figures import shown

DAY_NS = 86_400_000_000_000
TIMELINE = "data_of_model"
COLORS = [[232, 72, 72], [40, 165, 85], [66, 133, 244]]


def write_recording(
    units: Sequence[Unit], heads: Sequence[str], rows: Sequence[Sequence[str]], path: Path
) -> None:
    """Write NAME.rrd, which the viewer opens.

    Parameters
    ----------
    heads, rows : sequence
        The table of the units, as text.
    """
    factor, unit_text = shown("rad/s")
    rec = rr.RecordingStream("imumon_catalog")
    drifting = {unit.name: found for unit in units if (found := drifts(unit))}
    views = [_view(name, f"{name} [{unit_text}]", found) for name, found in drifting.items()]
    table = rrb.TextDocumentView(origin="/units", name="Units")
    rec.save(
        path, rrb.Blueprint(rrb.Vertical(table, rrb.Grid(*views)) if views else table, collapse_panels=True)
    )
    lines = ["| " + " | ".join(map(_cell, cells)) + " |" for cells in (heads, ["---"] * len(heads), *rows)]
    rec.log("/units", rr.TextDocument("\n".join(lines), media_type="text/markdown"), static=True)
    for name, found in drifting.items():
        for drift, color in zip(found, COLORS, strict=True):
            entity = f"{_entity(name)}/{drift.channel}"
            text = f"{drift.channel} at {drift.at_degc:.0f} °C"
            rec.log(
                entity,
                rr.SeriesLines(names=text, colors=color),
                rr.SeriesPoints(names=text, colors=color),
                static=True,
            )
            when = rr.TimeColumn(TIMELINE, timestamp=drift.time_ns.astype("datetime64[ns]"))
            rec.send_columns(
                entity, indexes=[when], columns=rr.Scalars.columns(scalars=np.asarray(factor * drift.bias))
            )
    rec.flush()
    rec.disconnect()


def _view(unit: str, title: str, found: Sequence[Drift]) -> rrb.TimeSeriesView:
    """Return a chart over the time of all models, with a tenth of it on either side."""
    first, last = found[0].time_ns[0], found[0].time_ns[-1]
    margin = max((last - first) // 10, DAY_NS)
    ends = [rrb.TimeRangeBoundary.absolute(nanos=int(at)) for at in (first - margin, last + margin)]
    shown_range = rr.TimeRange(start=ends[0], end=ends[1])
    return rrb.TimeSeriesView(
        origin=_entity(unit),
        name=title,
        axis_x=rrb.TimeAxis(view_range=shown_range),
        time_ranges=rrb.VisibleTimeRange(TIMELINE, start=ends[0], end=ends[1]),
    )


def _entity(unit: str) -> str:
    return "/drift/" + rr.escape_entity_path_part(unit)


def _cell(text: str) -> str:
    return str(for_html(text)).replace("|", "\\|")
