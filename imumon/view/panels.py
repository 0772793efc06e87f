"""The panels of the live view, as `panels.yaml` lists them: which columns are drawn where."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import RootModel

from imumon.charts import AXIS_COLORS, COLOR_NAMES
from imumon.config import load_yaml
from imumon.view.layout import Attitude, Bands, Line, Strip

Panel = Strip | Attitude

COLORS = AXIS_COLORS | {name: color for color, name in COLOR_NAMES.items()}
"""By their names in the file, where an axis stands for its colour."""
AXIS = "<axis>"


def _strips() -> Iterator[Strip]:
    """Yield the panels of the file, those of a key for each axis after each other."""
    entries = load_yaml(Path(__file__).with_suffix(".yaml"), RootModel[dict[str, Any]])
    for key, entry in entries.root.items():
        for axis in AXIS_COLORS if AXIS in key else ("",):
            yield _strip(key.replace(AXIS, axis), **json.loads(json.dumps(entry).replace(AXIS, axis)))


def _strip(
    key: str,
    lines: Mapping[str, str],
    *,
    band: bool = False,
    sd: str | None = None,
    limits: Sequence[float] = (),
    **fields: Any,
) -> Strip:
    """Return a panel of the file, which describes the fields."""
    drawn = tuple(
        _line(column.format(axis), shown.format(axis, axis), sd)
        for column, shown in lines.items()
        for axis in (AXIS_COLORS if "{}" in column else ("",))
    )
    return (Bands if band else Strip)(key, lines=drawn, limits=tuple(limits), **fields)


def _line(column: str, shown: str, sd: str | None) -> Line:
    color, _, name = shown.partition(" ")
    quantity, _, axis = column.rpartition("_")
    own = f"{quantity}_sd_{axis}" if axis in AXIS_COLORS else f"{column}_sd"
    return Line(column, name, COLORS[color], own if sd == "own" else sd)


ESTIMATED = tuple(f"attitude_estimate_{part}" for part in "wxyz")
TITLE, AXES = "Attitude by the estimator", ("east", "north", "up")
PANELS: tuple[Panel, ...] = (
    Attitude("attitude", ("q_w", "q_x", "q_y", "q_z")),
    Attitude("attitude_from_angles", ("roll", "pitch", "yaw")),
    Attitude("attitude_estimate", ESTIMATED, "/attitude_estimate", TITLE, AXES, up=1.0),
    *_strips(),
)
"""All panels, in the order in which they stand.  The attitude that comes first turns the body."""
