"""The published training on a simulated soak, slopes, and a measured chamber cycle before and after."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from study import Cell, Cells, Options, Study, Table, rms
from thermal_calibration_data import AXES, DEG_H, INSIDE, Soak, chamber_cycle, during, simulated_soak
from thermal_calibration_figures import PARTS, draw
from thermal_calibration_study import (
    RESTARTS,
    SEED,
    SizeRow,
    beyond_the_range,
    polynomial_leak,
    published,
    size_study,
    slope_methods,
    slope_size_study,
)

from imumon.lab.calibration.calibration import calibrate, knots_of
from imumon.lab.calibration.cells import channel_of, group, levels
from imumon.lab.calibration.record import Record
from imumon.lab.calibration.selection import slow_variance
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.curves.smoothing import fit_spline
from imumon.models.curves.training import fit_network
from imumon.models.model import Curve
from imumon.recordings.reduced import GYRO

SHARES = (0.42, 0.6, 0.8)
"""Of the chamber's record that is fitted."""
DISTANCES_DEGC = np.array([0.5, 1.0, 2.0, 3.0, 3.5])
PICTURE = "![{0}](../figures/thermal-calibration/{1}.png)"


def sizes(rows: Sequence[SizeRow], title: str, note: str) -> Table:
    """What splits by sample say of networks of each size, and the truth."""
    cells: list[Cells] = []
    for row in rows:
        left_out: Cell = row.levels_left_out if np.isfinite(row.levels_left_out) else ""
        cells.append([row.neurons, *row.by_sample, left_out, row.truth])
    heads = ["neurons", *PARTS, "levels left out", "against the truth"]
    return Table(title, heads, cells, note, ("", ".2f", ".2f", ".2f", ".1f", ".2f"))


def slopes(soak: Soak) -> Table:
    """Errors of db/dT by each method."""
    methods = [slope_methods(soak, axis) for axis in range(3)]
    rows = []
    for name in methods[0]:
        errors = [rms(methods[axis][name](INSIDE) - soak.slope[:, axis]) / DEG_H for axis in range(3)]
        rows.append([name, *errors])
    bad = [published(soak.halfminutes(axis), 2, 1).bad for axis in range(3)]
    *parts, true = (value / DEG_H for value in polynomial_leak(soak))
    note = (
        f"Of {RESTARTS} starts of the 1-2-2-1 network {' / '.join(map(str, bad))} (x / y / z) ended with more"
        " than 1.5 times the validation error of the best.  A polynomial of order 12 on the levels alone,"
        f" split by sample: rms residual of training, validation and test"
        f" {' / '.join(f'{value:.1f}' for value in parts)} °/h; its error between the levels {true:.1f} °/h"
        f" (z).\n\n{PICTURE.format('Slopes', 'slopes')}"
    )
    title = "## Error of the slope\n\nrms from -20.53 to 48.08 °C against the truth, °/h/°C."
    return Table(title, ["method", *AXES], rows, note, ("", ".2f", ".2f", ".2f"))


def outside(soak: Soak) -> Table:
    """Errors beyond the calibrated range."""
    errors = dict(zip(("tangent", "held"), beyond_the_range(soak, DISTANCES_DEGC), strict=True))
    rows = [[name, *(values / DEG_H)] for name, values in errors.items()]
    title = (
        "## Outside the calibrated range\n\n"
        "Spline fitted to levels 2 to 14; rms error over axes and both ends, °/h."
    )
    formats = ("", *[".1f"] * len(DISTANCES_DEGC))
    return Table(title, ["", *(f"{d:g} °C" for d in DISTANCES_DEGC)], rows, formats=formats)


def chamber(record: Record, share: float) -> Table:
    """Errors of curves fitted to the first `share` of a record's time, on the rest in the trained range."""
    first, rest = during(record, 0.0, share), during(record, share, 1.0)
    model = calibrate([first])
    groups = group([first], None, None)
    centers = levels(groups)
    rows = []
    for axis, name in zip(AXES, GYRO, strict=True):
        channel = channel_of([first], groups, name, centers)
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
        white = np.rad2deg(rms(np.sqrt(rest.means.mean_variance(name)[rest.rest])))
        cells = [axis, *np.rad2deg(list(errors.values())), model.findings[name].choice.name]
        rows.append([*cells, np.rad2deg(found.residual_sd), inside.mean(), white])
    heads = ["axis", *errors, "what was chosen", "promised", "inside", "noise of a block"]
    formats = ("", *[".3f"] * len(errors), "", ".3f", ".0%", ".4f")
    return Table(f"Fitted to the first {share:.0%} of the time:", heads, rows, formats=formats)


def tables(given: Options) -> Iterator[Table]:
    """Yield the tables of the soak, and of the measured recording where it is here."""
    soak = simulated_soak(SEED)
    if given.quick:
        yield outside(soak)
        return
    title = (
        "## Size of the network, and what a split by sample hides\n\n"
        "Scenario crs05-soak, 30 s means at the levels, 65/20/15 % of the samples at random, as published;"
        " S_r is the rms over the three axes, °/h.  The three parts agree whatever happens in between."
    )
    yield sizes(size_study(soak), title, PICTURE.format("Figure 7", "figure-07"))
    title = "The same on db/dT from differences of levels, °/h/°C: 14 of them, 9 for training."
    yield sizes(slope_size_study(soak), title, PICTURE.format("Figure 8", "figure-08"))
    yield slopes(soak)
    yield outside(soak)
    if not (given.data / "chamber-cycle").is_dir():
        return
    with tempfile.TemporaryDirectory() as scratch:
        record = chamber_cycle(given.data, Path(scratch))
    text = (
        "## Measured: before and after\n\n"
        "rms error of the bias in the part of the chamber cycle after the fit, where its temperature is in"
        " the fitted range, °/s; `constant` is before: the mean of the fitted part.  `promised` is the"
        " `residual_sd` of the model."
    )
    yield Table(text, (), ())
    for share in SHARES:
        yield chamber(record, share)
    picture = PICTURE.format("Chamber cycle", "chamber-cycle")
    yield Table("", (), (), f"Curve chosen from the first 60 %:\n\n{picture}")


STUDY = Study(tables, page="appendix/thermal-calibration-results.md", draw=draw)
