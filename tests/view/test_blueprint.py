from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from imumon.papers.stages import published_stages
from imumon.protocols.device import load_device
from imumon.run import PUBLISHED, PublishedMethod
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.view.blueprint import Contents, blueprint
from imumon.view.items import Log, Numbers, State, Status, Timebase, ViewItem, ViewSetup
from imumon.view.layout import STRIPS
from imumon.view.logger import StreamLogger
from imumon.view.panels import PANELS
from tests.view.streams import block

ALIGNMENT, RESIDUAL = "Alignment", "Residual"


def blueprint_of(path: Path) -> dict[str, list[object]]:
    """Return all values of all components of the one blueprint in a recording."""
    reader = RrdReader(str(path))
    (store,) = reader.blueprints()
    values: dict[str, list[object]] = {}
    for chunk in reader.stream(store=store):
        batch = chunk.to_record_batch()
        for name in (name for name in batch.schema.names if ":" in name):
            for row in batch.column(name).to_pylist():
                values.setdefault(name, []).extend(row if isinstance(row, list) else [row])
    return values


def arranged(path: Path, items: list[ViewItem], setup: ViewSetup, *, live: bool) -> dict[str, list[object]]:
    """Log items and return the blueprint that was sent with them."""
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, setup, live=live)
    logger.begin()
    logger.log(items)
    rec.disconnect()
    return blueprint_of(path)


def everything(leave_out: tuple[str, ...] = ("nothing",)) -> list[ViewItem]:
    timebase = Timebase()
    first = timebase.samples(block(0, 50, leave_out=leave_out))
    at = timebase.at()
    numbers = {"packet_rate": 100.0, "link_load": 0.1, "packets_lost": 0.0, "packets_damaged": 0.0}
    return [first, State(at, "port", "open"), Log(at, "a"), Status(at, {"a": "b"}), Numbers(at, numbers)]


SETUP = ViewSetup("test", "test")


def test_every_panel_with_data_has_a_view(tmp_path: Path) -> None:
    views = arranged(tmp_path / "a.rrd", everything(), SETUP, live=True)["ViewBlueprint:space_origin"]
    assert sorted(map(str, views)) == sorted(
        [
            "/attitude",
            "/view/gyro",
            "/samples/accel",
            "/samples/mag",
            "/samples/temperature",
            "/view/packet_rate",
            "/view/link_load",
            "/samples/losses",
            "/",
            "/cards/Live",
            "/cards/Link",
            "/log_text",
            "/status",
        ]
    )


@pytest.mark.parametrize(("charts", "columns"), [(1, 1), (2, 1), (3, 2), (4, 2)])
def test_charts_beside_strips_have_two_columns_before_they_are_too_small(charts: int, columns: int) -> None:
    strips = tuple(panel for panel in PANELS if panel.place == RESIDUAL)
    drawn = tuple((RESIDUAL, f"chart {number}", "title") for number in range(charts))
    contents = Contents(strips, drawn, (), False, False, False)
    root: Any = blueprint(SETUP, contents, "device_time", live=True).root_container
    (tab,) = (part for part in root.contents if part.name == RESIDUAL)
    beside = tab.contents[-1] if columns == 1 else tab.contents[-1].contents[-1]
    assert len(beside.contents) == charts
    assert (beside.grid_columns or 1) == columns
    assert (tab.column_shares[-1] > sum(tab.column_shares[:-1])) == (columns == 2), "half of the tab, or more"


@pytest.mark.parametrize(
    ("count", "window_s", "columns"),
    [(2, 30.0, 1), (3, 30.0, 1), (4, 30.0, 2), (4, 600.0, 1), (4, None, 1), (5, None, 2)],
)
def test_strips_have_two_columns_before_their_axes_lack_numbers(
    count: int, window_s: float | None, columns: int
) -> None:
    setup = ViewSetup("test", "test", window_s=window_s or 30.0)
    strips = tuple(panel for panel in PANELS if panel.place == STRIPS)[:count]
    assert len(strips) == count
    contents = Contents(strips, (), (), False, False, False)
    root: Any = blueprint(setup, contents, "device_time", live=window_s is not None).root_container
    beside = root.contents[0].contents[-1]
    assert (getattr(beside, "grid_columns", None) or 1) == columns


def test_four_strips_beside_a_chart_have_the_width_for_their_time_axes() -> None:
    strips = tuple(panel for panel in PANELS if panel.place == ALIGNMENT)[:4]
    contents = Contents(strips, ((ALIGNMENT, "a", "title"),), (), False, False, False)
    root: Any = blueprint(SETUP, contents, "device_time", live=True).root_container
    (tab,) = (part for part in root.contents if part.name == ALIGNMENT)
    grid, beside = tab.contents
    assert grid.grid_columns == 2
    assert tab.column_shares[0] > 2 * tab.column_shares[1]
    assert [type(view) for view in beside.contents] == [rrb.TextDocumentView, rrb.Spatial2DView]


@pytest.mark.parametrize(
    ("column", "origin"),
    [("mag", "/samples/mag"), ("temperature", "/samples/temperature"), ("q_", "/attitude")],
)
def test_what_a_device_does_not_send_has_no_view(tmp_path: Path, column: str, origin: str) -> None:
    found = arranged(tmp_path / "a.rrd", everything((column,)), SETUP, live=True)
    assert origin not in found["ViewBlueprint:space_origin"]
    assert "/view/gyro" in found["ViewBlueprint:space_origin"]


def test_titles_carry_units_and_the_colours_of_the_lines(tmp_path: Path) -> None:
    setup = ViewSetup("test", "test", units={"mag_x": "arbitrary"})
    names = arranged(tmp_path / "a.rrd", everything(), setup, live=True)["ViewBlueprint:display_name"]
    axes = ": x red, y green, z blue"
    assert {f"Angular rate [°/s]{axes}", f"Magnetic field [a.u.]{axes}", "Link load [%]"} <= set(names)


def test_live_view_follows_device_time_and_shows_the_last_seconds(tmp_path: Path) -> None:
    setup = ViewSetup("test", "test", window_s=20.0)
    timebase = Timebase()
    found = arranged(tmp_path / "a.rrd", [timebase.samples(block(0, 50))], setup, live=True)
    assert found["TimePanelBlueprint:timeline"] == ["device_time"]
    assert "-20000000000" in str(found["VisibleTimeRanges:ranges"])


def test_slow_tabs_show_the_time_since_the_start_and_later_ten_minutes(tmp_path: Path) -> None:
    items: list[ViewItem] = []
    timebase = Timebase()
    for first in (0, 70_000):  # at 100 Hz
        part = block(first, 50)
        columns = dict.fromkeys(("temperature_rate", "temperature_rate_sd"), part["temperature"])
        items.append(timebase.samples(part.with_columns(columns)))
    early = arranged(tmp_path / "early.rrd", items[:1], SETUP, live=True)
    late = arranged(tmp_path / "late.rrd", items, SETUP, live=True)
    assert "-600000000000" not in str(early["VisibleTimeRanges:ranges"])
    assert "-600000000000" in str(late["VisibleTimeRanges:ranges"])


def test_columns_of_different_units_stand_in_different_views(tmp_path: Path) -> None:
    plain = block(0, 50)
    setup = ViewSetup("test", "test", units={"supply": "V"})
    extra = plain.with_columns({"humidity": plain["temperature"], "supply": plain["temperature"]})
    found = arranged(tmp_path / "a.rrd", [Timebase().samples(extra)], setup, live=True)
    assert {"supply [V]", "humidity"} <= set(map(str, found["ViewBlueprint:display_name"]))


def test_recording_shows_everything(tmp_path: Path) -> None:
    found = arranged(tmp_path / "a.rrd", everything(), SETUP, live=False)
    assert "VisibleTimeRanges:ranges" not in found
    assert "TimeAxis:view_range" in found


def test_columns_without_a_panel_have_a_tab(tmp_path: Path) -> None:
    extra = block(0, 50).with_columns({"humidity": block(0, 50)["temperature"]})
    found = arranged(tmp_path / "a.rrd", [Timebase().samples(extra)], SETUP, live=True)
    assert "/samples/other/humidity" in found["ViewBlueprint:space_origin"]
    assert "Other" in found["ContainerBlueprint:display_name"]


@pytest.mark.parametrize("method", PUBLISHED)
def test_every_published_method_is_drawn_in_a_tab_of_its_own(tmp_path: Path, method: PublishedMethod) -> None:
    plain = block(0, 50)
    stages = published_stages(Setup(latitude_deg=45.0, published=[method]), None, ())
    for stage in stages:
        stage.process(plain)
    extra = {column.name: np.full(50, 1e-3) for stage in stages for column in stage.columns}
    found = arranged(tmp_path / "a.rrd", [Timebase().samples(plain.with_columns(extra))], SETUP, live=True)
    assert "Published" in found["ContainerBlueprint:display_name"]
    assert "Other" not in found["ContainerBlueprint:display_name"]


def test_all_that_the_estimators_say_has_a_panel(tmp_path: Path) -> None:
    stages = estimators(load_device("ax1"), Setup(latitude_deg=40.0))
    extra = {
        column.name: np.full(50, 1e-3)
        for stage in stages
        for column in stage.columns
        if column.dtype == "float64"
    }
    found = arranged(
        tmp_path / "a.rrd", [Timebase().samples(block(0, 50).with_columns(extra))], SETUP, live=True
    )
    assert "/view/heading" in found["ViewBlueprint:space_origin"]
    assert "Other" not in found["ContainerBlueprint:display_name"]
