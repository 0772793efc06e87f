"""The lanes of states: order, names and colours."""

from __future__ import annotations

from imumon.view.lanes import BAD, GOOD, NAMES, PLAIN, WAIT, lane_path, state_color


def test_state_colours_follow_the_first_word() -> None:
    assert state_color("OPEN") == GOOD
    assert state_color("waiting for data") == WAIT
    assert state_color("segment 3") == PLAIN
    assert state_color("MODEL OK") == GOOD
    assert state_color("MODEL SUSPECT: the bias follows dT/dt, ok otherwise") == BAD
    assert state_color("MODEL CAN BE BETTER: thermal_lag on x: 100 become 10 °/h") == WAIT
    assert state_color("not valid") == PLAIN


def test_the_port_stands_first_and_every_lane_has_a_name_that_people_use() -> None:
    paths = sorted(map(lane_path, NAMES))
    assert paths[0] == "/1-Port"
    assert [path.split("-", 1)[1] for path in paths] == list(NAMES.values())


def test_a_lane_of_somebody_elses_stage_stands_last() -> None:
    assert lane_path("my own") == "/9-my-own"
    assert max(map(lane_path, NAMES)).startswith("/9-")
