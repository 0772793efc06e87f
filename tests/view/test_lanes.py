"""The lanes of states: order, names and colours."""

from __future__ import annotations

from imumon.lane import Level
from imumon.view.lanes import COLORS, NAMES, lane_path, states_text


def test_the_port_stands_first_and_every_lane_has_a_name_that_people_use_and_a_number_of_its_own() -> None:
    assert lane_path("port") == "/1-Port"
    numbers, names = zip(*(lane_path(lane)[1:].split("-", 1) for lane in NAMES), strict=True)
    assert names == tuple(NAMES.values())
    assert [int(number) for number in numbers] == list(range(1, len(NAMES) + 1))


def test_a_lane_of_somebody_elses_stage_stands_last() -> None:
    assert lane_path("my own") == f"/{len(NAMES) + 1}-my-own"
    assert states_text({"my own": "a", "mark": "b", "port": "c"}) == "Port c  Mark b  my own a"


def test_every_level_has_a_colour_of_its_own() -> None:
    assert set(COLORS) == set(Level)
    assert len(set(COLORS.values())) == len(Level)
