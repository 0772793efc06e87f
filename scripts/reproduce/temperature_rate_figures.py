"""Figures 1 to 4 and 6 to 10 of Kozlov and Tarygin, Sensors 2020, 20(5), 1299, on simulated records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from temperature_rate_comparison import DifferenceRate, KalmanRate, reference_fit
from temperature_rate_records import PER_HOUR, Record, heating, simulate

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.filters.rates import RateEstimate
from imumon.papers.fir import FirRate, Params

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

STEP, BUFFER, NOISE = 0.05, 1000, 0.002


def _run(method: FirRate | KalmanRate | DifferenceRate | MultipleModelRate,
         record: Record) -> RateEstimate:  # fmt: skip
    return method.process(record.time_ns, np.zeros(len(record.reading), np.int64), record.reading)


def _axes(title: str, rows: int = 1) -> list[Axes]:
    figure, axes = plt.subplots(rows, 1, figsize=(8, 3.6 * rows), dpi=80, squeeze=False)
    figure.suptitle(title, fontsize=10)
    for ax in axes[:, 0]:
        ax.set_xlabel("min")
        ax.set_ylabel("°C/h")
        ax.grid(alpha=0.3)
    return list(axes[:, 0])


def _save(folder: Path, number: int) -> Path:
    path = folder / f"figure-{number:02d}.png"
    plt.tight_layout()
    plt.savefig(path)
    plt.close()
    return path


def _curves(ax: Axes, record: Record, curves: Mapping[str, FloatArray], top: float) -> None:
    every = slice(None, None, 50)
    for name, rate in curves.items():
        ax.plot(record.minutes[every], rate[every] * PER_HOUR, lw=0.9, label=name)
    ax.set_ylim(-3, top)
    ax.legend(fontsize=8)


def _band(ax: Axes, record: Record, result: RateEstimate) -> None:
    every = slice(None, None, 50)
    middle, width = result.rate[every] * PER_HOUR, 2 * result.rate_sd[every] * PER_HOUR
    ax.fill_between(
        record.minutes[every], middle - width, middle + width, color="tab:orange", alpha=0.3, lw=0
    )


def _inset(ax: Axes, record: Record, start: float, stop: float, what: str) -> None:
    part = (record.minutes >= start) & (record.minutes <= stop)
    ax.plot(record.minutes[part], record.reading[part], lw=0.6)
    ax.plot(record.minutes[part], record.temperature[part], lw=0.9)
    ax.set_title(what, fontsize=9)
    ax.set_ylabel("°C")


def _first_four(folder: Path, calm: Record, lively: Record) -> Iterator[Path]:
    axes = _axes("1. Sensor output while the unit heats itself: whole, slow and fast", 3)
    _inset(axes[0], calm, 0, 240, "whole record")
    _inset(axes[1], calm, 200, 230, "slow: the reading stands still, then flickers")
    _inset(axes[2], calm, 60, 70, "fast")
    yield _save(folder, 1)
    (ax,) = _axes("2. Reading less six exponentials to 67.3 °C with a base constant of 90 min")
    model, rate = heating(calm.seconds)
    ax.plot(calm.minutes[::20], (calm.reading - model)[::20], lw=0.4)
    ax.set_ylabel("°C")
    yield _save(folder, 2)
    (ax,) = _axes("3. Derivative of the exponentials and 3 min numerical differentiator")
    _curves(ax, calm, {"difference": _run(DifferenceRate(STEP), calm).rate, "exponentials": rate}, 50)
    yield _save(folder, 3)
    (ax,) = _axes("4. Reference: centred 4 min fits, with 2σ; rate changes of 1 °C/h within 10 min")
    reference = reference_fit(lively.time_ns, lively.reading, STEP)
    _band(ax, lively, reference)
    _curves(ax, lively, {"reference (eq. 5)": reference.rate, "truth": lively.rate}, 20)
    yield _save(folder, 4)


def _comparisons(folder: Path, calm: Record, lively: Record) -> Iterator[Path]:
    long = FirRate(Params(STEP, 300.0, 180.0, BUFFER))
    axes = _axes("6. Real-time filters with 2σ, self-heating (top) and with variations (bottom)", 2)
    for ax, record, window, constant in ((axes[0], calm, 300.0, 180.0), (axes[1], lively, 180.0, 120.0)):
        fir = _run(FirRate(Params(STEP, window, constant, BUFFER)), record)
        bank = _run(MultipleModelRate(), record)
        _band(ax, record, fir)
        curves = {
            "difference": _run(DifferenceRate(STEP), record).rate,
            f"FIR {window:.0f}/{constant:.0f}": fir.rate,
            "multiple models": bank.rate,
            "truth": record.rate,
        }
        _curves(ax, record, curves, 20)
    yield _save(folder, 6)
    pairs: list[tuple[int, str, Record, dict[str, RateEstimate]]] = [
        (7, "7. Conventional Kalman filter", lively, {"Kalman": _run(KalmanRate(STEP), lively)}),
        (8, "8. Exponential and linear model, T_w 5 min", calm,
         {"linear": _run(FirRate(Params(STEP, 300.0, 300.0, BUFFER, order=2)), calm),
          "exponential": _run(long, calm)}),
        (9, "9. Windows of 3 and 5 min", lively,
         {f"T_w {w:.0f} s": _run(FirRate(Params(STEP, w, 120.0, BUFFER)), lively)
          for w in (180.0, 300.0)}),
        (10, "10. Time constants of 3 and 2 min", lively,
         {f"T0 {c:.0f} s": _run(FirRate(Params(STEP, 180.0, c, BUFFER)), lively)
          for c in (180.0, 120.0)}),
    ]  # fmt: skip
    for number, title, record, results in pairs:
        (ax,) = _axes(title)
        _band(ax, record, next(iter(results.values())))
        _curves(ax, record, {**{name: r.rate for name, r in results.items()}, "truth": record.rate}, 30)
        yield _save(folder, number)


def draw_all(folder: Path) -> Iterator[Path]:
    """Write the figures as PNG and yield their paths; figure 5 of the paper is a flowchart."""
    calm = simulate("heating", NOISE, hours=4.0)
    lively = simulate("lively", NOISE, hours=3.0)
    yield from _first_four(folder, calm, lively)
    yield from _comparisons(folder, calm, lively)
