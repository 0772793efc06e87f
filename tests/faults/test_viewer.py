from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.killed import EXIT_S
from tests.faults.viewer import HARMS, harm
from tests.waiting import LIMIT_S

PATIENCE = LIMIT_S / EXIT_S
"""How long the end takes on a machine with nothing else to do, `scripts/soak viewer` measures."""


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in HARMS if "stopped" in name or "browsers" in name])
def test_a_view_in_trouble_does_not_delay_the_recording(tmp_path: Path, name: str) -> None:
    wrong, numbers = harm(tmp_path / "session", name, 2.0, PATIENCE)
    assert not wrong, numbers
