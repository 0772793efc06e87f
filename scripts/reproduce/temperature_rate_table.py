"""Errors of the methods for the rate of temperature on simulated and measured records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from study import Options, Study, Table
from temperature_rate_comparison import DifferenceRate, KalmanRate, Method, estimate, reference_fit
from temperature_rate_figures import draw
from temperature_rate_records import PER_HOUR, SHAPES, Record, measured, simulate

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.stage import MultipleModelRate
from imumon.filters.rates import RateEstimate
from imumon.papers.fir import FirRate, Params

BUFFER = 1000
STEP = 0.05
SETTLED_MIN, MEASURED_MIN = 20.0, 3.0
"""From then on errors count, simulated and measured."""
HEADS = ("record", "method", "rms °C/h", "max °C/h", "jump °C/h", "delay s", "within 2σ")


def two_sided(record: Record) -> RateEstimate:
    """Return the default method run forward and backward in time, merged: what the future could add."""
    ahead = estimate(MultipleModelRate(), record)
    reverse = (record.time_ns[-1] - record.time_ns)[::-1]
    back = MultipleModelRate().process(reverse, np.zeros(len(reverse), np.int64), record.reading[::-1])
    forward = ahead.rate_sd**-2.0
    backward = back.rate_sd[::-1] ** -2.0
    total = forward + backward
    rate = (forward * ahead.rate - backward * back.rate[::-1]) / total
    return RateEstimate(ahead.temperature, rate, ahead.temperature_sd, total**-0.5)


def methods() -> Mapping[str, Method]:
    """Return fresh filters by name."""
    return {
        "FIR 300/180": FirRate(Params(STEP, 300.0, 180.0, BUFFER)),
        "FIR 180/120": FirRate(Params(STEP, 180.0, 120.0, BUFFER)),
        "FIR 300/180, buffer 90": FirRate(Params(STEP, 300.0, 180.0, 90)),
        "linear 300": FirRate(Params(STEP, 300.0, 300.0, BUFFER, order=2)),
        "Kalman": KalmanRate(STEP),
        "3 min difference": DifferenceRate(STEP),
        "multiple models": MultipleModelRate(),
    }


def delay_s(rate: FloatArray, truth: FloatArray, interval_s: float) -> float:
    """Return by how much the truth must be shifted to fit the estimate best, NaN if any shift does."""
    if np.ptp(truth) * PER_HOUR < 0.1:
        return float("nan")
    lags = np.unique(np.round(np.arange(-30.0, 301.0, 5.0) / interval_s).astype(int))
    errors = []
    low, high = int(-lags[0]), int(lags[-1])
    inner = slice(high, len(rate) - low)
    for lag in lags:
        shifted = truth[high - lag : len(truth) - low - lag]
        errors.append(np.mean((rate[inner] - shifted) ** 2))
    return float(lags[int(np.argmin(errors))] * interval_s)


def row(record: Record, name: str, result: RateEstimate, settled_min: float) -> list[str]:
    """Return rms, largest error, largest change between samples (°C/h), delay (s), share within 2σ."""
    late = (record.minutes > settled_min) & np.isfinite(result.rate)
    rate, truth = result.rate[late], record.rate[late]
    error = (rate - truth) * PER_HOUR
    interval = float(np.median(np.diff(record.time_ns))) * 1e-9
    share = float(np.mean(np.abs(error) < 2 * PER_HOUR * result.rate_sd[late]))
    jump = float(np.abs(np.diff(rate)).max()) * PER_HOUR
    delay = delay_s(rate, truth, interval)
    numbers = [f"{np.sqrt(np.mean(error**2)):.3g}", f"{np.abs(error).max():.3g}", f"{jump:.2g}"]
    return [record.name, name, *numbers, "-" if np.isnan(delay) else f"{delay:.0f}", f"{100 * share:.1f} %"]


def rows(records: Sequence[Record], settled_min: float) -> Iterator[list[str]]:
    """Yield a row for each record and method; the last two methods see the future."""
    for record in records:
        for name, method in methods().items():
            yield row(record, name, estimate(method, record), settled_min)
        reference = reference_fit(record.time_ns, record.reading, STEP)
        yield row(record, "reference (eq. 5), centred", reference, settled_min)
        yield row(record, "multiple models, both ways", two_sided(record), settled_min)


def tables(given: Options) -> Iterator[Table]:
    """Yield simulated and measured records."""
    if given.quick:
        yield Table("", HEADS, list(rows([simulate("heating", 0.0, hours=1.0)], SETTLED_MIN)))
        return
    title = f"Simulated at 10 Hz for 3 h, step {STEP} °C, after {SETTLED_MIN:.0f} min; FIR buffer {BUFFER}"
    simulated = [simulate(shape, noise) for shape in SHAPES for noise in (0.0, 0.005)]
    yield Table(title, HEADS, list(rows(simulated, SETTLED_MIN)))
    title = "Measured, after 3 min; the truth is a centred local cubic fit to all readings"
    yield Table(title, HEADS, list(rows(measured(given.data), MEASURED_MIN)))


STUDY = Study(tables, draw=draw)
