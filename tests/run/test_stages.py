from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import SampleBlock, join
from imumon.errors import ImumonError
from imumon.papers.fir import FirStage
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_text, parse_device
from imumon.run import PUBLISHED
from imumon.run.setup import Setup
from imumon.run.stages import estimators, pipeline_of


def warming(n: int, starts_at: int) -> SampleBlock:
    """Two sensors at 10 Hz, the second of which begins to send later, the device restarting half-way."""
    t = np.arange(n) * 0.1
    time_ns = (np.concatenate([t[: n // 2], t[: n - n // 2]]) * 1e9).astype(np.int64)
    y = np.round((30 + 0.02 * t) / 0.05) * 0.05
    y[:starts_at] = np.nan
    return SampleBlock(
        {
            "device_time_ns": time_ns,
            "segment": (np.arange(n) >= n // 2).astype(np.int64),
            "temperature_x": np.round((20 + 0.01 * t) / 0.05) * 0.05,
            "temperature_y": y,
        }
    )


@pytest.mark.long
@given(cuts=st.lists(st.integers(1, 2399), max_size=8), starts_at=st.integers(0, 900))
@settings(max_examples=10, deadline=None)
def test_a_channel_that_comes_late_is_the_same_whatever_the_blocks(cuts: list[int], starts_at: int) -> None:
    block = warming(2400, starts_at)
    whole = Pipeline(None, estimators(None))
    whole.push(block)
    expected = whole.take()
    pieces = Pipeline(None, estimators(None))
    edges = sorted({0, 2400, *cuts})
    for start, stop in pairwise(edges):
        part = block.rows(start, stop)
        if stop <= starts_at:  # a decoder has no column for what has not come yet
            part = SampleBlock({k: v for k, v in part.columns.items() if k != "temperature_y"})
        pieces.push(part)
    got = pieces.take()
    for name in expected.columns:
        np.testing.assert_array_equal(got[name], expected[name], err_msg=name)
    assert np.isfinite(got["temperature_rate_y"][-1])


def test_a_device_without_temperature_gets_no_columns_of_temperature() -> None:
    pipeline = Pipeline(None, estimators(None))
    pipeline.push(SampleBlock({"device_time_ns": np.arange(3), "segment": np.zeros(3, np.int64)}))
    assert not [name for name in pipeline.take().columns if name.startswith("temperature")]
    assert not [column for column in pipeline.columns if column.name.startswith("temperature")]


def test_the_retired_method_of_a_device_file_is_a_published_one() -> None:
    text = device_text("ax1")[0]
    device = parse_device(text + "temperature: {method: fir_exponential, step_degc: 0.5}\n", "mine.yaml")
    (stage,) = [stage for stage in estimators(device) if isinstance(stage, FirStage)]
    assert "fir_temperature_rate_x" in stage.process(warming(6000, 0))
    (said,) = (text for text in pipeline_of(device).warnings() if "not used" in text)
    assert said == "temperature: method is not used any more, it is as published: [fir]"
    with pytest.raises(ImumonError, match=r"mine.yaml:\d+: temperature.windows: unknown key"):
        parse_device(text + "temperature: {windows: 3}\n", "mine.yaml")


def test_join_keeps_blocks_in_order() -> None:
    """The pieces above rely on it: a column that some blocks lack is missing there."""
    joined = join([SampleBlock({"a": np.ones(1)}), SampleBlock({"a": np.ones(1), "b": np.ones(1)})])
    np.testing.assert_array_equal(joined["b"], [np.nan, 1.0])


@pytest.mark.long
def test_published_methods_run_beside_the_defaults_and_change_nothing_of_them() -> None:
    rng = np.random.default_rng(0)
    n = 4000
    block = warming(n, 0)
    columns = {f"gyro_{a}": 1e-4 + 1e-3 * rng.standard_normal(n) for a in "xyz"}
    columns |= {f"accel_{a}": (9.8 if a == "z" else 0.0) + 1e-3 * rng.standard_normal(n) for a in "xyz"}
    block = block.with_columns(columns).rows(0, n // 2)
    plain = Pipeline(None, estimators(None, Setup(latitude_deg=45.0)))
    plain.push(block)
    beside = Pipeline(None, estimators(None, Setup(latitude_deg=45.0, published=list(PUBLISHED))))
    beside.push(block)
    expected, got = plain.take(), beside.take()
    for name in expected.columns:
        np.testing.assert_array_equal(got[name], expected[name], err_msg=name)
    new = got.columns.keys() - expected.columns.keys()
    assert new >= {"fir_temperature_rate_y", "sr_rsukf_phi_x", "dense_zupt_gyro_bias_z", "curve_fit_heading"}
    assert {column.name for column in beside.columns} >= new
    for name in ("fir_temperature_rate_y", "sr_ukf_random_error_x", "total_average_heading"):
        assert np.isfinite(got[name][-1])
