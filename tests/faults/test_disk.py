from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.disk import FAULTS, strike


@pytest.mark.long
@pytest.mark.parametrize("name", list(FAULTS))
def test_a_disk_that_fails_costs_what_it_did_not_take_and_is_reported(tmp_path: Path, name: str) -> None:
    assert not strike(tmp_path / "disk", name, 1)
