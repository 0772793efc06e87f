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
from samples import sent
from study import matrix

from imumon.blocks import FloatArray
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
    samples = sent(np.arange(len(gyro)) / rate_hz, gyro=gyro, accel=accel)
    samples = samples.with_columns(RestAndBias().process(samples))
    end = int(np.flatnonzero(moving)[-1])
    after = slice(end + round(SETTLED_S * rate_hz), end + round((SETTLED_S + REST_S) * rate_hz))
    truth = gyro[after].mean(0)
    bias, sd = (matrix(samples, name)[end] for name in ("gyro_bias", "gyro_bias_sd"))
    return bias - truth, (bias - truth) / sd, 100.0 * float(samples["at_rest"][moving].mean())


def measured_motion() -> Iterator[tuple[str, float, FloatArray, float]]:
    """Yield name, rms error over the axes in °/h, error over sigma, and % of motion called rest."""
    for path in recordings():
        error, ratio, false_percent = errors(path)
        yield path.stem, float(np.sqrt(np.mean(error**2))) / DEG_PER_H, ratio, false_percent
