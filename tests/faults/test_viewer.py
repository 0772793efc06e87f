from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.viewer import HARMS, harm

PATIENCE = 5.0
"""Other tests run beside this one."""


@pytest.mark.parametrize("name", [name for name in HARMS if "stopped" in name or "browsers" in name])
def test_a_view_in_trouble_does_not_delay_the_recording(tmp_path: Path, name: str) -> None:
    wrong, numbers = harm(tmp_path / "session", name, 2.0, PATIENCE)
    assert not wrong, numbers
