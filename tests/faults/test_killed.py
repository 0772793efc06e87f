from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.killed import PROMISED_S, kill_one


@pytest.mark.parametrize(("rate_hz", "after_s"), [(100.0, 1.3), (1000.0, 6.2)])
def test_a_killed_monitor_has_kept_what_is_older_than_promised(
    tmp_path: Path, rate_hz: float, after_s: float
) -> None:
    assert kill_one(tmp_path / "session", rate_hz, after_s) <= PROMISED_S
