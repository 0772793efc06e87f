"""Charts as pictures: that they are drawn, and what is on them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from PIL import Image
from rerun.chunk import RrdReader

from imumon.blocks import FloatArray
from imumon.charts import GREEN, Axis, Chart, Color, Curve
from imumon.view.items import Drawing, Instant, ViewSetup
from imumon.view.logger import StreamLogger
from imumon.view.pictures import picture

RED: Color = (232, 72, 72)


def _chart(y: list[float], log: bool = True, **more: object) -> Chart:
    x = np.array([0.1, 1.0, 10.0, 100.0][: len(y)])
    curves = (Curve("gyro x", x, np.array(y), RED, width=4.0),)
    axes = Axis("tau [s]", log), Axis("deviation", log)
    return Chart("allan", "Noise", "Allan deviation", *axes, curves, **more)  # type: ignore[arg-type]


def _pixels(chart: Chart) -> Any:
    with Image.open(io.BytesIO(picture(chart))) as image:
        return np.asarray(image.convert("RGB"), np.float64)


def _ink(pixels: Any) -> float:
    """Return how many pixels of the upper part are bright."""
    return float(np.count_nonzero(pixels[:90].max(axis=2) > 150.0))


def _drawn(chart: Chart, color: Color) -> FloatArray:
    """Return rows and columns of the pixels of a colour, (n, 2)."""
    distance: Any = np.abs(_pixels(chart) - np.array(color))
    near = distance.max(axis=2) < 40
    return np.argwhere(near).astype(np.float64)


def test_a_straight_line_on_logarithmic_axes_falls_from_left_to_right() -> None:
    found = _drawn(_chart([1000.0, 100.0, 10.0, 1.0]), RED)
    line = found[found[:, 1] < 700]  # left of the sample in the legend
    correlation: Any = np.corrcoef(line.T)
    slope = correlation[0, 1]
    assert slope > 0.999


@pytest.mark.parametrize("values", [[0.0, -1.0], [np.nan, np.nan], [5.0, 5.0], [1e-30, 1e30], [3.0]])
@pytest.mark.parametrize("log", [True, False])
def test_whatever_the_values_there_is_a_picture(values: list[float], log: bool) -> None:
    assert _pixels(_chart(values, log)).std() > 1.0


def test_a_line_is_interrupted_where_it_has_no_value() -> None:
    whole, cut = _drawn(_chart([1.0, 2.0, 3.0, 4.0]), RED), _drawn(_chart([1.0, 2.0, np.nan, 4.0]), RED)
    assert len(cut) < 0.7 * len(whole)


def test_headline_and_notes_take_room_above_the_axes() -> None:
    plain = _pixels(_chart([1.0, 2.0]))
    told = _pixels(_chart([1.0, 2.0], headline="30.00° ± 0.01°", notes=("a", "b")))
    assert _ink(told) > _ink(plain) + 500.0


def test_a_short_recording_has_the_last_picture_only(tmp_path: Path) -> None:
    path = tmp_path / "chart.rrd"
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, ViewSetup("test", "test"), live=False)
    logger.begin()
    charts = [_chart([1.0, float(number)]) for number in range(1, 20)]
    for number, chart in enumerate(charts):
        logger.log([Drawing(Instant(number, None, None), chart)])
    logger.finish()
    rec.disconnect()
    chunks = list(RrdReader(str(path)).stream().filter(content=["/charts/allan"]))
    assert all(chunk.is_static for chunk in chunks)
    blobs = [
        part
        for batch in (chunk.to_record_batch() for chunk in chunks)
        for name in batch.schema.names
        if name.endswith(":blob")
        for part in batch.column(name).to_pylist()
    ]
    assert len(blobs) == 1
    assert bytes(blobs[-1][0]) == picture(charts[-1])


def test_a_later_chart_replaces_an_earlier_one_in_a_queue_that_knows_its_size() -> None:
    drawing = Drawing(Instant(None, None, None), _chart([1.0, 2.0]))
    assert drawing.lasting == "chart allan"
    assert drawing.nbytes > 4 * 8


def test_points_are_drawn_as_points() -> None:
    x = np.linspace(0.0, 1.0, 5)
    curve = Curve("now", x, x, GREEN, points=True, width=9.0, listed=False)
    found = _drawn(Chart("a", "b", "c", Axis("x"), Axis("y"), (curve,)), GREEN)
    assert 5 * 60 < len(found) < 5 * 400


@pytest.mark.parametrize("letters", [69, 75, 86, 88, 120])
def test_a_long_line_of_notes_ends_before_the_edge(letters: int) -> None:
    pixels = _pixels(_chart([1.0, 2.0], notes=("W" * letters,)))
    assert _ink(pixels[:, :-8]) > 500.0
    assert _ink(pixels[:, -8:]) == 0.0


@pytest.mark.parametrize("more", [{"notes": ("a note",) * 30}, {"notes": ("",)}, {"headline": "W" * 300}])
def test_however_much_is_written_there_is_a_picture(more: dict[str, Any]) -> None:
    assert _pixels(_chart([1.0, 2.0], **more)).std() > 1.0


def test_a_long_name_in_the_legend_leaves_room_for_the_curve() -> None:
    x = np.array([1.0, 2.0])
    curve = Curve("W" * 90, x, x, GREEN, width=4.0)
    assert len(_drawn(Chart("a", "b", "c", Axis("x"), Axis("y"), (curve,)), GREEN)) > 1000
