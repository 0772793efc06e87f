"""How far vertical axes reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from support.picture_faults import scalars, stored

from imumon.blocks import FloatArray
from imumon.view.items import Times
from imumon.view.layout import Bands, Line, Strip
from imumon.view.panels import PANELS
from imumon.view.rows import Rows
from imumon.view.window import Extents, entity

BAND = Bands("b", "B", (Line("b", "b", (1, 2, 3), "b_sd"),), "°C")
STRIP = Strip("s", "S", (Line("b", "b", (1, 2, 3)),), "°C")


def rows_of(values: FloatArray, sd: FloatArray, rate_hz: int = 100) -> Rows:
    times = np.arange(len(values), dtype=np.int64) * (1_000_000_000 // rate_hz)
    return Rows({"b": values, "b_sd": sd}, Times(None, times, None))


def test_an_axis_reaches_over_the_bands_of_the_last_ten_seconds_alone() -> None:
    sd = np.where(np.arange(3000) < 1500, 100.0, 1.0)
    sd[2500] = 3.0
    assert BAND.ends(rows_of(np.zeros(3000), sd)) == (-6.0, 6.0)


@pytest.mark.parametrize("value", [0.0, 25.0, -25.0])
def test_the_last_digit_of_a_card_does_not_fill_a_panel(value: float) -> None:
    ends = STRIP.ends(rows_of(value + np.linspace(0.0, 1e-12, 50), np.ones(50)))
    assert ends is not None
    low, high = ends
    assert low < value < high
    assert high - low == pytest.approx(0.04)


@pytest.mark.parametrize("key", ["temperature", "temperature_axes"])
def test_the_rounding_of_a_temperature_that_is_constant_does_not_fill_a_panel(key: str) -> None:
    (panel,) = (panel for panel in PANELS if panel.key == key and isinstance(panel, Strip))
    columns = {line.column: 25.0 + np.linspace(0.0, 1e-6, 50) for line in panel.lines}
    ends = panel.ends(Rows(columns, Times(None, np.arange(50, dtype=np.int64), None)))
    assert ends is not None
    assert ends[1] - ends[0] == pytest.approx(0.04)


def test_without_a_value_there_are_no_ends() -> None:
    assert BAND.ends(rows_of(np.full(50, np.nan), np.ones(50))) is None
    assert BAND.ends(rows_of(np.zeros(50), np.full(50, np.inf))) is None


@pytest.mark.parametrize("live", [True, False])
def test_live_they_are_logged_once_a_second_and_a_recording_has_the_last(tmp_path: Path, live: bool) -> None:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(tmp_path / "a.rrd"))
    extents = Extents(rec, live=live)
    for tenth in range(300):
        row = Rows({}, Times(None, np.array([tenth * 100_000_000]), None))
        extents.set("/view/b", (-1.0 - (tenth == 250), 1.0), row)
    extents.finish()
    rec.disconnect()
    logged = scalars(stored(tmp_path / "a.rrd"), entity("/view/b"))
    assert len(logged) == (31 if live else 1)
    assert logged[-10:, 1:].min(axis=0).tolist() == [-2.0, 1.0]
