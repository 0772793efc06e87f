from __future__ import annotations

import signal
from pathlib import Path

import pytest

from tests.faults.killed import EXIT_S, allowed_s, interrupt, kill_one
from tests.waiting import LIMIT_S

PATIENCE = LIMIT_S / EXIT_S
"""How long the end takes on a machine with nothing else to do, `scripts/soak killed` measures."""


@pytest.mark.long
@pytest.mark.parametrize(("rate_hz", "after_s"), [(100.0, 1.3), (1000.0, 6.2)])
def test_a_killed_monitor_has_kept_what_is_older_than_promised(
    tmp_path: Path, rate_hz: float, after_s: float
) -> None:
    age_s, late_s = kill_one(tmp_path / "session", rate_hz, after_s)
    assert age_s <= allowed_s(late_s)


@pytest.mark.long
def test_a_monitor_that_was_stopped_goes_on_and_ends_in_order(tmp_path: Path) -> None:
    assert not interrupt(tmp_path / "session", signal.SIGTERM, 0.5, PATIENCE)
