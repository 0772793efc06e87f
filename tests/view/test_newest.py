from __future__ import annotations

from imumon.view.items import Instant, Log, Numbers, OfUnit, State, ViewSetup
from imumon.view.newest import Newest, states_text

NOW = Instant(None, None, None)


def test_the_newest_state_of_each_lane_and_the_last_lines_are_told() -> None:
    newest = Newest()
    newest.add([State(NOW, "motion", "rest"), State(NOW, "port", "open"), Log(NOW, "one")])
    newest.add([Log(NOW, "two", "WARN"), State(NOW, "motion", "moving"), Numbers(NOW, {}), Log(NOW, "three")])
    assert newest.lines == ["Port open  Motion moving", "three", "WARN two"]


def test_of_several_units_only_ports_and_processes_are_told() -> None:
    newest = Newest()
    unit = ViewSetup("left", "left")
    newest.add([OfUnit(unit, item) for item in (State(NOW, "port", "lost"), State(NOW, "clock", "x"))])
    newest.add([OfUnit(unit, Log(NOW, "gone"))])
    assert newest.lines == ["left port lost", "left gone"]


def test_lanes_stand_in_their_order_under_their_names() -> None:
    assert (
        states_text({"clock": "acquiring", "odd": "x", "port": "open"}) == "Port open  Clock acquiring  odd x"
    )


def test_nothing_is_told_of_nothing() -> None:
    assert Newest().lines == []
