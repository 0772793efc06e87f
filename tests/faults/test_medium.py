from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.medium import measure


@pytest.mark.long
def test_the_medium_is_queried_at_least_once_a_second(tmp_path: Path) -> None:
    row = measure(tmp_path, 200.0, 3.0)
    assert row.times >= 4
    assert row.held
