"""Recordings of BROAD (Laidig et al. 2021): the bias at the end of motion against the mean of the rest
after it.

Each has a rest, some minutes in a hand, and a rest; the optical reference says when it moves.  The bias is
not known, so what is compared with is the mean of the gyros over the rest that follows.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.geodesy import DEG_PER_H

SETTLED_S, REST_S = 1.0, 20.0
"""After the motion, and how long the mean is."""


def recordings() -> list[Path]:
    """Return the recordings below IMUMON_DATA; none where they are not here."""
    return sorted((Path(os.environ.get("IMUMON_DATA", "data")) / "broad").glob("*.npz"))


def errors(path: Path) -> tuple[FloatArray, FloatArray, float]:
    """Return error and error over sigma at the end of the motion, (3,), and the share of motion called
    rest, %."""
    with np.load(path) as data:
        rate_hz, moving = float(data["sampling_rate"]), data["movement"]
        gyro, accel = (data[name].astype(np.float64) for name in ("gyr", "acc"))
    n = len(gyro)
    columns = {
        "device_time_ns": np.rint(np.arange(n) * 1e9 / rate_hz).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        **{f"gyro_{axis}": gyro[:, j].copy() for j, axis in enumerate("xyz")},
        **{f"accel_{axis}": accel[:, j].copy() for j, axis in enumerate("xyz")},
    }
    samples = SampleBlock(columns)
    samples = samples.with_columns(RestAndBias().process(samples))
    end = int(np.flatnonzero(moving)[-1])
    after = slice(end + round(SETTLED_S * rate_hz), end + round((SETTLED_S + REST_S) * rate_hz))
    truth = gyro[after].mean(0)
    bias, sd = (
        np.array([samples[f"{name}_{axis}"][end] for axis in "xyz"]) for name in ("gyro_bias", "gyro_bias_sd")
    )
    return bias - truth, (bias - truth) / sd, 100.0 * float(samples["at_rest"][moving].mean())


def measured_motion() -> Iterator[tuple[str, float, FloatArray, float]]:
    """Yield name, rms error over the axes in °/h, error over sigma, and % of motion called rest."""
    for path in recordings():
        error, ratio, false_percent = errors(path)
        yield path.stem, float(np.sqrt(np.mean(error**2))) / DEG_PER_H, ratio, false_percent
