"""Figures 1 and 2 of Shi Gang et al. under both meanings of "compensated", and what they do not show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import allantools
import figures
import numpy as np
from matplotlib.axes import Axes
from random_error_methods import DELTAS, FITTED, PUBLISHED, fit_record, published, slow
from random_error_records import RATE_HZ, Record, measured, simulate, without_temperature
from study import Options

from imumon.blocks import FloatArray

HOUR = 3600.0
DELTA = 1e-2
"""deg/s: the setting under which the published order holds."""
METHODS = tuple(name for name in PUBLISHED if name != "SR-RSUKF 0.5")


def draw(given: Options) -> Iterator[Path]:
    """Draw the figures; the last one where there are measured recordings."""
    minute = simulate(60.0, 1)
    drawn = {
        "figure-1-series": _series(minute),
        "figure-2-allan": _deviations(minute),
        "figure-3-true-drift": _truth(simulate(HOUR, 101)),
        "figure-4-rotation": _rotation(minute),
    }
    if records := measured(given.data):
        drawn["figure-6-measured"] = _measured(records)
    for name, axes in drawn.items():
        yield figures.save(axes, "random-error", name)


def _series(record: Record) -> list[Axes]:
    title = f"1. Raw and compensated, δ¹ = {DELTA:g} deg/s: (a) raw less prediction, (b) estimate"
    axes = figures.axes(title, 3, 2, size=(10.0, 8.0))
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
    return axes


def _curve(ax: Axes, name: str, values: FloatArray, rate: float, **style: object) -> None:
    taus, deviations, _, _ = allantools.oadev(values, rate=rate, data_type="freq", taus="decade")
    ax.loglog(taus, deviations * HOUR, label=name, **style)


def _deviations(record: Record) -> list[Axes]:
    axes = figures.axes("2. Overlapping Allan deviation, 60 s", 2, 3, size=(12.0, 7.0))
    for column, delta in enumerate(DELTAS):
        for row, meaning in enumerate("ab"):
            ax = axes[3 * row + column]
            _curve(ax, "raw", record.reading, RATE_HZ, color="0.4")
            for name in METHODS:
                output = published(name, record.reading, delta)
                values = record.reading - output.predicted if meaning == "a" else output.estimate
                _curve(ax, name, values, RATE_HZ)
            ax.set(title=f"({meaning}), δ¹ = {delta:g} deg/s", xlabel="τ, s", ylabel="°/h", ylim=(1, 2000))
    return axes


def _truth(record: Record) -> list[Axes]:
    axes = figures.axes("3. True drift, the default estimate with its 2σ band, and others", size=(9.0, 4.5))
    ax = axes[0]
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
    return axes


def _rotation(record: Record) -> list[Axes]:
    title = "4. A true turn of 10 deg: angle from the rate less the prediction (a)"
    axes = figures.axes(title, 1, 3, size=(12.0, 4.0))
    t = np.arange(len(record.reading)) / RATE_HZ
    turn = np.where((t >= 20) & (t < 40), 0.5, 0.0)
    for ax, delta in zip(axes, DELTAS, strict=True):
        ax.plot(t, np.cumsum(turn) / RATE_HZ, color="0.4", lw=1.5, label="true")
        ax.plot(t, np.cumsum(record.reading + turn) / RATE_HZ, color="0.7", lw=0.8, label="raw")
        for name in METHODS:
            output = published(name, record.reading + turn, delta)
            ax.plot(t, np.cumsum(record.reading + turn - output.predicted) / RATE_HZ, lw=1.0, label=name)
        ax.set(title=f"δ¹ = {delta:g} deg/s", xlabel="s", ylabel="deg")
    return axes


def _measured(records: Sequence[Record]) -> list[Axes]:
    shown = [record for record in records if record.name.endswith((" x", " z"))][:6]
    title = "6. Measured, static, δ¹ and R fitted: overlapping Allan deviation"
    axes = figures.axes(title, 2, 3, size=(12.0, 7.0))
    for ax, record in zip(axes, shown, strict=False):
        reading = without_temperature(record)
        _curve(ax, "raw", record.reading, record.rate_hz, color="0.4")
        _curve(ax, "less cubic in temperature", reading, record.rate_hz, color="k", ls="--")
        delta, noise = fit_record(record, reading)
        for name in METHODS:
            output = published(name, reading, delta, noise)
            _curve(ax, f"{name} (a)", reading - output.predicted, record.rate_hz)
        ax.set(title=record.name, xlabel="τ, s", ylabel="°/h")
    return axes
