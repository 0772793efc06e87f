"""What panels log."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
import rerun as rr

from imumon.view.items import Times, ViewSetup
from imumon.view.layout import Bands, Line, Strip
from imumon.view.panels import ShownPanels
from imumon.view.rows import Rows


class _Heard:
    """A recording that keeps the entities logged to it."""

    def __init__(self) -> None:
        self.entities: list[str] = []
        self.looks: list[object] = []

    def log(self, entity: str, *looks: object, **__: object) -> None:
        self.entities.append(entity)
        self.looks += looks

    send_columns = log


def test_a_band_named_as_a_session_is_an_entity_whose_name_is_escaped() -> None:
    rec: Any = _Heard()
    panel = Bands("a/b", "title", (Line("x", "run of monday", (1, 2, 3)),), "°/h", "Tab")
    panel.declare(rec)
    times = np.arange(3) * 10**9
    panel.log(rec, Rows({"x": np.ones(3)}, Times(None, times, times)))
    named = [one for one in rec.entities if "monday" in one]
    assert named == [f"{panel.drawn}/" + rr.escape_entity_path_part("run of monday")] * 2
    assert "\\ " in named[0]


@pytest.mark.parametrize("look", ["lines", "steps"])
def test_spikes_stay_where_samples_are_denser_than_pixels(look: Literal["lines", "steps"]) -> None:
    rec: Any = _Heard()
    Strip("a", "title", (Line("x", "x", (1, 2, 3)),), look=look).declare(rec)
    (drawn, *_) = rec.looks
    policies = drawn.aggregation_policy.as_arrow_array().to_pylist()
    assert policies == [rr.components.AggregationPolicy.MinMax.value]


@pytest.mark.parametrize(
    ("columns", "drawn"),
    [
        (["roll", "pitch"], {"Alignment"}),
        (["roll", "pitch", "yaw"], {"scene", "Attitude"}),
        (["roll", "pitch", "yaw", "aligned_roll", "aligned_pitch"], {"scene", "Attitude", "Alignment"}),
    ],
)
def test_roll_and_pitch_of_the_alignment_stand_in_its_tab(columns: list[str], drawn: set[str]) -> None:
    times = np.arange(3) * 10**9
    rows = Rows({name: np.ones(3) for name in columns}, Times(None, times, None))
    shown = [panel.place for panel, _ in ShownPanels(ViewSetup("t", "t")).take(rows)]
    assert set(shown) == drawn
    assert len(shown) == len(drawn)
