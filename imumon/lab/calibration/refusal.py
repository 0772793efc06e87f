"""What cannot give a good model is refused, with the numbers seen and what to do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.effects.thermal_lag import UNTOLD_S
from imumon.errors import ImumonError, Reason
from imumon.intake import RANGES
from imumon.lab.calibration.cells import Cells
from imumon.lab.calibration.record import BLOCK_S, LEAST_COVERED, Record
from imumon.recordings.reduced import GYRO

LEAST_SPAN_DEGC = 5.0
LEAST_REST_S = 600.0
WIDEST_HOLE = 0.4
"""Share of the span without data that a curve cannot bridge."""
MOST_LAG = 0.1
"""Share of the span that the temperature may be wrong by for that reason."""


def check_columns(records: Sequence[Record]) -> None:
    """Raise BAD_DATA when a record has no gyro, a constant gyro, or no temperature."""
    for record in records:
        if lacking := [name for name in GYRO if not record.has(name)]:
            raise _refusal(
                f"{record.name}: no values of {', '.join(lacking)}",
                "a bias model is made of angular rates; let the device send them, or name them in the map",
            )
        if any(record.temperature_column(name) is None for name in GYRO):
            coldest, hottest, unit = RANGES["temperature"]
            raise _refusal(
                f"{record.name}: there is no temperature",
                "let the device send its temperature, or name the column in the map with its unit; "
                f"readings beyond {coldest:g} to {hottest:g} {unit}, and zero alone, are left out",
            )
        values = {name: record.of(name) for name in GYRO} if len(record.means) > 1 else {}
        if stuck := [name for name, of in values.items() if np.nanmin(of) == np.nanmax(of)]:
            raise _refusal(
                f"{record.name}: {', '.join(stuck)} never changes from {record.of(stuck[0])[0]:g} rad/s",
                "a sensor that measures is never so quiet: is it switched off, or the column a constant?",
            )


def check_coverage(records: Sequence[Record], cells: Cells) -> None:
    """Raise BAD_DATA when time at rest, span, holes or rate do not allow a model."""
    rest_s = float(cells.seconds.sum())
    if rest_s < LEAST_REST_S:
        recorded_s = sum(float(record.means.span_s.sum()) for record in records)
        raise _refusal(
            f"{rest_s:.0f} s at rest, of {recorded_s:.0f} s with several samples in {BLOCK_S:g} s; "
            f"a model needs {LEAST_REST_S:.0f}",
            "let the unit stand still on a firm base for longer"
            if recorded_s > 0.0
            else f"record faster than every {LEAST_COVERED * BLOCK_S:g} s, or mend the unit of its time",
        )
    known = np.sort(cells.temperature)
    low, high = float(known[0]), float(known[-1])
    span = high - low
    if span < LEAST_SPAN_DEGC:
        raise _refusal(
            f"the temperature at rest spans {span:.2f} °C ({low:.2f} to {high:.2f}); "
            f"a model needs {LEAST_SPAN_DEGC:g}",
            "record while the unit warms up or cools down over the range in which it will be used",
        )
    at = int(np.argmax(np.diff(known)))
    hole = float(known[at + 1] - known[at])
    if hole > WIDEST_HOLE * span:
        raise _refusal(
            f"nothing at rest from {known[at]:.2f} to {known[at + 1]:.2f} °C, {hole / span:.0%} of "
            f"the span; a curve bridges {WIDEST_HOLE:.0%}",
            "record levels in between",
        )
    rate = float(np.sqrt(np.average(cells.rate**2, weights=cells.seconds)))
    wrong = UNTOLD_S * rate
    if wrong > MOST_LAG * span:
        raise _refusal(
            f"the temperature moves at {60 * rate:.2f} °C/min (rms): a gyro {UNTOLD_S:g} s behind its "
            f"thermometer would be wrong by {wrong:.2f} °C, {wrong / span:.0%} of the {span:.2f} °C span; "
            f"a model allows {MOST_LAG:.0%}",
            "heat and cool more slowly, hold levels, or cover a wider range",
        )


def _refusal(seen: str, hint: str) -> ImumonError:
    return ImumonError(Reason.BAD_DATA, seen, hint)
