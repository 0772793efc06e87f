from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from imumon.fleet.rack import view
from imumon.fleet.rack.feed import OfUnit, Overview, picture
from imumon.fleet.rack.view import UnitsLogger
from imumon.view.blueprint import arranged
from imumon.view.items import (
    DropOldestQueue,
    Instant,
    Log,
    Numbers,
    State,
    Status,
    Timebase,
    ViewItem,
    ViewSetup,
    merge,
)
from tests.view.streams import block
from tests.view.test_blueprint import blueprint_of

AT = Instant(None, None, 5_000_000_000)
WHOLE = ViewSetup("rack bench", "rack")


def of_unit(name: str) -> list[ViewItem]:
    """Return what a unit tells the view, as its process does."""
    timebase = Timebase()
    first = timebase.samples(block(0, 200))
    at = timebase.at(first.times.host_ns[-1].item() if first.times.host_ns is not None else None)
    numbers = Numbers(at, {"packet_rate": 100.0, "packets_lost": 0.0, "packets_damaged": 0.0})
    items: list[ViewItem] = [
        first,
        State(at, "port", "open"),
        Log(at, "a word"),
        Status(at, {"a": "b"}),
        numbers,
    ]
    setup = ViewSetup(name, name)
    return [OfUnit(setup, shown) for item in items if (shown := picture(item)) is not None]


def page(*names: str) -> Overview:
    return Overview(AT, "| unit |\n|--|\n" + "\n".join(f"| {name} |" for name in names), names)


def logged(path: Path, *batches: list[ViewItem]) -> UnitsLogger:
    rec = rr.RecordingStream("imumon", recording_id="rack")
    rec.set_sinks(rr.FileSink(path))
    logger = UnitsLogger(rec, WHOLE)
    logger.begin()
    for batch in batches:
        logger.log(batch)
    logger.finish()
    rec.disconnect()
    return logger


def test_each_unit_has_its_entities_and_a_tab_of_its_own(tmp_path: Path) -> None:
    logger = logged(tmp_path / "a.rrd", [*of_unit("left"), *of_unit("right"), page("left", "right")])
    assert logger.arrangement is not None
    tabs = logger.arrangement.root_container.contents
    assert [tab.name for tab in tabs] == ["Rack", "left", "right"]
    paths = {chunk.entity_path for chunk in RrdReader(str(tmp_path / "a.rrd")).stream()}
    own = {path for path in paths if not path.startswith(("/__", "/overview"))}
    assert {path.split("/")[1] for path in own} == {"left", "right"}
    for path in ("/left/samples/accel", "/left/view/gyro", "/right/1-Port", "/right/log_text", "/overview"):
        assert path in paths, path
    origins = set(map(str, blueprint_of(tmp_path / "a.rrd")["ViewBlueprint:space_origin"]))
    assert {"/overview", "/left/view/gyro", "/right/view/gyro", "/left/samples/accel"} <= origins
    timelines = set(blueprint_of(tmp_path / "a.rrd")["TimePanelBlueprint:timeline"])
    assert timelines == {"host_time"}


def test_a_unit_that_leaves_takes_its_tab_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(view, "ARRANGE_S", 0.0)
    both = [*of_unit("left"), *of_unit("right"), page("left", "right")]
    logger = logged(tmp_path / "a.rrd", both, [page("right")], [page("right"), *of_unit("right")])
    assert logger.arrangement is not None
    assert [tab.name for tab in logger.arrangement.root_container.contents] == ["Rack", "right"]


def test_the_arrangement_is_not_sent_again_while_nothing_is_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view, "ARRANGE_S", 0.0)
    sent: list[str] = []

    def count(tabs: rrb.Tabs, timeline: str) -> rrb.Blueprint:
        sent.append(timeline)
        return arranged(tabs, timeline)

    monkeypatch.setattr(view, "arranged", count)
    later: list[ViewItem] = [page("left")]
    logged(tmp_path / "a.rrd", [*of_unit("left"), page("left")], later, later, later)
    assert sent == ["host_time"]


def test_states_of_each_unit_outlive_a_queue_that_is_full() -> None:
    states = [OfUnit(ViewSetup(name, name), State(AT, "port", "open")) for name in ("left", "right")]
    queue = DropOldestQueue(2 * states[0].nbytes)
    lines = [OfUnit(states[0].setup, Log(AT, str(number))) for number in range(3)]
    for item in (*states, *lines):
        queue.put(item)
    assert queue.take(0.0, 0.0) == [*states, *lines[1:]]
    assert queue.dropped == 1


def test_what_is_of_a_unit_counts_as_what_it_is() -> None:
    samples = next(item for item in of_unit("left") if isinstance(item, OfUnit))
    assert samples.rows == samples.item.rows > 1
    assert samples.nbytes == samples.item.nbytes
    assert page("left").lasting == "overview"
    assert merge([samples, page("left")]) == [samples, page("left")]
