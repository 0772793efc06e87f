"""Each tutorial and each how-to page runs from its first to its last line, and prints what the page shows."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from support import tutorials

from tests.data_folder import measured


@pytest.mark.long
@pytest.mark.parametrize("page", tutorials.PAGES, ids=lambda page: page.stem)
def test_tutorial(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if "IMUMON_DATA" in page.read_text(encoding="utf-8"):
        monkeypatch.setitem(os.environ, "IMUMON_DATA", str(measured("chamber-cycle").parent))
    blocks = tutorials.run(page, tmp_path)
    assert blocks
    for block in blocks:
        assert tutorials.missing_lines(block) == [], block.printed
