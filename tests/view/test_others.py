"""Columns that no panel draws."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
from support.picture_faults import scalars, stored

from imumon.view.items import ViewSetup
from imumon.view.panel_log import OTHER, Others
from imumon.view.rows import Rows

SETUP = ViewSetup("test", "test", units={"supply": "V", "gnss_height": "m", "gnss_depth": "m"})


def rows_of(count: int) -> Rows:
    return Rows({}, None, 10_000_000 * np.arange(count, dtype=np.int64), None)


def test_one_view_for_each_stream_and_unit_and_none_of_zeros(tmp_path: Path) -> None:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(tmp_path / "a.rrd"))
    others = Others(rec, SETUP)
    for name in ("supply", "gnss/height", "gnss/depth", "odd"):
        others.log(name, np.full(100, 5.0), rows_of(100))
    others.log("silent", np.zeros(100), rows_of(100))
    rec.disconnect()
    assert dict(others.views) == {
        "gnss: m": (f"{OTHER}/gnss/depth", f"{OTHER}/gnss/height"),
        "odd": (f"{OTHER}/odd",),
        "supply [V]": (f"{OTHER}/supply",),
    }


def test_angles_are_read_in_degrees_here_too_and_kept_exactly(tmp_path: Path) -> None:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(tmp_path / "a.rrd"))
    others = Others(rec, ViewSetup("t", "t", units={"nav_roll": "rad"}))
    others.log("nav/roll", np.full(100, 0.5), rows_of(100))
    rec.disconnect()
    ((title, (drawn,)),) = others.views
    assert title == "nav/roll [°]"
    np.testing.assert_allclose(scalars(stored(tmp_path / "a.rrd"), drawn)[:, 1], np.rad2deg(0.5))
