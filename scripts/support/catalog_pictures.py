"""Make the pictures of docs/catalog.md, of a fleet that the tests make: python -m support.catalog_pictures"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from PIL import Image
from rerun.experimental import ViewerClient

from imumon.cli import run
from imumon.view.viewer import free_port, viewer_binary
from support.browser import browser, browser_binary
from support.screenshots import COLORS, PICTURES, SETTLE_S
from tests.fleet.catalog.fleet import RUNAWAY, fleet


def main() -> int:
    """Make both pictures."""
    chromium = browser_binary()
    assert chromium is not None, "there is no browser"
    with tempfile.TemporaryDirectory(prefix="imumon-") as name:
        folder = Path(name)
        sessions, recording, page = fleet(folder / "fleet"), folder / "units.rrd", folder / "record.html"
        assert not run(["catalog", str(sessions), "--rrd", str(recording)])
        assert not run(["report", RUNAWAY, "--sessions", str(sessions), "--out", str(page)])
        viewer = ViewerClient.spawn(
            headless=True,
            port=free_port(9871),
            executable_path=str(viewer_binary()),
            hide_welcome_screen=True,
        )
        try:
            viewer.open(str(recording))
            time.sleep(3 * SETTLE_S)
            viewer.save_screenshot(str(folder / "catalog.png"))
        finally:
            viewer.quit()
        with browser(chromium) as shown:
            shown.open(f"{page.as_uri()}#drift")
            shown.listen(SETTLE_S)
            shown.photograph(folder / "record.png")
        for picture in ("catalog.png", "record.png"):
            Image.open(folder / picture).convert("RGB").quantize(COLORS).save(
                PICTURES / picture, optimize=True
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
