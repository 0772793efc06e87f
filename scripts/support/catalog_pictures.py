"""Make the picture of docs/catalog.md, of a fleet that the tests make: python -m support.catalog_pictures"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from imumon.cli import run
from support.browser import browser, browser_binary
from support.screenshots import COLORS, PICTURES, SETTLE_S
from tests.fleet.catalog.fleet import RUNAWAY, fleet


def main() -> int:
    """Make the picture."""
    chromium = browser_binary()
    assert chromium is not None, "there is no browser"
    with tempfile.TemporaryDirectory(prefix="imumon-") as name:
        folder = Path(name)
        sessions, page = fleet(folder / "fleet"), folder / "record.html"
        assert not run(["report", RUNAWAY, "--sessions", str(sessions), "--out", str(page)])
        with browser(chromium) as shown:
            shown.open(f"{page.as_uri()}#drift")
            shown.listen(SETTLE_S)
            shown.photograph(folder / "record.png")
        picture = Image.open(folder / "record.png").convert("RGB")
        picture.quantize(COLORS).save(PICTURES / "record.png", optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
