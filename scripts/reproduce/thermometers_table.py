"""Errors of temperature and its rate by a kind of thermometer on a course of temperature."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from study import largest as largest
from study import rms as rms
from thermometer_kinds import PER_HOUR, Kind, Profile

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.filters.rates import RateMethod

STEADY_S, SETTLED_S = 1800.0, 600.0
ONSET_S = 20.0
"""After the begin of a ramp, and of a record."""
BLOCK_S = 10.0


def errors(
    kind: Kind,
    profile: Profile,
    seconds: float,
    seed: int,
    new_method: Callable[[], RateMethod] | None = None,
) -> dict[str, FloatArray]:
    """Return once a second: time, errors of temperature and rate (°C, °C/h), and both in units of sigma."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * kind.rate_hz)) / kind.rate_hz
    temperature, rate = profile(t, 25.0 + rng.uniform(-0.5, 0.5))
    reading = kind.read(temperature, rng)
    stage = TemperatureRate(new_method=new_method)
    time_ns = np.round(t * 1e9).astype(np.int64)
    length = max(round(BLOCK_S * kind.rate_hz), 1)
    parts = []
    for i in range(0, len(t), length):
        rows = slice(i, i + length)
        columns = {"device_time_ns": time_ns[rows], "segment": np.zeros(len(t[rows]), np.int64)}
        parts.append(stage.process(SampleBlock({**columns, "temperature": reading[rows]})))
    names = ("temperature_estimate", "temperature_rate", "temperature_estimate_sd", "temperature_rate_sd")
    each = slice(max(round(kind.rate_hz), 1) - 1, None, max(round(kind.rate_hz), 1))
    estimate, slope, sd, slope_sd = (np.concatenate([part[name] for part in parts])[each] for name in names)
    off, slope_off = estimate - temperature[each], slope - rate[each]
    return {
        "t": t[each],
        "temperature": off,
        "rate": slope_off * PER_HOUR,
        "z": off / sd,
        "rate_z": slope_off / slope_sd,
    }
