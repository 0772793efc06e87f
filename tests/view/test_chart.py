from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from imumon.charts import Axis, Chart, Curve
from imumon.view.chart import HEIGHT, WIDTH, scale
from imumon.view.items import Drawing, Instant, ViewSetup, item_bytes, lasting_key
from imumon.view.logger import StreamLogger
from tests.view.streams import record_batches

RED = (200, 0, 0)


def _chart(y: list[float], log: bool = True) -> Chart:
    x = np.array([0.1, 1.0, 10.0, 100.0][: len(y)])
    axis = Axis("tau [s]", log)
    return Chart(
        "allan",
        "Noise",
        "Allan deviation",
        axis,
        Axis("deviation", log),
        (Curve("gyro x", x, np.array(y), RED),),
    )


@pytest.mark.parametrize("values", [[0.3, 42.0], [5.0, 5.0], [1e-3, 1e2]])
def test_logarithmic_marks_are_whole_decades_around_the_data(values: list[float]) -> None:
    found = scale(Axis("", log=True), np.array(values))
    marks = [float(text) for _, text in found.ticks()]
    assert marks == sorted(marks)
    assert marks[0] <= min(values)
    assert 2 <= len(marks) <= 8
    assert np.allclose(np.log10(marks), np.rint(np.log10(marks)))
    np.testing.assert_allclose(found.place(np.array(marks)), [at for at, _ in found.ticks()], atol=1e-12)


@pytest.mark.parametrize("values", [[-20.5, 48.1], [3.0, 3.0], [0.0], [-1e-7, 2e-7], [np.nan, 4.0]])
def test_linear_marks_are_round_and_within_the_axis(values: list[float]) -> None:
    found = scale(Axis(""), np.array(values))
    places = [at for at, _ in found.ticks()]
    assert len(places) >= 2
    assert all(-1e-9 <= at <= 1 + 1e-9 for at in places)
    inside = found.place(np.array(values))
    assert np.nanmin(inside) >= 0
    assert np.nanmax(inside) <= 1


def test_what_has_no_logarithm_is_not_drawn() -> None:
    found = scale(Axis("", log=True), np.array([0.0, -1.0, 10.0, 100.0]))
    assert np.isnan(found.place(np.array([0.0, -1.0]))).all()


def _written(path: Path, charts: list[Chart]) -> Path:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, ViewSetup("test", "test"), live=True)
    logger.begin()
    for number, chart in enumerate(charts):
        logger.log([Drawing(Instant(number, None, None), chart)])
    rec.disconnect()
    return path


def test_a_curve_stands_where_its_values_say(tmp_path: Path) -> None:
    path = _written(tmp_path / "chart.rrd", [_chart([1000.0, 100.0, 10.0, 1.0])])
    (batch,) = record_batches(path, "/charts/allan/gyro\\ x")
    (strips,) = (batch.column(i) for i, name in enumerate(batch.schema.names) if name.endswith(":strips"))
    points = np.array(strips.to_pylist()[0][0])
    np.testing.assert_allclose(points[:, 0], np.array([0, 1, 2, 3]) / 3 * WIDTH, atol=1e-6)
    np.testing.assert_allclose(points[:, 1], -np.array([3, 2, 1, 0]) / 3 * HEIGHT, atol=1e-6)


def test_a_line_is_interrupted_where_it_has_no_value_and_charts_follow_each_other(tmp_path: Path) -> None:
    path = _written(tmp_path / "chart.rrd", [_chart([1.0, 2.0]), _chart([1.0, 2.0, np.nan, 4.0])])
    batches = record_batches(path, "/charts/allan/gyro\\ x")
    strips = [
        batch.column(i).to_pylist()
        for batch in batches
        for i, name in enumerate(batch.schema.names)
        if name.endswith(":strips")
    ]
    assert [len(row) for part in strips for row in part] == [1, 1]
    assert len(strips[-1][-1][0]) == 2


def test_a_later_chart_replaces_an_earlier_one_in_a_queue_that_knows_its_size() -> None:
    drawing = Drawing(Instant(None, None, None), _chart([1.0, 2.0]))
    assert lasting_key(drawing) == "chart allan"
    assert item_bytes(drawing) > 4 * 8
