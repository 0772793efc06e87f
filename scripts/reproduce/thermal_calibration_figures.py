"""Figures 7 and 8 of the paper, the slopes on the simulated soak, and the measured chamber cycle."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from thermal_calibration_data import AXES, DEG_H, INSIDE, Function, Soak, during
from thermal_calibration_study import SizeRow

from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.record import Record
from imumon.recordings.reduced import GYRO

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.figure import Figure

PARTS = ("training samples", "validation samples", "test samples")


def _save(figure: Figure, path: Path) -> Path:
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)
    return path


def sizes(rows: Sequence[SizeRow], title: str, unit: str, path: Path) -> Path:
    """Draw S_r against the number of neurons."""
    figure, ax = plt.subplots(figsize=(7, 3.8), dpi=80)
    n = [row.neurons for row in rows]
    for k, part in enumerate(PARTS):
        ax.plot(n, [row.by_sample[k] for row in rows], marker="o", ms=4, lw=1, label=part)
    if np.isfinite([row.levels_left_out for row in rows]).all():
        ax.plot(n, [row.levels_left_out for row in rows], "k--", marker="s", ms=4, label="levels left out")
    ax.plot(n, [row.truth for row in rows], "k", marker="^", ms=5, label="against the truth")
    ax.set(
        title=title, xlabel="neurons in each hidden layer", ylabel=f"$S_r$, {unit}", yscale="log", xticks=n
    )
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8)
    return _save(figure, path)


def slope_errors(soak: Soak, methods: Sequence[dict[str, Function]], path: Path) -> Path:
    """Draw the error of db/dT of each axis over temperature, for a few methods."""
    figure, axes = plt.subplots(3, 1, figsize=(8, 8), dpi=80, sharex=True)
    for axis, ax in enumerate(axes):
        for name in list(methods[axis])[::3]:
            error = methods[axis][name](INSIDE) - soak.slope[:, axis]
            ax.plot(INSIDE, error / DEG_H, lw=1, label=name)
        ax.set(ylabel=f"{AXES[axis]}, °/h/°C", ylim=(-4, 4))
        ax.grid(alpha=0.3)
    axes[0].set_title("Error of the slope on the simulated soak")
    axes[0].legend(fontsize=7, ncol=2)
    axes[-1].set_xlabel("°C")
    return _save(figure, path)


def chamber(record: Record, share: float, path: Path) -> Path:
    """Draw bias over temperature: the part fitted, the rest, and the curve chosen."""
    model = calibrate([during(record, 0.0, share)]).model
    figure, axes = plt.subplots(1, 3, figsize=(12, 4), dpi=80)
    for axis, (ax, name) in enumerate(zip(axes, GYRO, strict=True)):
        for first, last, label in ((0.0, share, "fitted"), (share, 1.0, "rest")):
            rest = during(record, first, last).rest
            t, value = record.of("temperature_estimate")[rest], record.of(name)[rest]
            ax.plot(t, np.rad2deg(value), ".", ms=3, label=label)
        low, high = model.channels[name].temperature_range_degc
        t = np.linspace(low, high, 300)
        ax.plot(t, np.rad2deg(model.channels[name].value(t)), "k", lw=1, label="curve")
        ax.set(title=f"gyro {AXES[axis]}", xlabel="°C", ylabel="°/s")
        ax.grid(alpha=0.3)
    axes[0].legend(fontsize=8)
    return _save(figure, path)
