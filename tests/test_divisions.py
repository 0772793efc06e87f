"""The contract of all stages: any division of the samples into blocks gives the same bits."""

from __future__ import annotations

from itertools import cycle, pairwise

import numpy as np
import pytest

from imumon.blocks import NO_INT, BoolArray, SampleBlock, join
from imumon.pipeline import Pipeline
from imumon.run import PUBLISHED
from imumon.run.setup import RandomErrorParameters, Setup
from imumon.run.stages import estimators
from tests.estimation.gyro_bias.records import slope_model
from tests.faults.recovery import healthy

RATE_HZ, LENGTH_S = 50.0, 140.0
SETUPS = {
    "nothing known": Setup(),
    "place known": Setup(latitude_deg=48.0, heading_deg=10.0, zupt_mode="standard"),
    "model": Setup(latitude_deg=48.0, model=slope_model(20.0), zupt_mode="thermal"),
    "published": Setup(
        latitude_deg=48.0,
        model=slope_model(20.0),
        published=list(PUBLISHED),
        random_error=RandomErrorParameters(learn_s=20.0),
    ),
}
SOME = ("at_rest", "temperature_rate", "gyro_bias_x", "attitude_estimate_w")
OF_PAPERS = ("dense_zupt_gyro_bias_x", "sr_rsukf_random_error_x", "fir_temperature_rate")
"""Columns that the record has values of."""
SIZES: tuple[list[int], ...] = ([1, 7, 300, 2, 64], [977])


@pytest.fixture(scope="module")
def disturbed() -> SampleBlock:
    """A unit at rest that is turned, sent with gaps: readings, a time and rows missing, and a restart."""
    columns = healthy(RATE_HZ, LENGTH_S)
    t = np.arange(len(columns["gyro_x"])) / RATE_HZ
    rng = np.random.default_rng(4)

    def missing(name: str, where: BoolArray) -> None:
        columns[name][where] = np.nan

    columns["gyro_z"][(t > 66.0) & (t < 69.0)] += 0.5
    missing("gyro_x", (t > 75.0) & (rng.random(len(t)) < 0.02))
    missing("gyro_y", (t > 80.0) & (t < 80.1))
    missing("accel_x", (t > 77.0) & (t < 77.1))
    missing("temperature", rng.random(len(t)) < 0.3)
    for axis in "xyz":
        missing(f"mag_{axis}", np.arange(len(t)) % 4 > 0)
    time_ns = columns["device_time_ns"]
    time_ns[t >= 90.0] += 7_000_000_000
    time_ns[t >= 120.0] -= time_ns[t >= 120.0][0]
    time_ns[round(85.0 * RATE_HZ)] = NO_INT
    columns["segment"][t >= 120.0] = 1
    return SampleBlock(columns)


def run(block: SampleBlock, setup: Setup, sizes: list[int]) -> SampleBlock:
    """Return all columns of samples that are pushed in pieces of these sizes, over and over."""
    pipeline, edges, of = Pipeline(None, estimators(None, setup)), [0], cycle(sizes)
    while edges[-1] < len(block):
        edges.append(min(edges[-1] + next(of), len(block)))
    parts = []
    for start, stop in pairwise(edges):
        pipeline.push(block.rows(start, stop))
        parts.append(pipeline.take())
    pipeline.finish()
    return join([*parts, pipeline.take()])


@pytest.mark.long
@pytest.mark.parametrize("name", SETUPS)
def test_any_division_into_blocks_gives_the_same_bits(name: str, disturbed: SampleBlock) -> None:
    whole = run(disturbed, SETUPS[name], [len(disturbed)])
    for column in SOME:
        assert np.isfinite(whole[column]).mean() > 0, column
    for sizes in SIZES:
        pieces = run(disturbed, SETUPS[name], sizes)
        for column, values in whole.columns.items():
            np.testing.assert_array_equal(pieces[column], values, err_msg=column)
