"""The pictures of a calibration: each channel's curve with its points, and a magnetometer's three planes."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imumon.files import write_png
from imumon.harmless import for_plot
from imumon.recordings.reduced import ACCEL

from . import DISPLAY_UNITS
from .calibration import Calibration
from .magnetometer import MagnetometerFit

CHANNELS_PER_ROW = 3  # x, y and z of one sensor, where each has a curve


def write_calibration_plot(path: Path, result: Calibration, title: str) -> None:
    """Draw each channel to a PNG: above curve and points, below the residuals.

    A residual has a bar of one standard deviation, the white noise of its samples.  The band is the model's
    `residual_sd`, which is without that noise: where the points scatter by noise they go beyond it.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    columns, rows = min(CHANNELS_PER_ROW, len(result.fits)), int(np.ceil(len(result.fits) / CHANNELS_PER_ROW))
    figure = Figure(figsize=(4.8 * columns, 6.4 * rows), layout="constrained")
    grid = figure.add_gridspec(2 * rows, columns, height_ratios=(2, 1) * rows)
    for number, name in enumerate(result.fits):
        row, column = divmod(number, columns)
        above, below = (figure.add_subplot(grid[2 * row + half, column]) for half in range(2))
        _draw(above, below, name, result)
    figure.suptitle(f"{for_plot(title)}: bias over temperature", fontsize=11)
    write_png(path, figure, 110)


def _draw(above: Axes, below: Axes, name: str, result: Calibration) -> None:
    fit, model = result.fits[name], result.model.channels[name]
    unit, factor = DISPLAY_UNITS[model.unit]
    points = fit.points
    left = points.value - fit.choice.curve.value(points.temperature)
    degc = np.linspace(points.temperature.min(), points.temperature.max(), 400)
    # About the curve of the model: of an accelerometer that is without the constant, which is gravity's.
    bias = left + model.curve.value(points.temperature)
    above.plot(points.temperature, factor * bias, ".", ms=2, color="0.6", label="at rest")
    above.plot(degc, factor * model.curve.value(degc), color="#d03c3c", lw=1.2, label=fit.choice.name)
    above.set_title(name, loc="right")
    above.set(ylabel=f"bias minus its middle [{unit}]" if name in ACCEL else f"bias [{unit}]")
    noise, sd = factor * np.sqrt(points.white), factor * model.residual_sd
    below.errorbar(
        points.temperature, factor * left, noise,
        fmt=".", ms=3, color="#3b78d8", ecolor="#b9cdf0", elinewidth=0.7,
        label="at rest, 1σ of the noise of its samples",
    )  # fmt: skip
    below.axhspan(
        -sd, sd, color="#d03c3c", alpha=0.35, lw=0, label=f"residual, ±1σ: {sd:.2g} {unit}", zorder=3
    )
    below.set(xlabel="temperature [°C]", ylabel=f"bias minus the curve [{unit}]")
    for axes in (above, below):
        axes.grid(color="0.9", lw=0.5)
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), fontsize=8, frameon=False, borderpad=0.1)


def write_magnetometer_plot(path: Path, fit: MagnetometerFit, title: str) -> None:
    """Draw readings, field, and the circle that the field should lie in, to a PNG.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    model = fit.model
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    unit = model.unit.replace("uT", "µT")
    circle = f"field, {model.field:.4g} {unit}"
    readings = fit.readings[:: 1 + len(fit.readings) // 1500]  # more make the file large, and hide each other
    field = model.corrected(readings)
    figure = Figure(figsize=(13.0, 4.8), layout="constrained")
    for number, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        axes = figure.add_subplot(1, 3, number + 1)
        axes.plot(readings[:, i], readings[:, j], ".", ms=2, color="0.65", label="as sent")
        axes.plot(field[:, i], field[:, j], ".", ms=2, color="#3b78d8", label="corrected")
        axes.plot(model.field * np.cos(turn), model.field * np.sin(turn), color="0.2", lw=0.9, label=circle)
        axes.plot(model.hard_iron[i], model.hard_iron[j], "+", ms=11, color="#d03c3c", label="hard iron")
        axes.set(xlabel=f"{'xyz'[i]} [{unit}]", ylabel=f"{'xyz'[j]} [{unit}]", aspect="equal")
        axes.grid(color="0.9", lw=0.5)
    figure.axes[0].legend(loc="upper right", fontsize=9, framealpha=0.9)
    figure.suptitle(
        f"{for_plot(title)}: scatter of the strength {fit.residual_before:.2g} {unit} as sent, "
        f"{model.residual_sd:.2g} {unit} corrected; {model.coverage:.0%} of the directions",
        fontsize=11,
    )
    write_png(path, figure, 110)
