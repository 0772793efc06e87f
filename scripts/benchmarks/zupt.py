"""Gyro bias: time of a sample in the stage, at rest and in motion, beside the filter of 12 states."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from dense_record import dense_filter

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.stage import GyroBias, Mode
from imumon.papers.dense_zupt import DenseSettings

SECONDS, BLOCK_S = 300, 10
RATES_HZ = (100, 1000)
BAR_US = 0.2
KNOWN = GyroBiasParameters(angle_random_walk_rad_per_sqrt_s=8e-5, bias_instability_rad_per_s=1e-5)


def run() -> tuple[list[Table], list[Bar]]:
    """Measure white noise at rest, and the same said to be in motion."""
    table = Table("Gyro bias, us per sample of three axes", ["filter", *(f"{rate} Hz" for rate in RATES_HZ)])
    rows: dict[str, list[str]] = {}
    bars = []
    for rate in RATES_HZ:
        blocks, gyro, accel = _record(rate, 1)
        moving, _, _ = _record(rate, 0)
        cases: dict[str, Callable[[], None]] = {
            "stage, standard": partial(_stage, "standard", blocks),
            "stage, noise known": partial(_stage, "standard", blocks, KNOWN),
            "stage, learned": partial(_stage, "learned", blocks),
            "stage, in motion": partial(_stage, "standard", moving),
            "12 states, dense, ten samples to a step": partial(_dense, rate, gyro, accel),
        }
        times = measure(cases)
        n = SECONDS * rate
        for name in cases:
            rows.setdefault(name, []).append(f"{times[name].best / n / 1000:.3f}")
        for name in ("stage, standard", "stage, noise known"):
            cost = times[name].best / n / 1000
            bars.append(Bar(f"gyro bias ({name}) at {rate} Hz, us per sample", BAR_US, cost, at_most=True))
    table.rows += [[name, *cells] for name, cells in rows.items()]
    table.notes.append(
        f"{SECONDS} s in blocks of {BLOCK_S} s, from the start on: the first minute is filtered twice"
    )
    return [table], bars


def _record(rate: int, at_rest: int) -> tuple[list[SampleBlock], FloatArray, FloatArray]:
    n, rng = SECONDS * rate, np.random.default_rng(0)
    gyro = rng.standard_normal((n, 3)) * 8e-5 * np.sqrt(rate)
    accel = rng.standard_normal((n, 3)) * 1e-3 * np.sqrt(rate) + [0.0, 0.0, -9.8]
    block = SampleBlock(
        {
            "device_time_ns": np.arange(n) * (1_000_000_000 // rate),
            "segment": np.zeros(n, np.int64),
            "at_rest": np.full(n, at_rest),
            "temperature": np.linspace(25.0, 26.0, n),
            **{f"gyro_{axis}": gyro[:, j].copy() for j, axis in enumerate("xyz")},
            **{f"accel_{axis}": accel[:, j].copy() for j, axis in enumerate("xyz")},
        }
    )
    size = BLOCK_S * rate
    return [block.rows(start, start + size) for start in range(0, n, size)], gyro, accel


def _stage(mode: Mode, blocks: list[SampleBlock], parameters: GyroBiasParameters | None = None) -> None:
    stage = GyroBias(parameters, mode=mode)
    for block in blocks:
        stage.process(block)


def _dense(rate: int, gyro: FloatArray, accel: FloatArray) -> None:
    part = slice(0, 10 * rate)
    for _ in range(SECONDS // 10):
        dense_filter(DenseSettings(1.0 / rate), gyro[part], accel[part], np.zeros(3), every=rate // 10)
