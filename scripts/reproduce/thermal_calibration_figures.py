"""Figures 7 and 8 of the paper, the slopes on the simulated soak, and the measured chamber cycle."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import figures
import numpy as np
from study import Options
from thermal_calibration_data import AXES, DEG_H, INSIDE, Soak, chamber_cycle, during, simulated_soak
from thermal_calibration_study import SEED, SizeRow, size_study, slope_methods, slope_size_study

from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.record import Record
from imumon.recordings.reduced import GYRO

FOLDER = "thermal-calibration"
PARTS = ("training samples", "validation samples", "test samples")
DRAWN = (
    "derivative of the published b(T) network",
    "cubic spline through the level means",
    "imumon: smoothing spline",
)
"""Methods whose slopes are compared."""
SHARE = 0.6
"""Of the chamber's record that is fitted."""


def sizes(rows: Sequence[SizeRow], title: str, unit: str, name: str) -> Path:
    """Draw S_r against the number of neurons."""
    (ax,) = figures.axes(title, x="neurons in each hidden layer", y=f"$S_r$, {unit}", size=(7.0, 3.8))
    n = [row.neurons for row in rows]
    for k, part in enumerate(PARTS):
        ax.plot(n, [row.by_sample[k] for row in rows], marker="o", ms=4, lw=1, label=part)
    if np.isfinite([row.levels_left_out for row in rows]).all():
        ax.plot(n, [row.levels_left_out for row in rows], "k--", marker="s", ms=4, label="levels left out")
    ax.plot(n, [row.truth for row in rows], "k", marker="^", ms=5, label="against the truth")
    ax.set(yscale="log", xticks=n)
    return figures.save([ax], FOLDER, name)


def slope_errors(soak: Soak) -> Path:
    """Draw the error of db/dT of each axis over temperature, for a few methods."""
    drawn = figures.axes("Error of the slope on the simulated soak", 3, x="°C", size=(8.0, 8.0))
    for axis, ax in enumerate(drawn):
        methods = slope_methods(soak, axis)
        for name in DRAWN:
            error = methods[name](INSIDE) - soak.slope[:, axis]
            ax.plot(INSIDE, error / DEG_H, lw=1, label=name)
        ax.set(ylabel=f"{AXES[axis]}, °/h/°C", ylim=(-4, 4))
    return figures.save(drawn, FOLDER, "slopes")


def chamber(record: Record) -> Path:
    """Draw bias over temperature: the part fitted, the rest, and the curve chosen."""
    model = calibrate([during(record, 0.0, SHARE)]).model
    drawn = figures.axes("Measured chamber cycle", 1, 3, x="°C", y="°/s", size=(12.0, 4.0))
    for axis, ax, name in zip(AXES, drawn, GYRO, strict=True):
        for first, last, label in ((0.0, SHARE, "fitted"), (SHARE, 1.0, "rest")):
            rest = during(record, first, last).rest
            t, value = record.of("temperature_estimate")[rest], record.of(name)[rest]
            ax.plot(t, np.rad2deg(value), ".", ms=3, label=label)
        low, high = model.channels[name].temperature_range_degc
        t = np.linspace(low, high, 300)
        ax.plot(t, np.rad2deg(model.channels[name].value(t)), "k", lw=1, label="curve")
        ax.set_title(f"gyro {axis}")
    return figures.save(drawn, FOLDER, "chamber-cycle")


def draw(given: Options) -> Iterator[Path]:
    """Draw all figures; the last one where there is the measured recording."""
    soak = simulated_soak(SEED)
    yield sizes(size_study(soak), "Figure 7: networks on b(T)", "°/h", "figure-07")
    yield sizes(slope_size_study(soak), "Figure 8: networks on db/dT", "°/h/°C", "figure-08")
    yield slope_errors(soak)
    if (given.data / "chamber-cycle").is_dir():
        with tempfile.TemporaryDirectory() as scratch:
            record = chamber_cycle(given.data, Path(scratch))
        yield chamber(record)
