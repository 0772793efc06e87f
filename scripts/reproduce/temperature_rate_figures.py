"""Figures 1 to 4 and 6 to 10 of Kozlov and Tarygin, Sensors 2020, 20(5), 1299, on simulated records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import figures
from matplotlib.axes import Axes
from study import Options, Study, Table, rms
from temperature_rate_comparison import DifferenceRate, KalmanRate, estimate, reference_fit
from temperature_rate_records import PER_HOUR, Record, heating, simulate

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.filters.rates import RateEstimate
from imumon.papers.fir import FirRate, Params

STEP, BUFFER, NOISE = 0.05, 1000, 0.002
SETTLED_MIN = 20.0
EVERY = slice(None, None, 50)


def fir(record: Record, window_s: float, constant_s: float, order: int = 3) -> RateEstimate:
    """Return what the published filter makes of a record."""
    return estimate(FirRate(Params(STEP, window_s, constant_s, BUFFER, order=order)), record)


def _axes(title: str, rows: int = 1, y: str = "°C/h") -> list[Axes]:
    return figures.axes(title, rows, x="min", y=y, size=(8.0, 3.6 * rows))


def _save(drawn: list[Axes], number: int) -> Path:
    return figures.save(drawn, "temperature-rate", f"figure-{number:02d}")


def _curves(ax: Axes, record: Record, curves: Mapping[str, FloatArray], top: float) -> None:
    for name, rate in curves.items():
        ax.plot(record.minutes[EVERY], rate[EVERY] * PER_HOUR, lw=0.9, label=name)
    ax.set_ylim(-3, top)


def _band(ax: Axes, record: Record, result: RateEstimate) -> None:
    middle, width = result.rate[EVERY] * PER_HOUR, 2 * result.rate_sd[EVERY] * PER_HOUR
    ax.fill_between(
        record.minutes[EVERY], middle - width, middle + width, color="tab:orange", alpha=0.3, lw=0
    )


def _readings(calm: Record, lively: Record) -> Iterator[Path]:
    drawn = _axes("1. Sensor output while the unit heats itself: whole, slow and fast", 3, "°C")
    parts = {
        "whole record": (0, 240),
        "slow: the reading stands still, then flickers": (200, 230),
        "fast": (60, 70),
    }
    for ax, (what, (start, stop)) in zip(drawn, parts.items(), strict=True):
        part = (calm.minutes >= start) & (calm.minutes <= stop)
        ax.plot(calm.minutes[part], calm.reading[part], lw=0.6)
        ax.plot(calm.minutes[part], calm.temperature[part], lw=0.9)
        ax.set_title(what, fontsize=9)
    yield _save(drawn, 1)
    (ax,) = _axes("2. Reading less six exponentials to 67.3 °C with a base constant of 90 min", y="°C")
    model, rate = heating(calm.seconds)
    ax.plot(calm.minutes[::20], (calm.reading - model)[::20], lw=0.4)
    yield _save([ax], 2)
    (ax,) = _axes("3. Derivative of the exponentials and 3 min numerical differentiator")
    _curves(ax, calm, {"difference": estimate(DifferenceRate(STEP), calm).rate, "exponentials": rate}, 50)
    yield _save([ax], 3)
    (ax,) = _axes("4. Reference: centred 4 min fits, with 2σ; rate changes of 1 °C/h within 10 min")
    reference = reference_fit(lively.time_ns, lively.reading, STEP)
    _band(ax, lively, reference)
    _curves(ax, lively, {"reference (eq. 5)": reference.rate, "truth": lively.rate}, 20)
    yield _save([ax], 4)


def _filters(calm: Record, lively: Record) -> Iterator[Path]:
    drawn = _axes("6. Real-time filters with 2σ, self-heating (top) and with variations (bottom)", 2)
    for ax, record, window, constant in ((drawn[0], calm, 300.0, 180.0), (drawn[1], lively, 180.0, 120.0)):
        published = fir(record, window, constant)
        _band(ax, record, published)
        curves = {
            "difference": estimate(DifferenceRate(STEP), record).rate,
            f"FIR {window:.0f}/{constant:.0f}": published.rate,
            "multiple models": estimate(MultipleModelRate(), record).rate,
            "truth": record.rate,
        }
        _curves(ax, record, curves, 20)
    yield _save(drawn, 6)
    pairs: dict[str, tuple[Record, dict[str, RateEstimate]]] = {
        "7. Conventional Kalman filter": (lively, {"Kalman": estimate(KalmanRate(STEP), lively)}),
        "8. Exponential and linear model, T_w 5 min": (
            calm,
            {"linear": fir(calm, 300.0, 300.0, order=2), "exponential": fir(calm, 300.0, 180.0)},
        ),
        "9. Windows of 3 and 5 min": (
            lively,
            {f"T_w {w:.0f} s": fir(lively, w, 120.0) for w in (180.0, 300.0)},
        ),
        "10. Time constants of 3 and 2 min": (
            lively,
            {f"T0 {c:.0f} s": fir(lively, 180.0, c) for c in (180.0, 120.0)},
        ),
    }
    for number, (title, (record, results)) in enumerate(pairs.items(), 7):
        (ax,) = _axes(title)
        _band(ax, record, next(iter(results.values())))
        _curves(ax, record, {**{name: r.rate for name, r in results.items()}, "truth": record.rate}, 30)
        yield _save([ax], number)


def draw(_: Options) -> Iterator[Path]:
    """Draw the figures; figure 5 of the paper is a flowchart."""
    calm = simulate("heating", NOISE, hours=4.0)
    lively = simulate("lively", NOISE, hours=3.0)
    yield from _readings(calm, lively)
    yield from _filters(calm, lively)


def tables(_: Options) -> Iterator[Table]:
    """Yield what the buffer of the paper costs while the unit heats itself, noise of 0.005 °C."""
    record = simulate("heating", 0.005)
    rows = []
    for size in (90, BUFFER):
        found = estimate(FirRate(Params(STEP, 300.0, 180.0, size)), record)
        late = record.minutes > SETTLED_MIN
        rows.append([f"{size}", f"{rms(found.rate[late] - record.rate[late]) * PER_HOUR:.2f}"])
    yield Table("FIR 300/180", ["measurements in the buffer", "rms °C/h"], rows)


STUDY = Study(tables, draw=draw)
