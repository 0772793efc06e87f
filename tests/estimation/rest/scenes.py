"""Small scenes for the rest detector: readings of a unit whose angles and specific force are given."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.estimation.rest.parameters import RestParameters

DEG = np.pi / 180.0
GRAVITY = 9.80665


def block(t: FloatArray, gyro: FloatArray | None, accel: FloatArray | None) -> SampleBlock:
    """Return samples at t seconds; (n, 3) each in rad/s and m/s²."""
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.rint(t * 1e9).astype(np.int64),
        "segment": np.zeros(len(t), np.int64),
    }
    for name, values in (("gyro", gyro), ("accel", accel)):
        if values is not None:
            columns |= {f"{name}_{axis}": values[:, i].copy() for i, axis in enumerate("xyz")}
    return SampleBlock(columns)


def noise(
    seconds: float,
    rate_hz: float = 100.0,
    gyro_sd: float = 1e-3,
    accel_sd: float = 0.01,
    seed: int = 0,
    bias: tuple[float, float, float] = (2.0 * DEG, -0.3 * DEG, 0.1 * DEG),
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return t, gyro and accel of a level unit at rest."""
    rng = np.random.default_rng(seed)
    n = int(seconds * rate_hz)
    gyro = gyro_sd * rng.standard_normal((n, 3)) + bias
    accel = accel_sd * rng.standard_normal((n, 3)) + [0.0, 0.0, -GRAVITY]
    return np.arange(n) / rate_hz, gyro, accel


def flicker(
    gyro: FloatArray, rate_hz: float, sd: float, seed: int, taus_s: tuple[float, ...] = (10.0, 100.0, 1000.0)
) -> FloatArray:
    """Return what a flickering bias adds to gyros: processes of one standard deviation, rad/s, (n, 3)."""
    rng, bias = np.random.default_rng(seed), np.zeros_like(gyro)
    for tau_s in taus_s:
        keeps = np.exp(-1.0 / (rate_hz * tau_s))
        drive = np.sqrt(1.0 - keeps**2) * rng.standard_normal(gyro.shape)
        drive[0] /= np.sqrt(1.0 - keeps**2)
        bias += sd * lfilter([1.0], [1.0, -keeps], drive, axis=0)
    return bias


def rolled(accel: FloatArray, roll: FloatArray) -> FloatArray:
    """Turn the specific force of a level unit by roll, (n,) rad."""
    force = accel.copy()
    force[:, 1] -= GRAVITY * np.sin(roll)
    force[:, 2] += GRAVITY * (1.0 - np.cos(roll))
    return force


def detect(samples: SampleBlock, parameters: RestParameters | None = None) -> IntArray:
    """Return at_rest of all samples by a new detector."""
    result: IntArray = RestDetector(parameters).process(samples)["at_rest"]
    return result
