"""A simulated unit at rest: flicker, thermal bias, low-pass; small enough to run many times."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, lfilter, lfiltic

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.geodesy import EARTH_RATE
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel

DPH = math.radians(1.0) / 3600.0
"""One degree per hour, rad/s."""
GRAVITY = 9.80665
ARW = math.radians(0.28) / 60.0
VRW = 1e-3
LATITUDE_DEG = 40.93
GIVEN = GyroBiasParameters(assume_at_rest=True)
"""Rest is that of the column ``at_rest``."""


@dataclass(frozen=True)
class Truth:
    """A unit: noise in SI units; flicker, of all axes or of each: sd of a decade of correlation time."""

    rate_hz: float = 100.0
    arw: float = ARW
    vrw: float = VRW
    flicker: float | FloatArray = 2.0 * DPH
    walk: float = 0.0
    low_pass_hz: float | None = 30.0


def markov(rng: np.random.Generator, n: int, dt: float, tau: float, sd: float | FloatArray) -> FloatArray:
    """Return a Gauss-Markov process, (n, 3)."""
    decay = math.exp(-dt / tau)
    drive = rng.normal(size=(n, 3)) * sd * math.sqrt(1.0 - decay * decay)
    drive[0] = rng.normal(size=3) * sd
    return np.asarray(lfilter([1.0], [1.0, -decay], drive, axis=0))


def bias_noise(truth: Truth, rng: np.random.Generator, n: int) -> FloatArray:
    """Return flicker and random walk, (n, 3)."""
    dt = 1.0 / truth.rate_hz
    parts = [markov(rng, n, dt, tau, truth.flicker) for tau in (0.1, 1.0, 10.0, 100.0, 1000.0)]
    return np.asarray(sum(parts)) + np.cumsum(rng.normal(size=(n, 3)), 0) * truth.walk * math.sqrt(dt)


def low_passed(truth: Truth, values: FloatArray) -> FloatArray:
    """Return values through a second-order Butterworth filter that has settled, (n, 3)."""
    if truth.low_pass_hz is None or truth.low_pass_hz >= 0.45 * truth.rate_hz:
        return values
    b, a = butter(2, truth.low_pass_hz, fs=truth.rate_hz)
    start = np.stack([lfiltic(b, a, [v, v], [v, v]) for v in values[0]], 1)
    return np.asarray(lfilter(b, a, values, axis=0, zi=start)[0])


def record(
    truth: Truth,
    seconds: float,
    seed: int = 0,
    thermal: FloatArray | None = None,
    attitude: FloatArray | None = None,
    earth: FloatArray | None = None,
    **columns: ColumnArray,
) -> tuple[SampleBlock, FloatArray]:
    """Return samples at rest and the true bias, (n, 3).

    `attitude` turns north-east-down into body axes, (3, 3); `earth` is north, east, down, rad/s.
    """
    rng = np.random.default_rng(seed)
    n, dt = round(seconds * truth.rate_hz), 1.0 / truth.rate_hz
    matrix = np.eye(3) if attitude is None else attitude
    bias = bias_noise(truth, rng, n) + (0.0 if thermal is None else thermal)
    white = rng.normal(size=(n, 3)) * truth.arw / math.sqrt(dt)
    still = np.zeros(3) if earth is None else matrix @ earth
    gyro = low_passed(truth, bias + white) + still
    force = matrix @ np.array([0.0, 0.0, -GRAVITY])
    accel = low_passed(truth, force + rng.normal(size=(n, 3)) * truth.vrw / math.sqrt(dt))
    block = {
        "device_time_ns": np.round(np.arange(n) * 1e9 * dt).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.ones(n, np.int64),
        **{f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")},
        **{f"accel_{axis}": accel[:, j] for j, axis in enumerate("xyz")},
        **columns,
    }
    return SampleBlock(block), bias


def local_earth() -> FloatArray:
    """Return the earth rate north, east, down, rad/s."""
    latitude = math.radians(LATITUDE_DEG)
    return EARTH_RATE * np.array([math.cos(latitude), 0.0, -math.sin(latitude)])


def vector(added: Mapping[str, ColumnArray] | SampleBlock, name: str = "gyro_bias") -> FloatArray:
    """Return three columns, (n, 3)."""
    return np.column_stack([added[f"{name}_{axis}"] for axis in "xyz"])


def with_rest(block: SampleBlock, rest: ColumnArray | Sequence[bool]) -> SampleBlock:
    """Return the block at rest where `rest` says so."""
    return block.with_columns({"at_rest": np.asarray(rest, np.int64)})


def slope_model(slope_dph: float, residual_dph: float = 1.0) -> BiasModel:
    """Return a model whose gyros all rise by `slope_dph` deg/h per degC, from 20 to 50 degC."""
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[20.0, 50.0],
        residual_sd=residual_dph * DPH,
        curve=PolynomialCurve(
            center_degc=35.0, half_width_degc=15.0, coefficients=[0.0, 15.0 * slope_dph * DPH]
        ),
    )
    channels = {f"gyro_{axis}": channel for axis in "xyz"}
    return BiasModel(made_by="test", created="2026-01-01T00:00:00Z", channels=channels)
