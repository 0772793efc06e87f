"""The methods that are compared, one call each: what they predict and what they estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from random_error_records import RATE_HZ, VARIANCE, Record
from scipy.signal import lfilter

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.estimation.gyro_bias.stage import GyroBias
from imumon.papers.linear import LinearFilter, ModelL
from imumon.papers.local_level import fit_local_level, means_of
from imumon.papers.rest_means import ExponentialMean, hold
from imumon.papers.sigma_points import ModelNL, SigmaPointFilter

FITTED, DELTAS = 3.9e-5, (3.9e-5, 1e-3, 1e-2)
"""δ¹ in deg/s: the first is that of a local level fitted to hours, the others are pretended."""
PRETENDED = (*DELTAS, 0.1)
PUBLISHED = ("STF", "SR-UKF", "SR-RSUKF 0.5", "SR-RSUKF 0.95")
SOFTENING = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Output:
    """x_k|k-1 and x_k|k, and the standard deviation where there is one, (n,), deg/s."""

    predicted: FloatArray
    estimate: FloatArray
    sd: FloatArray


def published(name: str, reading: FloatArray, delta: float, noise: float = VARIANCE) -> Output:
    """Run a method of the paper, or the plain Kalman filter on model L as "KF"."""
    start = float(np.mean(reading[:RATE_HZ]))
    if name in ("STF", "KF"):
        model = ModelL(0.0, delta, 0.0, (start, start), (noise / 100, noise / 100), noise)
        linear = LinearFilter(model, SOFTENING if name == "STF" else None).process(reading)
        return Output(linear.predicted, linear.estimate, linear.sd)
    share = float(name.split()[1]) if " " in name else 0.0
    spread = (0.1 * delta) ** 2
    nonlinear = ModelNL(
        (start, start, 0.0, delta, 0.0), (noise / 100, noise / 100, 0.01, spread, spread), noise
    )
    mu = share / (2 * (noise + delta**2))
    result = SigmaPointFilter(nonlinear, (mu, 0.0, 0.0, 0.0, 0.0)).process(reading)
    return Output(result.predicted, result.estimate, result.sd)


def slow(name: str, record: Record, rest: FloatArray | None = None) -> Output:
    """Run "drift" (the default estimate of the bias), "exponential 85 s" and the like, or "hold 60 s"."""
    if name == "drift":
        added = default(record, rest)
        values, sd = (np.degrees(added[f"gyro_random_error{part}_x"]) for part in ("", "_sd"))
        return Output(values, values, sd)
    still = record.reading if rest is None else np.where(rest > 0, record.reading, np.nan)
    means = means_of(_times(record), still)
    kind, _, seconds = name.partition(" ")
    span = float(seconds.split()[0])
    values = (hold(span) if kind == "hold" else ExponentialMean(span)).process(means)
    ended = np.minimum(_times(record) // 1_000_000_000, len(values))
    shown = np.append(np.nan, values)[ended]
    return Output(shown, shown, np.full(len(shown), np.nan))


def _times(record: Record) -> IntArray:
    return np.round(np.arange(len(record.reading)) * 1e9 / record.rate_hz).astype(np.int64)


def default(record: Record, rest: FloatArray | None = None) -> Mapping[str, ColumnArray]:
    """Return the columns of the gyro bias of a unit whose three axes read the same."""
    n = len(record.reading)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": _times(record),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.ones(n, np.int64) if rest is None else (rest > 0).astype(np.int64),
        **{f"gyro_{axis}": np.radians(record.reading) for axis in "xyz"},
    }
    return GyroBias().process(SampleBlock(columns))


def exponential(reading: FloatArray, seconds: float) -> FloatArray:
    """Return a low-pass sample by sample that starts at the mean of the first second."""
    gain = 1.0 / (seconds * RATE_HZ)
    start = float(np.mean(reading[:RATE_HZ]))
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], reading - start) + start)


def fit_record(record: Record, reading: FloatArray) -> tuple[float, float]:
    """Return δ¹ in deg/s and R in (deg/s)² of a sample."""
    level = fit_local_level(means_of(_times(record), np.radians(reading)))
    interval = 1.0 / record.rate_hz
    # Without a walk the covariance degenerates: the upper limit is what the record cannot exclude.
    walk = level.best.walk or level.walk_range[1]
    return float(np.degrees(np.sqrt(walk * interval))), float(
        np.degrees(np.degrees(level.best.noise_variance(interval)))
    )
