"""What a simulated or measured unit sends, as the stages take it, and the noise that its biases have."""

from __future__ import annotations

import math

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import ColumnArray, FloatArray, SampleBlock


def sent(time_s: FloatArray, /, **sensors: FloatArray) -> SampleBlock:
    """Return the samples of a unit in one segment; a sensor is a vector, (n, 3), or a number, (n,)."""
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.rint(time_s * 1e9).astype(np.int64),
        "segment": np.zeros(len(time_s), np.int64),
    }
    for name, values in sensors.items():
        if values.ndim == 1:
            columns[name] = values
        else:
            columns |= {f"{name}_{axis}": values[:, j].copy() for j, axis in enumerate("xyz")}
    return SampleBlock(columns)


def without(samples: SampleBlock, sensor: str) -> SampleBlock:
    """Return the samples without the columns of a sensor."""
    return SampleBlock({name: values for name, values in samples.columns.items() if sensor not in name})


def gauss_markov(rng: np.random.Generator, n: int, rate_hz: float, tau_s: float, sd: float) -> FloatArray:
    """Return three Gauss-Markov processes in equilibrium, (n, 3), of this standard deviation."""
    decay = math.exp(-1.0 / (rate_hz * tau_s))
    drive = rng.normal(size=(n, 3)) * sd * math.sqrt(1.0 - decay * decay)
    drive[0] = rng.normal(size=3) * sd
    return np.asarray(lfilter([1.0], [1.0, -decay], drive, axis=0))
