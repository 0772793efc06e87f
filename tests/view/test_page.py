"""How much of a live run the server of a page keeps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from support.scenes import Scene, simulated, view_items

from imumon.view.items import ViewSetup
from imumon.view.logger import StreamLogger
from imumon.view.publisher import WEB_STEP_NS
from imumon.view.viewer import PAGE_MEMORY
from tests.view.streams import ACCEL, Stream, block, log_as_page, scalars

FAST_BAUD = 12_000_000


@pytest.mark.parametrize("rate_hz", [100.0, 1000.0, 4000.0])
def test_a_page_keeps_more_than_ten_minutes_with_all_estimators(tmp_path: Path, rate_hz: float) -> None:
    seconds, path = 30, tmp_path / "page.rrd"
    scene = Scene("page", "ax1", simulated("warm-up", "ax1", seconds, rate_hz, FAST_BAUD), baudrate=FAST_BAUD)
    setup, items = view_items("page", scene)
    rec = rr.RecordingStream("imumon", recording_id="page")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, setup._replace(step_ns=WEB_STEP_NS), live=True)
    logger.begin()
    log_as_page(logger, items, seconds)
    rec.disconnect()
    kept_s = int(PAGE_MEMORY.removesuffix("MB")) * 1e6 / path.stat().st_size * seconds
    assert kept_s > 10 * 60


def test_of_a_step_of_time_a_page_gets_the_extremes(tmp_path: Path) -> None:
    step_ns, path = 200_000_000, tmp_path / "page.rrd"
    rec = rr.RecordingStream("imumon", recording_id="page")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, ViewSetup("page", "page", step_ns=step_ns), live=True)
    logger.begin()
    stream = Stream(lambda item: logger.log([item]))
    for _ in range(10):
        stream.send(100)
    rec.disconnect()
    sample, device, _, shown = scalars([path], "/samples/accel")
    sent = stream.column(ACCEL)
    assert len(sample) < 0.5 * len(sent)
    step = block(0, stream.sent)["device_time_ns"] // step_ns
    np.testing.assert_array_equal(device // step_ns, step[sample])
    for number in np.unique(step):
        inside, kept = sent[step == number], shown[step[sample] == number]
        np.testing.assert_array_equal(kept.min(axis=0), inside.min(axis=0))
        np.testing.assert_array_equal(kept.max(axis=0), inside.max(axis=0))
