"""Figures 1 and 2 of Shi Gang et al. under both meanings of "compensated", and what they do not show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import allantools
import matplotlib as mpl
import numpy as np
from random_error_methods import FITTED, PUBLISHED, fit_record, published, slow
from random_error_records import RATE_HZ, VARIANCE, Record, simulate, without_temperature

from imumon.blocks import FloatArray
from imumon.papers.sigma_points import ModelNL, SigmaPointFilter

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

HOUR = 3600.0
DELTA = 1e-2
"""deg/s: the setting under which the published order holds."""
METHODS = tuple(name for name in PUBLISHED if name != "SR-RSUKF 0.5")


def draw_all(folder: Path, records: Sequence[Record]) -> Iterator[Path]:
    """Write the figures as PNG and yield their paths."""
    minute = simulate(60.0, 1)
    yield _save(_series(minute), folder / "figure-1-series.png")
    yield _save(_deviations(minute), folder / "figure-2-allan.png")
    yield _save(_truth(simulate(HOUR, 101)), folder / "figure-3-true-drift.png")
    yield _save(_rotation(minute), folder / "figure-4-rotation.png")
    yield _save(_escape(minute), folder / "figure-5-phi.png")
    if records:
        yield _save(_measured(records), folder / "figure-6-measured.png")


def _save(figure: Figure, path: Path) -> Path:
    figure.tight_layout()
    figure.savefig(path)
    plt.close(figure)
    return path


def _grid(title: str, rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(rows, columns, figsize=size, dpi=80, squeeze=False)
    figure.suptitle(title, fontsize=10)
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    return figure, list(axes.flat)


def _series(record: Record) -> Figure:
    figure, axes = _grid(
        f"1. Raw and compensated, δ¹ = {DELTA:g} deg/s: (a) raw less prediction, (b) estimate", 3, 2, (10, 8)
    )
    t = np.arange(len(record.reading)) / RATE_HZ
    for row, name in enumerate(METHODS):
        output = published(name, record.reading, DELTA)
        for column, (meaning, values) in enumerate(
            (("a", record.reading - output.predicted), ("b", output.estimate))
        ):
            ax = axes[2 * row + column]
            ax.plot(t, record.reading, lw=0.3, color="0.7", label="raw")
            ax.plot(t, values, lw=0.4, label=f"{name} ({meaning})")
            ax.set(xlabel="s", ylabel="deg/s", ylim=(-1.4, 1.4))
            ax.legend(fontsize=8, loc="upper right")
    return figure


def _curve(ax: Axes, name: str, values: FloatArray, rate: float, **style: object) -> None:
    taus, deviations, _, _ = allantools.oadev(values, rate=rate, data_type="freq", taus="decade")
    ax.loglog(taus, deviations * HOUR, label=name, **style)


def _deviations(record: Record) -> Figure:
    figure, axes = _grid("2. Overlapping Allan deviation, 60 s", 2, 3, (12, 7))
    for column, delta in enumerate((3.9e-5, 1e-3, 1e-2)):
        for row, meaning in enumerate("ab"):
            ax = axes[3 * row + column]
            _curve(ax, "raw", record.reading, RATE_HZ, color="0.4")
            for name in METHODS:
                output = published(name, record.reading, delta)
                values = record.reading - output.predicted if meaning == "a" else output.estimate
                _curve(ax, name, values, RATE_HZ)
            ax.set(title=f"({meaning}), δ¹ = {delta:g} deg/s", xlabel="τ, s", ylabel="°/h", ylim=(1, 2000))
            ax.legend(fontsize=7)
    return figure


def _truth(record: Record) -> Figure:
    figure, (ax,) = _grid("3. True drift, the default estimate with its 2σ band, and others", 1, 1, (9, 4.5))
    every = slice(60 * RATE_HZ, None, RATE_HZ)
    t = np.arange(len(record.reading))[every] / RATE_HZ / 60
    default = slow("drift", record)
    middle, width = default.estimate[every] * HOUR, 2 * default.sd[every] * HOUR
    ax.fill_between(t, middle - width, middle + width, color="tab:blue", alpha=0.2, lw=0)
    curves: Mapping[str, FloatArray] = {
        f"SR-RSUKF 0.95, δ¹ {FITTED:g}": published("SR-RSUKF 0.95", record.reading, FITTED).estimate,
        "true drift": record.drift,
        "hold of the first 60 s": slow("hold 60 s", record).estimate,
        "exponential mean, 85 s": slow("exponential 85 s", record).estimate,
        "default": default.estimate,
    }
    colours = ("tab:red", "0.4", "tab:green", "tab:orange", "tab:blue")
    for (name, values), colour in zip(curves.items(), colours, strict=True):
        ax.plot(t, values[every] * HOUR, lw=0.9, color=colour, label=name)
    ax.set(xlabel="min", ylabel="°/h", ylim=(-120, 120))
    ax.legend(fontsize=8)
    return figure


def _rotation(record: Record) -> Figure:
    figure, axes = _grid(
        "4. A true turn of 10 deg: angle from the rate less the prediction (a)", 1, 3, (12, 4)
    )
    t = np.arange(len(record.reading)) / RATE_HZ
    turn = np.where((t >= 20) & (t < 40), 0.5, 0.0)
    for ax, delta in zip(axes, (3.9e-5, 1e-3, 1e-2), strict=True):
        ax.plot(t, np.cumsum(turn) / RATE_HZ, color="0.4", lw=1.5, label="true")
        ax.plot(t, np.cumsum(record.reading + turn) / RATE_HZ, color="0.7", lw=0.8, label="raw")
        for name in METHODS:
            output = published(name, record.reading + turn, delta)
            ax.plot(t, np.cumsum(record.reading + turn - output.predicted) / RATE_HZ, lw=1.0, label=name)
        ax.set(title=f"δ¹ = {delta:g} deg/s", xlabel="s", ylabel="deg")
        ax.legend(fontsize=7)
    return figure


def _escape(record: Record) -> Figure:
    figure, (ax,) = _grid(
        "5. φ while the unit moves from 20 to 40 s (50 deg/s at 2 Hz), δ¹ = 0.001 deg/s", 1, 1, (9, 3.5)
    )
    t = np.arange(len(record.reading)) / RATE_HZ
    moving = (t >= 20) & (t < 40)
    z = record.reading + np.where(moving, 50 * np.sin(4 * np.pi * t), 0.0)
    model = ModelNL((0.0, 0.0, 0.0, 1e-3, 0.0), (1e-3, 1e-3, 0.1, 0.0, 0.0), VARIANCE)
    runs = {
        "as published": SigmaPointFilter(model).process(z),
        "clamped at ±0.9": SigmaPointFilter(model, phi_limit=0.9).process(z),
        "frozen in motion": SigmaPointFilter(model, phi_limit=0.9).process(z, ~moving),
    }
    for name, result in runs.items():
        ax.plot(t, result.phi, lw=0.8, label=name)
    ax.set(xlabel="s", ylabel="φ")
    ax.legend(fontsize=8)
    return figure


def _measured(records: Sequence[Record]) -> Figure:
    shown = [record for record in records if record.name.endswith((" x", " z"))][:6]
    figure, axes = _grid("6. Measured, static, δ¹ and R fitted: overlapping Allan deviation", 2, 3, (12, 7))
    for ax, record in zip(axes, shown, strict=False):
        reading = without_temperature(record)
        _curve(ax, "raw", record.reading, record.rate_hz, color="0.4")
        _curve(ax, "less cubic in temperature", reading, record.rate_hz, color="k", ls="--")
        delta, noise = fit_record(record, reading)
        for name in METHODS:
            output = published(name, reading, delta, noise)
            _curve(ax, f"{name} (a)", reading - output.predicted, record.rate_hz)
        ax.set(title=record.name, xlabel="τ, s", ylabel="°/h")
        ax.legend(fontsize=7)
    return figure
