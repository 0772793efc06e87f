"""Where measured recordings lie, and the skip for machines that do not have them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

_DEFAULT = Path(__file__).resolve().parents[2] / "shared" / "data"


def measured(relative: str) -> Path:
    """Return the path of a measured recording, or skip the test with the reason."""
    path = Path(os.environ.get("IMUMON_DATA", _DEFAULT)) / relative
    if not path.exists():
        pytest.skip(f"measured data not here: {relative} (set IMUMON_DATA)")
    return path
