"""The present values as numbers, in field digits: one card for each tab."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, FloatArray

DIGITS = {"°/s": 3, "m/s²": 3, "µT": 2, "a.u.": 4, "°": 2, "°C": 2, "°C/h": 1, "°/h": 1, "1/s": 1, "%": 0}
"""Decimals of a value without a sigma; others have five digits."""
AXES = ["x", "y", "z"]


class Reading(NamedTuple):
    """One number of a card: its row and name, its column and that of its sigma, and how it is shown."""

    row: str
    name: str
    column: str
    sd: str | None
    unit: str
    factor: float
    headline: bool = False


class Cards:
    """Gathers the columns that the cards show; what was shown stays until there are more values."""

    def __init__(self) -> None:
        self._new: dict[str, list[FloatArray]] = {}
        self._shown: dict[str, float] = {}

    def add(self, readings: Iterable[Reading], columns: Mapping[str, ColumnArray]) -> None:
        """Take rows: of a column without a sigma the mean is shown, for single samples cannot be read."""
        for reading in readings:
            averaged = reading.sd is None and reading.unit != "°"
            for name in filter(None, (reading.column, reading.sd)):
                values = np.asarray(columns.get(name, ()), np.float64)
                finite = values[np.isfinite(values)]
                if len(finite):
                    self._new[name] = [*self._new.get(name, ()), finite] if averaged else [finite[-1:]]

    def take(self) -> dict[str, float]:
        """Return the present value of every column that has had one, and begin anew."""
        self._shown |= {name: float(np.concatenate(parts).mean()) for name, parts in self._new.items()}
        self._new.clear()
        return dict(self._shown)


def card(readings: Sequence[Reading], now: Mapping[str, float]) -> str:
    """Return readings as Markdown, with the present value of each column; a row of axes has a unit once."""
    lines = [f"# {cell(one, now)} {one.unit}".replace(" °", "°") for one in readings if one.headline]
    rows = rows_of(readings)
    axes = any(len(found) > 1 for _, found in rows)
    lines += ["", "| | x | y | z | |" if axes else "| | | | | |", "|:--|--:|--:|--:|:--|"]
    for label, found in rows:
        cells = " | ".join(cell(one, now) for one in found) + (" | |" if len(found) == 1 else "")
        lines.append(f"| **{label}** | {cells} | {found[0].unit} |")
    return "\n".join(lines)


def rows_of(readings: Sequence[Reading], *, beside: bool = True) -> list[tuple[str, list[Reading]]]:
    """Return label and readings of each row: the three axes beside each other, any others alone."""
    groups: dict[tuple[str, str], list[Reading]] = {}
    for reading in readings:
        groups.setdefault((reading.row, reading.unit), []).append(reading)
    rows = []
    for (label, _), found in groups.items():
        if beside and [one.name for one in found] == AXES:
            rows.append((label, found))
        else:
            rows += [(label if len(found) == 1 else f"{label} {one.name}", [one]) for one in found]
    return rows


def cell(reading: Reading, now: Mapping[str, float]) -> str:
    """Return the present value of a reading, with its sigma where it has one."""
    value, sd = (reading.factor * now.get(name or "", math.nan) for name in (reading.column, reading.sd))
    return measured(value, sd, DIGITS.get(reading.unit))


def measured(value: float, sd: float = math.nan, decimals: int | None = None) -> str:
    """Return a value as it is written in a log book: with a sigma of two digits, or so many decimals."""
    if not math.isfinite(value):
        return "–"
    if math.isfinite(sd) and sd > 0:
        places = min(1 - int(f"{sd:.1e}".split("e")[1]), 9)
        digits = max(places, 0)
        return f"{round(value, places):z.{digits}f} ± {round(sd, places):.{digits}f}"
    return f"{value:z.5g}" if decimals is None else f"{value:z.{decimals}f}"  # z: no minus before zero
