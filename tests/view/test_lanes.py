"""The lanes of states: order, names and colours."""

from __future__ import annotations

from imumon.lane import Level
from imumon.view.lanes import COLORS, NAMES, lane_path


def test_the_port_stands_first_and_every_lane_has_a_name_that_people_use() -> None:
    paths = sorted(map(lane_path, NAMES))
    assert paths[0] == "/1-Port"
    assert [path.split("-", 1)[1] for path in paths] == list(NAMES.values())


def test_a_lane_of_somebody_elses_stage_stands_last() -> None:
    assert lane_path("my own") == "/9-my-own"
    assert max(map(lane_path, NAMES)).startswith("/9-")


def test_every_level_has_a_colour_of_its_own() -> None:
    assert set(COLORS) == set(Level)
    assert len(set(COLORS.values())) == len(Level)
