"""Errors of all temperature-rate methods on simulated and measured records, and the figures of the paper."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from temperature_rate_band import bound, consistency, elsewhere
from temperature_rate_comparison import DifferenceRate, KalmanRate, reference_fit
from temperature_rate_figures import draw_all
from temperature_rate_kalman import search
from temperature_rate_records import PER_HOUR, Record, measured, simulate

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.temperature_rate.method import MultipleModelRate
from imumon.filters.rates import RateEstimate
from imumon.papers.fir import FirRate, Params

ROOT = Path(__file__).resolve().parents[2]
BUFFER = 1000
STEP = 0.05
SETTLED_MIN = 20.0

Method = Callable[[Record], RateEstimate]


def _segment(record: Record) -> IntArray:
    return np.zeros(len(record.reading), np.int64)


def two_sided(record: Record) -> RateEstimate:
    """Return the default method run forward and backward in time, merged: what the future could add."""
    ahead = MultipleModelRate().process(record.time_ns, _segment(record), record.reading)
    reverse = (record.time_ns[-1] - record.time_ns)[::-1]
    back = MultipleModelRate().process(reverse, _segment(record), record.reading[::-1])
    forward = ahead.rate_sd**-2.0
    backward = back.rate_sd[::-1] ** -2.0
    total = forward + backward
    rate = (forward * ahead.rate - backward * back.rate[::-1]) / total
    return RateEstimate(ahead.temperature, rate, ahead.temperature_sd, total**-0.5)


METHODS: dict[str, Method] = {
    "FIR 300/180": lambda r: FirRate(Params(STEP, 300.0, 180.0, BUFFER)).process(
        r.time_ns, _segment(r), r.reading
    ),
    "FIR 180/120": lambda r: FirRate(Params(STEP, 180.0, 120.0, BUFFER)).process(
        r.time_ns, _segment(r), r.reading
    ),
    "FIR 300/180, buffer 90": lambda r: FirRate(Params(STEP, 300.0, 180.0, 90)).process(
        r.time_ns, _segment(r), r.reading
    ),
    "linear 300": lambda r: FirRate(Params(STEP, 300.0, 300.0, BUFFER, order=2)).process(
        r.time_ns, _segment(r), r.reading
    ),
    "Kalman": lambda r: KalmanRate(STEP).process(r.time_ns, _segment(r), r.reading),
    "3 min difference": lambda r: DifferenceRate(STEP).process(r.time_ns, _segment(r), r.reading),
    "multiple models": lambda r: MultipleModelRate().process(r.time_ns, _segment(r), r.reading),
    "reference (eq. 5), centred": lambda r: reference_fit(r.time_ns, r.reading, STEP),
    "multiple models, both ways": two_sided,
}
"""The last two see the future."""


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


def row(record: Record, result: RateEstimate, settled_min: float) -> tuple[float, ...]:
    """Return rms, largest error, largest change between samples (°C/h), delay (s), share within 2σ."""
    late = (record.minutes > settled_min) & np.isfinite(result.rate)
    rate, truth = result.rate[late], record.rate[late]
    error = (rate - truth) * PER_HOUR
    interval = float(np.median(np.diff(record.time_ns))) * 1e-9
    share = float(np.mean(np.abs(error) < 2 * PER_HOUR * result.rate_sd[late]))
    jump = float(np.abs(np.diff(rate)).max()) * PER_HOUR
    rms = float(np.sqrt(np.mean(error**2)))
    return rms, float(np.abs(error).max()), jump, delay_s(rate, truth, interval), share


def table(records: Sequence[Record], settled_min: float) -> None:
    """Print a table in Markdown."""
    print("| record | method | rms °C/h | max °C/h | jump °C/h | delay s | within 2σ |")
    print("|---|---|---|---|---|---|---|")
    for record in records:
        for name, method in METHODS.items():
            rms, largest, jump, delay, share = row(record, method(record), settled_min)
            late = "-" if np.isnan(delay) else f"{delay:.0f}"
            numbers = f"{rms:.3g} | {largest:.3g} | {jump:.2g} | {late} | {100 * share:.1f} %"
            print(f"| {record.name} | {name} | {numbers} |", flush=True)


def ensemble() -> None:
    """Print what the default method does over several seeds, in Markdown."""
    print("| shape | noise °C | rms °C/h | jump °C/h | within 2σ |")
    print("|---|---|---|---|---|")
    for shape in ("heating", "lively", "wobble", "steady"):
        for noise in (0.002, 0.005, 0.02):
            rows = []
            for seed in range(5):
                record = simulate(shape, noise, seed)
                rows.append(row(record, METHODS["multiple models"](record), SETTLED_MIN))
            rms, _, jump, _, share = np.array(rows).T
            numbers = f"{rms.min():.2g} to {rms.max():.2g} | {jump.max():.2g}"
            print(f"| {shape} | {noise} | {numbers} | {100 * share.min():.1f} to {100 * share.max():.1f} % |")


def main() -> None:
    """Write tables to standard output and figures to docs/figures/temperature-rate."""
    default = os.environ.get("IMUMON_DATA", str(ROOT.parent / "shared" / "data"))
    parser = argparse.ArgumentParser(prog="scripts/reproduce/temperature_rate", description=__doc__)
    parser.add_argument("data", nargs="?", default=default, help="folder of the measured recordings")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    if given.quick:
        table([simulate("heating", 0.0, hours=1.0)], SETTLED_MIN)
        return
    folder = Path(given.data)
    print(f"Simulated at 10 Hz for 3 h, step {STEP} °C, after {SETTLED_MIN:.0f} min; FIR buffer {BUFFER}.\n")
    shapes = ("heating", "lively", "wobble", "steady")
    table([simulate(shape, noise) for shape in shapes for noise in (0.0, 0.005)], SETTLED_MIN)
    print("\nThe paper's search for a Kalman filter.")
    search()
    print("\nThe default method over five seeds.\n")
    ensemble()
    print("\nThe band, and that of an exact posterior that knows the shape but for offset and factor.\n")
    bound()
    print("\nThe band on temperatures drawn from the hypotheses.\n")
    consistency()
    print("\nThe band on other records.\n")
    elsewhere()
    records = measured(folder)
    if records:
        print("\nMeasured, after 3 min; the truth is a centred local cubic fit to all readings.\n")
        table(records, 3.0)
    else:
        print(f"\nNo measured records in {folder}.")
    out = ROOT / "docs" / "figures" / "temperature-rate"
    out.mkdir(parents=True, exist_ok=True)
    for path in draw_all(out):
        print(path.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
