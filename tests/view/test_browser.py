"""The page in a real browser: two tabs show something, and no request leaves this computer."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from PIL import Image
from support.scenes import Scene, simulated, view_items

from imumon.charts import AXIS_COLORS, ORANGE
from imumon.view.items import ViewSetup, merge
from imumon.view.logger import StreamLogger
from imumon.view.publisher import WEB_STEP_NS
from imumon.view.viewer import PAGE_MEMORY, free_port
from imumon.view.web import WebServer
from tests.view.browser import Browser, browser, browser_binary
from tests.view.streams import log_as_page
from tests.view.test_screenshots import SETUP, run_of_20_s
from tests.waiting import LIMIT_S

BLENDED = 40
"""A line with its band about it has not quite its own colour; what the page warns of is another orange."""
TAKES_S = 60.0
"""In which the page takes in what came before it, or hangs: it took 12 s."""
FAST_BAUD = 921_600
LINES, LINE_PIXELS = (AXIS_COLORS["z"], ORANGE), 200
"""The angular rate z in the first tab, the temperature rate in the second."""


@pytest.fixture
def binary() -> str:
    found = browser_binary()
    if found is None:
        pytest.skip("no Chromium on this machine: sudo apt install chromium")
    return found


class Page:
    """A stream and the page that shows it."""

    def __init__(self, setup: ViewSetup) -> None:
        port = free_port(29800)
        self.site = WebServer(("127.0.0.1", port), 29890)
        self.rec = rr.RecordingStream("imumon", recording_id="browser")
        self.rec.set_sinks(
            rr.GrpcServerSink("127.0.0.1", port, server_memory_limit=PAGE_MEMORY, newest_first=True)
        )
        self.logger = StreamLogger(self.rec, setup, live=True)
        self.logger.begin()

    def close(self) -> None:
        self.site.shutdown()
        self.site.server_close()
        self.rec.disconnect()


@pytest.mark.viewer
def test_two_tabs_in_a_browser_show_something_and_nothing_goes_out(binary: str, tmp_path: Path) -> None:
    served = Page(SETUP)
    served.logger.log(merge(run_of_20_s()))
    served.rec.flush()
    arrangement = served.logger.arrangement
    assert arrangement is not None
    with browser(binary, "910,512") as page:  # drawn without a GPU: each pixel costs
        page.open(served.site.url)
        seen = [shown(page, tmp_path / "first.png")]
        arrangement.root_container.active_tab = 1
        served.rec.send_blueprint(arrangement)
        served.rec.flush()
        seen.append(shown(page, tmp_path / "second.png", seen[0]))
        requests = list(page.requests.values())
        out = page.gone_out(served.site.url)
    served.close()
    assert any("/rerun." in url for url in requests), "the stream comes through the page's own port"
    assert out == []


@pytest.mark.long
@pytest.mark.viewer
@pytest.mark.parametrize("rate_hz", [100.0, 1000.0])
def test_a_browser_that_joins_after_ten_minutes_shows_them(
    binary: str, tmp_path: Path, rate_hz: float
) -> None:
    seconds = 600
    scene = Scene("late", "ax1", simulated("bench", "ax1", seconds, rate_hz, FAST_BAUD), baudrate=FAST_BAUD)
    setup, items = view_items("late", scene)
    served = Page(setup._replace(step_ns=WEB_STEP_NS))
    log_as_page(served.logger, items, seconds)
    served.rec.flush()
    with browser(binary, "910,512") as page:
        page.open(served.site.url)
        shown(page, tmp_path / "late.png")
        page.listen(TAKES_S)
        answer = page.call("Runtime.evaluate", expression="document.title")  # a TimeoutError where it hangs
    served.close()
    assert answer["result"]["value"] == "Rerun Viewer"


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
