"""Measured recordings: fit on the first part, test on the rest, per axis, before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from thermal_calibration_data import AXES, during

from imumon.blocks import FloatArray
from imumon.errors import ImumonError
from imumon.lab.calibration.calibration import calibrate, knots_of
from imumon.lab.calibration.cells import channel_of, group, levels
from imumon.lab.calibration.record import Record
from imumon.lab.calibration.selection import slow_variance
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.smoothing import fit_spline
from imumon.models.curves.training import fit_network
from imumon.models.model import Curve
from imumon.recordings.reduced import GYRO

Errors = dict[str, float]


@dataclass(frozen=True, slots=True)
class Row:
    """rms errors of one axis in the test part, rad/s; `inside` is the share in the trained range."""

    axis: str
    errors: Errors
    chosen: str
    promised: float
    inside: float
    floor: float


def fit_first_test_rest(record: Record, share: float) -> list[Row]:
    """Fit every curve to the first `share` of a record's time; test on the rest, in the trained range."""
    first, rest = during(record, 0.0, share), during(record, share, 1.0)
    model = calibrate([first])
    cells = group([first], None, None)
    centers = levels(cells)
    rows = []
    for axis, name in zip(AXES, GYRO, strict=True):
        channel = channel_of([first], cells, name, centers)
        assert channel is not None
        knots = knots_of(channel, centers)
        points = channel.points(slow_variance(channel.points(), channel.white, knots))
        curves: dict[str, Curve] = {
            "line": fit_polynomial(points, 1),
            "cubic": fit_polynomial(points, 3),
            "spline": fit_spline(points, knots),
            "network 2": fit_network(points, 2),
        }
        found = model.model.channels[name]
        t, value = rest.of(channel.temperature_column)[rest.rest], rest.of(name)[rest.rest]
        inside = found.inside(t)
        constant = float(np.average(channel.value, weights=channel.seconds))
        errors = {"constant": _rms(value[inside] - constant)}
        errors |= {key: _rms(value[inside] - curve.value(t[inside])) for key, curve in curves.items()}
        errors["chosen"] = _rms(value[inside] - found.value(t[inside]))
        white = np.sqrt(rest.means.mean_variance(name)[rest.rest])
        chosen = model.findings[name].choice.name
        rows.append(
            Row(
                axis, errors, chosen, found.residual_sd, float(inside.mean()), _rms(white[np.isfinite(white)])
            )
        )
    return rows


@dataclass(frozen=True, slots=True)
class TwoLevels:
    """What calibrate says of two levels, and per axis the rms errors, rad/s, of constant and line."""

    refusal: str
    temperatures: list[tuple[float, float]]
    rows: list[tuple[str, float, float, float]]


def two_levels_study(records: Sequence[Record]) -> TwoLevels:
    """Fit to the first 60 % of each level and test on the rest of each."""
    try:
        calibrate(records)
    except ImumonError as error:
        refusal = error.seen
    else:
        refusal = "accepted"
    column = "temperature_estimate"
    first = [during(record, 0.0, 0.6) for record in records]
    rest = [during(record, 0.6, 1.0) for record in records]
    rows = []
    for axis, name in zip(AXES, GYRO, strict=True):
        t, value = _gathered(first, column, name)
        line = np.polynomial.Polynomial.fit(t, value, 1)
        level_means = [np.mean(_gathered([record], column, name)[1]) for record in first]
        test_t, test = _gathered(rest, column, name)
        floor = [np.sqrt(r.means.mean_variance(name)[r.rest]) for r in rest]
        before = test - float(np.mean(level_means))
        rows.append((axis, _rms(before), _rms(test - line(test_t)), _rms(np.concatenate(floor))))
    ends = [(float(r.of(column)[r.rest].min()), float(r.of(column)[r.rest].max())) for r in records]
    return TwoLevels(refusal, ends, rows)


def _gathered(records: Sequence[Record], column: str, name: str) -> tuple[FloatArray, FloatArray]:
    t = np.concatenate([record.of(column)[record.rest] for record in records])
    return t, np.concatenate([record.of(name)[record.rest] for record in records])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")
