"""The methods that are compared, one call each: what they predict and what they estimate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from random_error_records import RATE_HZ, VARIANCE, Record
from scipy.signal import lfilter

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.random_error.baselines import ExponentialMean, hold
from imumon.estimation.random_error.drift import DriftFilter
from imumon.estimation.random_error.fit import fit_local_level
from imumon.estimation.random_error.slots import SlotGatherer
from imumon.published.linear import LinearFilter, ModelL
from imumon.published.sigma_points import ModelNL, SigmaPointFilter

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
    """Run "drift" (the default), "exponential 85 s" and the like, or "hold 60 s", on means of a second."""
    n = len(record.reading)
    time_ns: IntArray = np.round(np.arange(n) * 1e9 / record.rate_hz).astype(np.int64)
    measured = np.ones(n, np.bool_) if rest is None else rest > 0
    slots = SlotGatherer().process(time_ns, np.zeros(n, np.int64), record.reading, measured)
    kind, _, seconds = name.partition(" ")
    sd = np.full(len(slots), np.nan)
    if kind == "drift":
        # The filter works in rad/s; its limits are far below either unit.
        result = DriftFilter().process(slots)
        values, sd = result.estimate, result.sd
    else:
        span = float(seconds.split()[0])
        values = (hold(span) if kind == "hold" else ExponentialMean(span)).process(slots)
    shown = [_from_slots(each, slots.row, n) for each in (values, sd)]
    return Output(shown[0], shown[0], shown[1])


def _from_slots(values: FloatArray, row: IntArray, n: int) -> FloatArray:
    return np.repeat(np.concatenate([[np.nan], values]), np.diff([0, *row.tolist(), n]))


def exponential(reading: FloatArray, seconds: float) -> FloatArray:
    """Return a low-pass sample by sample that starts at the mean of the first second."""
    gain = 1.0 / (seconds * RATE_HZ)
    start = float(np.mean(reading[:RATE_HZ]))
    return np.asarray(lfilter([gain], [1.0, gain - 1.0], reading - start) + start)


def fit_record(record: Record, reading: FloatArray) -> tuple[float, float]:
    """Return δ¹ in deg/s and R in (deg/s)² of a sample."""
    n = len(reading)
    time_ns = np.round(np.arange(n) * 1e9 / record.rate_hz).astype(np.int64)
    level = fit_local_level(time_ns, np.radians(reading))
    interval = 1.0 / record.rate_hz
    # Without a walk the covariance degenerates: the upper limit is what the record cannot exclude.
    walk = level.walk or level.walk_range[1]
    return float(np.degrees(np.sqrt(walk * interval))), float(
        np.degrees(np.degrees(level.noise_variance(interval)))
    )
