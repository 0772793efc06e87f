"""Columns that no panel draws."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from support.picture_faults import scalars, stored

from imumon.blocks import ColumnArray, SampleBlock
from imumon.view.items import Samples, Times, ViewSetup
from imumon.view.logger import StreamLogger

SETUP = ViewSetup("test", "test", units={"supply": "V", "gnss_height": "m", "gnss_depth": "m"})
TIMES = 10_000_000 * np.arange(100, dtype=np.int64)


def views(path: Path, setup: ViewSetup, *streams: tuple[str, Mapping[str, ColumnArray]]) -> dict[str, Any]:
    """Log columns of streams to a recording; return what the views of the tab Other contain, by title."""
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, setup, live=True)
    logger.log(Samples(Times(None, TIMES, None), SampleBlock(columns), stream) for stream, columns in streams)
    logger.finish()
    rec.disconnect()
    arrangement: Any = logger.arrangement
    (tab,) = (part for part in arrangement.root_container.contents if part.name == "Other")
    return {view.name: view.contents for strips in tab.contents for view in strips.contents}


def test_one_view_for_each_stream_and_unit_and_none_of_zeros(tmp_path: Path) -> None:
    five, other = np.full(100, 5.0), "/samples/other"
    gnss = "gnss", {"gnss_height": five, "gnss_depth": five}
    main = "", {"supply": five, "odd": five, "silent": np.zeros(100)}
    assert views(tmp_path / "a.rrd", SETUP, gnss, main) == {
        "gnss: m": [f"{other}/gnss/depth/**", f"{other}/gnss/height"],
        "odd": [f"{other}/odd/**"],
        "supply [V]": [f"{other}/supply/**"],
    }


def test_angles_are_read_in_degrees_here_too_and_kept_exactly(tmp_path: Path) -> None:
    setup = ViewSetup("t", "t", units={"nav_roll": "rad"})
    shown = views(tmp_path / "a.rrd", setup, ("nav", {"nav_roll": np.full(100, 0.5)}))
    assert shown == {"nav/roll [°]": ["/view/other/nav/roll/**"]}
    logged = scalars(stored(tmp_path / "a.rrd"), "/view/other/nav/roll")
    np.testing.assert_allclose(logged[:, 1], np.rad2deg(0.5))


def test_a_column_with_few_values_is_a_line_through_them(tmp_path: Path) -> None:
    sparse = np.where(np.arange(100) % 10 == 3, 1.0, np.nan)
    views(tmp_path / "a.rrd", ViewSetup("t", "t"), ("", {"odd": sparse}))
    assert scalars(stored(tmp_path / "a.rrd"), "/samples/other/odd")[:, 1].tolist() == [1.0] * 10
