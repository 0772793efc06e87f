"""Random error: time of a sample and axis in the published filters, and in their stage."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, measure
from imumon.blocks import FloatArray, SampleBlock
from imumon.papers.linear import LinearFilter, ModelL
from imumon.papers.random_error import RandomErrorMethods
from imumon.papers.sigma_points import ModelNL, SigmaPointFilter
from imumon.run.paper_parameters import RandomErrorParameters

SAMPLES = 10_000
RATE_HZ, BLOCK_S = 100, 1
BAR_US = 2.0
NOISE, DELTA = 0.1103, 0.01
"""deg/s, as in the note of the method."""


def run() -> tuple[list[Table], list[Bar]]:
    """Measure the filters on white noise, φ uncertain, and the stage in blocks of a second."""
    reading = math.sqrt(NOISE) * np.random.default_rng(0).standard_normal(SAMPLES)
    block = _block(reading)
    linear = ModelL(0.0, DELTA, 0.0, (0.0, 0.0), (1e-3, 1e-3), NOISE)
    names = {
        "Kalman filter, model L": partial(_linear, linear, None, reading),
        "strong-tracking filter, model L": partial(_linear, linear, 1.0, reading),
        "SR-UKF, 5 states": partial(_sigma_points, 0.0, reading),
        "SR-RSUKF, 5 states": partial(_sigma_points, 0.5, reading),
        "stage, SR-RSUKF": partial(_stage, block),
    }
    times = measure(names)
    axes = {name: 3 if name.startswith("stage") else 1 for name in names}
    cost = {name: times[name].best / SAMPLES / axes[name] / 1000 for name in names}
    table = Table("Random error, us per sample and axis", ["filter", "us"])
    table.rows += [[name, f"{value:.3f}"] for name, value in cost.items()]
    table.notes.append(
        f"the stage at {RATE_HZ} Hz in blocks of {BLOCK_S} s, all that it shows beside included"
    )
    name = "SR-RSUKF, 5 states"
    bars = [Bar(f"{name}, us per sample and axis", BAR_US, cost[name], at_most=True)]
    return [table], bars


def _block(reading: FloatArray) -> SampleBlock:
    n = len(reading)
    return SampleBlock(
        {
            "device_time_ns": np.arange(n) * (1_000_000_000 // RATE_HZ),
            "segment": np.zeros(n, np.int64),
            "at_rest": np.ones(n, np.int64),
            **{f"gyro_{axis}": np.radians(reading) for axis in "xyz"},
        }
    )


def _linear(model: ModelL, softening: float | None, reading: FloatArray) -> None:
    LinearFilter(model, softening).process(reading)


def _sigma_points(share: float, reading: FloatArray) -> None:
    model = ModelNL((0.0, 0.0, 0.0, DELTA, 0.0), (1e-3, 1e-3, 0.01, 1e-6, 1e-6), NOISE)
    mu = share / (2 * (NOISE + DELTA**2))
    SigmaPointFilter(model, (mu, 0.0, 0.0, 0.0, 0.0)).process(reading)


def _stage(block: SampleBlock) -> None:
    stage = RandomErrorMethods(("sr_rsukf",), RandomErrorParameters(learn_s=10.0))
    size = RATE_HZ * BLOCK_S
    for start in range(0, len(block), size):
        stage.process(block.rows(start, start + size))
