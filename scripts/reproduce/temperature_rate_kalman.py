"""The paper's search for a conventional Kalman filter (section 4.1): every combination of three variances."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from temperature_rate_comparison import RENEWAL_S
from temperature_rate_records import PER_HOUR, Record, simulate

from imumon.blocks import FloatArray
from imumon.papers.fir import FirRate, Params, model_row

STEP, BUFFER = 0.05, 1000
WALKS = np.append(0.0, 10.0 ** np.arange(-6.0, -0.4, 0.5))
"""Random walks tried for each of α, β and γ, °C/√s: from nothing to steps in a tenth of a second."""
NOISES = (0.25, 1.0)
"""Standard deviation of a measurement in steps: the paper's, and four times as much."""
SETTLED_S = 1200.0
RECORDS = (("heating", 300.0, 180.0), ("lively", 180.0, 120.0))
"""Shape, window and time constant: what the paper takes for the gyro's and for the accelerometer's."""
NOISE_DEGC = (0.0, 0.005)


def once_a_second(record: Record) -> Record:
    """Return a record at 1 Hz: enough for the search, whose measurements are minutes apart."""
    every = slice(None, None, 10)
    parts = {name: getattr(record, name)[every] for name in ("time_ns", "reading", "temperature", "rate")}
    return replace(record, **parts)


def rates(record: Record, walks: FloatArray, sigma: float, constant: float) -> FloatArray:
    """Return the rates, (n, m) °C/s, of m filters side by side, with walks (m, 3), each as `KalmanRate`."""
    seconds, reading = record.seconds, record.reading
    m = len(walks)
    x = np.tile([reading[0], 0.0, 0.0], (m, 1))
    p = np.tile(np.eye(3), (m, 1, 1))
    noise = np.square(walks)[:, :, np.newaxis] * np.eye(3)
    t0, last, temperature = 0.0, float(reading[0]), np.full(m, reading[0])
    out = np.empty((len(seconds), m))
    for i, (t, value) in enumerate(zip(seconds.tolist(), reading.tolist(), strict=True)):
        p += noise * (t - seconds[max(i - 1, 0)])
        if t - t0 > RENEWAL_S:
            shift = (t - t0) / constant
            c = np.array([[1.0, shift, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, np.exp(-shift)]])
            x, p, t0 = x @ c.T, c @ p @ c.T, t
        h = model_row(3, (t - t0) / constant)
        taken = np.abs(temperature - last) > STEP if abs(value - last) <= STEP / 2 else np.ones(m, bool)
        if taken.any():
            gain = p[taken] @ h
            spread = gain @ h + sigma**2
            x[taken] += gain * ((0.5 * (value + last) - x[taken] @ h) / spread)[:, np.newaxis]
            p[taken] -= gain[:, :, np.newaxis] * gain[:, np.newaxis] / spread[:, np.newaxis, np.newaxis]
        temperature, last = x @ h, value
        out[i] = x @ np.array([0.0, 1.0, -h[2]]) / constant
    return out


def error(record: Record, rate: FloatArray) -> FloatArray:
    """Return the rms error after the start, °C/h, of rates (n,) or (n, m)."""
    late = record.seconds > SETTLED_S
    off = rate[late].T - record.rate[late]
    return np.asarray(np.sqrt(np.mean(np.square(off), axis=-1)) * PER_HOUR)


def search() -> None:
    """Print the best of all filters on each record, and on all at once, beside the FIR filter."""
    walks = np.array(list(itertools.product(WALKS, repeat=3)))
    settings = [(sigma, walk) for sigma in NOISES for walk in walks]
    print(
        f"\n{len(settings)} settings: σ of a measurement {NOISES[0]:g} and {NOISES[1]:g} steps, random walks "
        f"of α, β, γ from {{0, {WALKS[1]:g} ... {WALKS[-1]:.2g}}} °C/√s.\n"
    )
    print("| record | FIR | best Kalman | its σ, walks | settings within 1.5 × FIR | the one best for all |")
    print("|---|---|---|---|---|---|")
    rows, found = [], []
    for shape, window, constant in RECORDS:
        for degc in NOISE_DEGC:
            record = simulate(shape, degc)
            segment = np.zeros(len(record.reading), np.int64)
            fir = FirRate(Params(STEP, window, constant, BUFFER))
            its = float(error(record, fir.process(record.time_ns, segment, record.reading).rate))
            slow = once_a_second(record)
            errors = np.concatenate([error(slow, rates(slow, walks, s * STEP, constant)) for s in NOISES])
            best = int(np.argmin(errors))
            rows.append((record.name, its, best, int(np.sum(errors < 1.5 * its))))
            found.append(errors)
    common = int(np.argmin(np.sum(np.log(found), axis=0)))
    for (name, its, best, near), errors in zip(rows, found, strict=True):
        numbers = f"{its:.3g} | {errors[best]:.3g} | {_setting(settings[best])} | {near}"
        print(f"| {name} | {numbers} | {errors[common]:.3g} |")
    print(f"\nBest for all by the geometric mean: {_setting(settings[common])}.")


def _setting(setting: tuple[float, FloatArray]) -> str:
    sigma, walk = setting
    return f"{sigma:g}; " + " ".join(f"{w:.2g}" for w in walk)
