"""Simulated records for tests: the published unit's curves, sampled once a second."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.calibration.cells import Record, record_of

DEG_H = np.deg2rad(1.0) / 3600.0
"""1 °/h in rad/s."""
GRAVITY = 9.80665


def true_bias(temperature: FloatArray) -> FloatArray:
    """Return the bias of three gyros at temperatures (n,) in °C, (n, 3) rad/s."""
    t = temperature
    x = 0.45 * np.tanh((t - 18) / 25) + 0.06 * np.sin((t + 5) / 12)
    y = -0.35 * np.tanh((t - 30) / 15) + 0.004 * (t - 20)
    z = 0.30 * ((t - 14) / 34) ** 2 - 0.20 * (t - 14) / 34 + 0.05 * np.tanh((t - 5) / 6)
    return np.deg2rad(np.column_stack([x, y, z]))


def true_slope(temperature: FloatArray) -> FloatArray:
    """Return d(true_bias)/dT, (n, 3) rad/s/°C."""
    h = 1e-4
    return (true_bias(temperature + h) - true_bias(temperature - h)) / (2 * h)


def soak(level_s: float = 1800.0) -> FloatArray:
    """Return the temperature of the published soak, once a second, with short holds and 1 °C/min between."""
    levels = [*np.arange(-20.53, 46.0, 5.0), 48.08]
    parts = [np.full(round(level_s), levels[0])]
    for low, high in pairwise(levels):
        parts += [np.linspace(low, high, round(60 * (high - low))), np.full(round(level_s), high)]
    return np.concatenate(parts)


def samples(
    temperature: FloatArray,
    seed: int = 0,
    offset: float = 0.0,
    noise: float = 16.8 * DEG_H,
    accel: tuple[float, float, float] | None = None,
    segment: int = 0,
) -> SampleBlock:
    """Return samples at 1 Hz of a unit at rest with these temperatures; `offset` in rad/s on all gyros."""
    n = len(temperature)
    random = np.random.default_rng(seed)
    gyro = true_bias(temperature) + offset + noise * random.standard_normal((n, 3))
    columns = {f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")}
    if accel is not None:
        values = np.array(accel) + 2e-3 * random.standard_normal((n, 3))
        columns |= {f"accel_{axis}": values[:, j] for j, axis in enumerate("xyz")}
    measured = np.round((temperature + 0.005 * random.standard_normal(n)) / 0.05) * 0.05
    return SampleBlock(
        {
            "device_time_ns": np.arange(n) * 1_000_000_000,
            "segment": np.full(n, segment, np.int64),
            "temperature": measured,
            **columns,
        }
    )


def record(temperature: FloatArray, name: str = "soak", **given: object) -> Record:
    """Return the record of `samples`."""
    return record_of([samples(temperature, **given)], name, "0" * 64)  # type: ignore[arg-type]  # passed through


def few_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Train the networks in a moment, where it does not matter how good they are."""
    for name, few in {"FIRST": 5, "LAST": 5, "fit_network.__defaults__": (2,)}.items():
        monkeypatch.setattr(f"imumon.models.curves.network.{name}", few)
