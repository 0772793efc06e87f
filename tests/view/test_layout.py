"""What panels log."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from imumon.view.layout import Bands, Line
from imumon.view.panels import METHODS
from imumon.view.rows import Rows


class _Heard:
    """A recording that keeps the entities logged to it."""

    def __init__(self) -> None:
        self.entities: list[str] = []

    def log(self, entity: str, *_: object, **__: object) -> None:
        self.entities.append(entity)

    send_columns = log


def test_a_band_named_as_a_session_is_an_entity_whose_name_is_escaped() -> None:
    rec: Any = _Heard()
    panel = Bands("a/b", "title", (Line("x", "run of monday", (1, 2, 3)),), "°/h", METHODS)
    panel.declare(rec)
    times = np.arange(3) * 10**9
    panel.log(rec, Rows({"x": np.ones(3)}, None, times, times))
    named = [one for one in rec.entities if "monday" in one]
    assert named == [f"{panel.drawn}/" + rr.escape_entity_path_part("run of monday")] * 2
    assert "\\ " in named[0]
