"""What a thermometer does to the gyro bias: TCZUPT with the estimated temperature against the raw reading."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from thermometer_kinds import PER_HOUR, Kind, constant, drifting, ramp

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import GyroBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel

DPH = math.radians(1.0) / PER_HOUR
SLOPE = 100.0 * DPH
"""Of the gyros over temperature, rad/s/°C."""
ARW = math.radians(0.05) / 60.0
"""rad/√s; a tactical gyro, so that the temperature is what counts."""
RESIDUAL = 1.0 * DPH
RANGE_DEGC = (5.0, 45.0)
RATE_HZ = 10.0
"""Of the gyros; temperatures are means over their samples, so that the raw reading loses nothing."""
HOLD_S, AFTER_S, BLOCK_S = 300.0, 300.0, 10.0
MOVING_S = 60.0


@dataclass(frozen=True, slots=True)
class Case:
    """A profile, from when on errors count and until when, and from when on the unit moves, s."""

    name: str
    rate_degc_per_s: float
    until_s: float
    moves_s: float = math.inf


CASES = (
    Case("constant", 0.0, HOLD_S + AFTER_S),
    Case("constant, moving", 0.0, HOLD_S + MOVING_S, HOLD_S),
    Case("5 °C/h", 5.0 / PER_HOUR, HOLD_S + AFTER_S),
    Case("5 °C/h, moving", 5.0 / PER_HOUR, HOLD_S + MOVING_S, HOLD_S),
    Case("ramp 2 °C/min", 2.0 / 60.0, HOLD_S + AFTER_S),
    Case("onset, moving", 2.0 / 60.0, HOLD_S + MOVING_S, HOLD_S),
)
"""Moving: no zero-velocity update, the bias goes on by the temperature alone."""


def temperatures(kind: Kind, rate: float, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return temperature, reading and estimate at the gyros' samples, °C, (n,) each."""
    rng = np.random.default_rng(seed)
    t = np.arange(int((HOLD_S + AFTER_S) * kind.rate_hz)) / kind.rate_hz
    profile = ramp(HOLD_S) if rate > 0.01 else drifting if rate else constant
    true, _ = profile(t, 25.0 + rng.uniform(-0.5, 0.5))
    reading, stage, parts = kind.read(true, rng), TemperatureRate(), []
    time_ns = np.round(t * 1e9).astype(np.int64)
    length = round(BLOCK_S * kind.rate_hz)
    for i in range(0, len(t), length):
        rows = slice(i, i + length)
        columns = {"device_time_ns": time_ns[rows], "segment": np.zeros(len(t[rows]), np.int64)}
        found = stage.process(SampleBlock({**columns, "temperature": reading[rows]}))
        parts.append(found["temperature_estimate"])
    many, few = max(round(kind.rate_hz / RATE_HZ), 1), max(round(RATE_HZ / kind.rate_hz), 1)
    true, reading, estimate = (
        np.repeat(x.reshape(-1, many).mean(axis=1), few)
        for x in (true, reading, np.asarray(np.concatenate(parts), np.float64))
    )
    return true, reading, estimate


def bias_error(case: Case, true: FloatArray, column: str, temperature: FloatArray, seed: int) -> float:
    """Return the rms error of the bias of three gyros after the hold, °/h."""
    n = round(case.until_s * RATE_HZ)
    seconds = np.arange(n) / RATE_HZ
    bias = SLOPE * (true[:n] - np.mean(RANGE_DEGC))
    noise = ARW * math.sqrt(RATE_HZ) * np.random.default_rng([seed, 1]).standard_normal((3, n))
    block = SampleBlock(
        {
            "device_time_ns": np.round(seconds * 1e9).astype(np.int64),
            "segment": np.zeros(n, np.int64),
            **{f"gyro_{axis}": bias + noise[j] for j, axis in enumerate("xyz")},
            **{f"accel_{axis}": np.full(n, -STANDARD_GRAVITY * (axis == "z")) for axis in "xyz"},
            "at_rest": (seconds < case.moves_s).astype(np.int64),
            column: temperature[:n],
        }
    )
    found = GyroBias(None, model(), "thermal").process(block)
    late = seconds > HOLD_S
    error = np.concatenate([found[f"gyro_bias_{axis}"][late] - bias[late] for axis in "xyz"])
    return float(np.sqrt(np.mean(error**2))) / DPH


def model() -> BiasModel:
    """Return the model of gyros whose bias is a straight line over temperature, which is known."""
    low, high = RANGE_DEGC
    half = 0.5 * (high - low)
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[low, high],
        residual_sd=RESIDUAL,
        curve=PolynomialCurve(center_degc=low + half, half_width_degc=half, coefficients=[0.0, SLOPE * half]),
    )
    return BiasModel(
        made_by="scripts/reproduce/thermometers",
        created="2026-01-01T00:00:00Z",
        channels={f"gyro_{axis}": channel for axis in "xyz"},
    )


def bias_rows(kind: Kind, seeds: range) -> Iterator[tuple[str, list[float]]]:
    """Yield cases with the rms error of the bias with the estimate, over that with the reading, and that."""
    made: dict[float, list[tuple[FloatArray, FloatArray, FloatArray]]] = {}
    for case in CASES:
        rate = case.rate_degc_per_s
        if rate not in made:
            made[rate] = [temperatures(kind, rate, seed) for seed in seeds]
        squares = np.zeros(2)
        for seed, (true, reading, estimate) in zip(seeds, made[rate], strict=True):
            squares += [
                bias_error(case, true, "temperature_estimate", estimate, seed) ** 2,
                bias_error(case, true, "temperature", reading, seed) ** 2,
            ]
        with_estimate, with_reading = np.sqrt(squares / len(seeds))
        yield case.name, [with_estimate, with_estimate / with_reading, with_reading]
