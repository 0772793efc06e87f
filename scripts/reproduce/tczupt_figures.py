"""Figures 5, 6 and 9 to 16 of Fontanella et al., on the simulated unit, and two of what lies beyond."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import figures
import numpy as np
from matplotlib.axes import Axes
from scipy.signal import butter, lfilter
from study import Options
from tczupt_records import (
    DPH,
    HIGHEST,
    LATITUDE_DEG,
    LOWEST,
    RATE_HZ,
    RESIDUAL,
    ZEROING,
    Filter,
    Record,
    curves,
    moving_average,
    run,
    simulate,
    true_model,
)

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import GyroBias

EVERY = slice(None, None, 50)
ZUPT, TCZUPT = Filter("calibrated"), Filter("rate", k=0.5)


def _axes(title: str, rows: int = 1, x: str = "s after the zeroing", y: str = "deg/h") -> list[Axes]:
    return figures.axes(title, rows, x=x, y=y)


def _save(drawn: list[Axes], name: str) -> Path:
    return figures.save(drawn, "tczupt", name)


def _smooth(values: FloatArray) -> FloatArray:
    b, a = butter(2, 1.0, fs=RATE_HZ)
    start = values[:ZEROING].mean(0)
    return np.asarray(lfilter(b, a, values - start, axis=0) + start)


def _inputs(record: Record) -> Iterator[Path]:
    levels = np.append(np.arange(LOWEST, HIGHEST - 5.0, 5.0), HIGHEST)
    axes = _axes("5. Bias at the levels of the soak test, and the curve", 3, "degC", "deg/s")
    fine = np.linspace(LOWEST, HIGHEST, 300)
    for j, ax in enumerate(axes):
        ax.plot(fine, np.degrees(curves(fine)[:, j]), lw=0.9)
        ax.plot(levels, np.degrees(curves(levels)[:, j]), "o", ms=4, label="xyz"[j])
    yield _save(axes, "figure-05")
    axes = _axes("6. Ramp test: raw rate (1 Hz low-pass) over temperature", 3, "degC", "deg/s")
    raw = np.degrees(_smooth(record.gyro))
    for j, ax in enumerate(axes):
        ax.plot(record.temperature[EVERY], raw[EVERY, j], lw=0.6, label="xyz"[j])
    yield _save(axes, "figure-06")
    calibrated = record.gyro - curves(record.temperature)
    for number, name, data in (
        (9, "calibrated data, for ZUPT", calibrated),
        (10, "raw data, for TCZUPT", record.gyro),
    ):
        axes = _axes(f"{number}. Input (1 Hz low-pass): {name}", 3, y="deg/s")
        for j, ax in enumerate(axes):
            ax.plot(record.seconds[EVERY], np.degrees(_smooth(data))[EVERY, j], lw=0.6, label="xyz"[j])
        yield _save(axes, f"figure-{number:02d}")


def _biases(record: Record) -> Iterator[Path]:
    average = moving_average(record)[ZEROING:]
    seconds = record.seconds[ZEROING:]
    for first, residual in ((11, 0.0), (14, RESIDUAL)):
        found = {
            name: run(record, chosen, residual) + record.bias[ZEROING:] / DPH
            for name, chosen in (("ZUPT", ZUPT), ("TCZUPT", TCZUPT))
        }
        for j, axis in enumerate("xyz"):
            axes = _axes(
                f"{first + j}. Bias of {axis}, residual {residual:.0f} deg/h: whole, and less the truth", 2
            )
            truth = record.bias[ZEROING:, j] / DPH
            axes[0].plot(seconds[EVERY], average[EVERY, j] / DPH, lw=0.8, label="30 s moving average")
            axes[1].plot(
                seconds[EVERY], average[EVERY, j] / DPH - truth[EVERY], lw=0.6, label="30 s moving average"
            )
            for name, bias in found.items():
                axes[0].plot(seconds[EVERY], bias[EVERY, j], lw=0.8, label=name)
                axes[1].plot(seconds[EVERY], bias[EVERY, j] - truth[EVERY], lw=0.9, label=name)
            yield _save(axes, f"figure-{first + j:02d}")


def _equal_terms(record: Record) -> Iterator[Path]:
    (ax,) = _axes("Residual of 15 deg/h, y axis: equal K and p0 make one filter of the two")
    seconds = record.seconds[ZEROING:]
    for k, p0 in ((0.1, 2.2), (0.5, 2.2), (0.1, 15.0)):
        for name, thermal, style in (("ZUPT", "calibrated", "-"), ("TCZUPT", "increments", ":")):
            error = run(record, Filter(thermal, k=k, p0=p0), RESIDUAL)
            width = 1.0 if style == "-" else 2.2
            ax.plot(seconds[EVERY], error[EVERY, 1], style, lw=width, label=f"{name}, K {k}, p0 {p0:.1f}")
    yield _save([ax], "equal-terms")


def _in_motion(record: Record) -> Iterator[Path]:
    (ax,) = _axes("No update from 330 s on: bias of y less the truth, with 2σ")
    block = record.block.with_columns({"at_rest": (record.seconds < 330.0).astype(np.int64)})
    for name, stage in (
        ("held (standard)", GyroBias(latitude_deg=LATITUDE_DEG, heading_deg=0.0)),
        ("thermal", GyroBias(None, true_model(), "thermal", LATITUDE_DEG, 0.0)),
    ):
        added = stage.process(block)
        error = (added["gyro_bias_y"] - record.bias[:, 1]) / DPH
        sd = added["gyro_bias_sd_y"] / DPH
        part = slice(ZEROING, None, 50)
        ax.plot(record.seconds[part], error[part], lw=1.0, label=name)
        ax.fill_between(record.seconds[part], (error - 2 * sd)[part], (error + 2 * sd)[part], alpha=0.2, lw=0)
    yield _save([ax], "in-motion")


def draw(_: Options) -> Iterator[Path]:
    """Draw all figures from one record of the ramp test."""
    record = simulate("crs05-ramp", 0)
    for section in (_inputs, _biases, _equal_terms, _in_motion):
        yield from section(record)
