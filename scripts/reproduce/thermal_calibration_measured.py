"""Measured recordings: fit on the first part, test on the rest, per axis, before and after."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from study import rms
from thermal_calibration_data import AXES, during

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
        errors = {"constant": rms(value[inside] - constant)}
        errors |= {key: rms(value[inside] - curve.value(t[inside])) for key, curve in curves.items()}
        errors["chosen"] = rms(value[inside] - found.value(t[inside]))
        white = np.sqrt(rest.means.mean_variance(name)[rest.rest])
        chosen = model.findings[name].choice.name
        rows.append(Row(axis, errors, chosen, found.residual_sd, float(inside.mean()), rms(white)))
    return rows
