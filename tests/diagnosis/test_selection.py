"""Which effects stand in a set: what one axis says, and what all of them say together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from imumon.diagnosis.candidates import Candidate, Part
from imumon.diagnosis.gains import Leader, Scored, Table
from imumon.diagnosis.selection import Finding, Search
from imumon.effects.library import EFFECTS

FLOOR_SD = 1.0
GAINS = {"thermal_lag": 35.0, "dead_time": 34.0, "temperature_rate": 33.0, "hysteresis": 21.0}
PARAMETERS: dict[str, dict[str, float]] = {
    "thermal_lag": {"time_constant_s": 200.0, "middle": 25.0, "half_span": 15.0},
    "dead_time": {"delay_s": 150.0, "middle": 25.0, "half_span": 15.0},
    "hysteresis": {"half_width": 3.0, "middle": 25.0, "half_span": 15.0},
    "temperature_rate": {},
}


def leader(name: str) -> Leader:
    effect = EFFECTS[name].model_validate(PARAMETERS[name])
    gain = GAINS[name]
    return Leader(Scored(Candidate(name, (Part(effect),)), gain, gain, (0.0, 0.0)), gain)


@pytest.mark.parametrize(
    ("pooled", "alike"),
    [
        # One axis alone: the loop is 14 behind the lag, which is more than an accident.
        ({}, ["thermal_lag", "dead_time", "temperature_rate"]),
        # Together the axes see no difference between lag and loop, but they see no rate.
        ({"thermal_lag": 86.0, "hysteresis": 84.0, "dead_time": 83.0, "temperature_rate": 30.0},
         ["thermal_lag", "hysteresis", "dead_time"]),
        # Together they see that it is no loop.
        ({"thermal_lag": 120.0, "hysteresis": 84.0, "dead_time": 115.0, "temperature_rate": 30.0},
         ["thermal_lag", "dead_time"]),
    ],
)  # fmt: skip
def test_what_the_axes_leave_open_together_one_of_them_does_not_settle(
    pooled: dict[str, float], alike: list[str]
) -> None:
    leaders = {name: leader(name) for name in GAINS}
    table = Table([one.scored for one in leaders.values()], len(leaders), leaders)
    axis = cast(Any, SimpleNamespace(channel=SimpleNamespace(floor=SimpleNamespace(sd=FLOOR_SD))))
    assert Search._alike(axis, leaders["thermal_lag"], table, pooled, FLOOR_SD) == alike


class _Exchanging(Search):
    """Takes another effect in place of one that was kept, as `tidy` may."""

    def __init__(self) -> None:
        self.turns, self.tried, self.many_events = [], [], True

    def tidy(self) -> None:
        self.findings[0].candidate = leader("hysteresis").scored.candidate


def test_another_look_after_the_test_refuted_something_changes_no_finding_of_the_verdict_before() -> None:
    kept = Finding(leader("thermal_lag").scored.candidate, 35.0, 35.0, {}, [], 1.0)
    search = _Exchanging()
    search.resume([kept], ["temperature_curve"])
    assert [one.name for one in search.findings] == ["hysteresis"]
    assert kept.name == "thermal_lag"
