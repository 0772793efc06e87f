"""The page in a real browser: two tabs show something, and no request leaves this computer."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from PIL import Image

from imumon.charts import AXIS_COLORS, ORANGE
from imumon.view.items import merge
from imumon.view.logger import StreamLogger
from imumon.view.viewer import SERVER_MEMORY, free_port
from imumon.view.web import WebServer
from tests.view.browser import Browser, browser, browser_binary
from tests.view.test_screenshots import SETUP, run_of_20_s
from tests.waiting import LIMIT_S

BLENDED = 40
"""A line with its band about it has not quite its own colour; what the page warns of is another orange."""
LINES, LINE_PIXELS = (AXIS_COLORS["z"], ORANGE), 200
"""The angular rate z in the first tab, the temperature rate in the second."""


@pytest.mark.viewer
def test_two_tabs_in_a_browser_show_something_and_nothing_goes_out(tmp_path: Path) -> None:
    binary = browser_binary()
    if binary is None:
        pytest.skip("no Chromium on this machine: sudo apt install chromium")
    port = free_port(29800)
    site = WebServer(("127.0.0.1", port), 29890)
    rec = rr.RecordingStream("imumon", recording_id="browser")
    rec.set_sinks(rr.GrpcServerSink("127.0.0.1", port, server_memory_limit=SERVER_MEMORY, newest_first=True))
    logger = StreamLogger(rec, SETUP, live=True)
    logger.begin()
    logger.log(merge(run_of_20_s()))
    rec.flush()
    arrangement = logger.arrangement
    assert arrangement is not None
    with browser(binary, "910,512") as page:  # drawn without a GPU: each pixel costs
        page.open(site.url)
        seen = [shown(page, tmp_path / "first.png")]
        arrangement.root_container.active_tab = 1
        rec.send_blueprint(arrangement)
        rec.flush()
        seen.append(shown(page, tmp_path / "second.png", seen[0]))
        requests = list(page.requests.values())
        out = page.gone_out(site.url)
    site.shutdown()
    site.server_close()
    rec.disconnect()
    assert any("/rerun." in url for url in requests), "the stream comes through the page's own port"
    assert out == []


Picture = np.ndarray[tuple[int, ...], np.dtype[np.uint8]]


def shown(page: Browser, path: Path, before: Picture | None = None) -> Picture:
    """Wait until lines in colour are seen, in another picture than before, and return it."""
    deadline = time.monotonic() + LIMIT_S
    while True:
        page.listen(2.0)
        page.photograph(path)
        pixels = np.asarray(Image.open(path).convert("RGB"))
        near = [np.abs(pixels.astype(int) - np.array(color)).max(axis=2) < BLENDED for color in LINES]
        is_new = before is None or not np.array_equal(pixels, before)
        if is_new and int(np.any(near, axis=0).sum()) > LINE_PIXELS:
            return pixels
        assert time.monotonic() < deadline, "the browser shows no line"
