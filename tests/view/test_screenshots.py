"""The pictures of the docs, a few of them: what fails them, and that a real view does not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image
from support.picture_faults import axis_faults, is_empty
from support.screenshots import studio

from imumon.lane import Level
from imumon.view.items import Log, Numbers, State, Status, Timebase, ViewItem, ViewSetup
from imumon.view.logger import StreamLogger
from imumon.view.panels import PANELS
from imumon.view.window import entity
from tests.view.streams import block

SETUP = ViewSetup("synthetic", "synthetic")


def run_of_20_s() -> list[ViewItem]:
    """A temperature rate whose band is wide in the beginning, beside all that the device sends."""
    timebase, items = Timebase(), list[ViewItem]()
    for second in range(20):
        part = block(100 * second, 100)
        rate, sd = np.full(100, 1e-3), np.full(100, 1e-1 if second < 3 else 1e-3)
        found = part.with_columns({"temperature_rate": rate, "temperature_rate_sd": sd})
        items.append(timebase.samples(found))
        at = timebase.at()
        numbers = {"packet_rate": 100.0, "link_load": 0.5, "packets_lost": 0.0, "packets_damaged": 0.0}
        items += [
            State(at, "port", "open", Level.GOOD),
            Log(at, "opened"),
            Status(at, {"device": "none", "packets": "2,000"}),
            Numbers(at, numbers),
        ]
    return items


def logged(path: Path, items: list[ViewItem]) -> rr.RecordingStream:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, SETUP, live=True)
    logger.begin()
    for item in items:
        logger.log([item])
    return rec


def test_the_axes_of_a_run_hold_the_bands(tmp_path: Path) -> None:
    logged(tmp_path / "a.rrd", run_of_20_s()).disconnect()
    assert axis_faults(tmp_path / "a.rrd", PANELS, 600.0) == []


def test_a_cut_off_band_is_found(tmp_path: Path) -> None:
    rec = logged(tmp_path / "a.rrd", run_of_20_s())
    (panel,) = (panel for panel in PANELS if panel.key == "temperature_rate")
    rec.set_time("device_time", duration=1000.0)
    rec.log(entity(panel.drawn), rr.Scalars([3.60000001, 3.60000001]))
    rec.disconnect()
    (band,) = axis_faults(tmp_path / "a.rrd", PANELS, 600.0)
    assert "of its band outside" in band


def test_an_empty_panel_is_one_without_colour_or_letters(tmp_path: Path) -> None:
    series = rrb.TimeSeriesView(origin="/a")
    picture = np.full((200, 400, 3), 13, np.uint8)
    picture[100, ::10] = 120  # a grey grid
    Image.fromarray(picture).save(tmp_path / "a.png")
    assert is_empty(series, tmp_path / "a.png")
    picture[120, 50:150] = (232, 72, 72)
    Image.fromarray(picture).save(tmp_path / "a.png")
    assert not is_empty(series, tmp_path / "a.png")
    assert not is_empty(rrb.TextDocumentView(origin="/a"), tmp_path / "a.png")


@pytest.mark.long
@pytest.mark.viewer
@pytest.mark.usefixtures("vulkan")
def test_a_real_viewer_shows_something_in_every_panel(tmp_path: Path) -> None:
    with studio(settle_s=2.5) as place:
        faults = place.photograph(SETUP, run_of_20_s(), tmp_path, live=True)
    assert faults == []
    assert {path.name for path in tmp_path.iterdir()} == {
        f"synthetic-{tab}.png" for tab in ("live", "temperature", "link")
    }
