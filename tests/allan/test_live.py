"""The streamed curve is the batch's, for the same definition, however the stream is cut."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.allan.covariance import Runs, freedom
from imumon.allan.live import RING, RINGS, STRIDES_PER_TAU, AllanStage, StreamingAllan
from imumon.allan.series import WALK, EvenSeries, even_channels
from imumon.blocks import FloatArray, IntArray, SampleBlock
from tests.allan.simulated import noise

INTERVAL_NS = 10_000_000


def gappy(n: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Return time, segment and values with lost samples, a pause, a restart and missing values."""
    values = 3.0 + noise(1, n, 0.01, white=1.0, walk=0.5)
    time_ns = np.arange(n, dtype=np.int64) * INTERVAL_NS
    time_ns[n // 3 :] += 123_456_789
    segment = np.zeros(n, np.int64)
    segment[n // 2 :] = 1
    time_ns[n // 2 :] -= time_ns[n // 2]
    values[n // 5 : n // 5 + 7] = np.nan
    keep = np.ones(n, bool)
    keep[[200, n // 4, n // 4 + 1]] = False
    return time_ns[keep], segment[keep], values[keep]


def streamed(record: tuple[IntArray, IntArray, FloatArray], cuts: list[int]) -> StreamingAllan:
    channel = StreamingAllan()
    edges = [0, *sorted(cut % len(record[0]) for cut in cuts), len(record[0])]
    time_ns, segment, values = record
    for start, stop in pairwise(edges):
        channel.process(time_ns[start:stop], segment[start:stop], values[start:stop])
    return channel


def strided_allan(series: EvenSeries, factors: IntArray, strides_per_tau: int) -> FloatArray:
    """Return Allan variances of differences at every max(1, m // strides_per_tau)-th sample of a run."""
    x = np.concatenate([[0.0], np.cumsum(series.values - series.values.mean())])
    found = np.full(len(factors), np.nan)
    for row, m in enumerate(factors.tolist()):
        stride = max(1, m // strides_per_tau)
        parts = [
            x[start + 2 * m : stop + 1 : stride]
            - 2.0 * x[start + m : stop + 1 - m : stride]
            + x[start : stop + 1 - 2 * m : stride]
            for start, stop in zip(*series.runs(1), strict=True)
            if stop - start >= 2 * m
        ]
        found[row] = np.mean(np.concatenate(parts) ** 2) / (2.0 * m**2)
    return found


def test_the_streamed_curve_is_that_of_the_batch() -> None:
    record = gappy(60_000)
    curve = streamed(record, []).curve()
    series = even_channels(*record[:2], {"x": record[2]})["x"]
    factors = np.rint(curve.tau_s / series.interval_s).astype(np.int64)
    np.testing.assert_array_equal(factors, 2 ** np.arange(len(factors)))
    assert len(factors) > 13
    same = np.sqrt(strided_allan(series, factors, STRIDES_PER_TAU))
    np.testing.assert_allclose(curve.deviation, same, rtol=1e-9)
    every = np.sqrt(strided_allan(series, factors, 1 << 40))
    np.testing.assert_allclose(curve.deviation[:5], every[:5], rtol=1e-9)
    np.testing.assert_allclose(curve.deviation, every, rtol=0.02)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 4000), max_size=8))
def test_the_division_into_blocks_does_not_matter(cuts: list[int]) -> None:
    record = gappy(3000)
    np.testing.assert_array_equal(
        streamed(record, cuts).curve().deviation, streamed(record, []).curve().deviation
    )


def test_memory_does_not_grow() -> None:
    channel = streamed(gappy(20_000), [])
    sizes = [value.nbytes for value in vars(channel).values() if isinstance(value, np.ndarray)]
    assert sum(sizes) < RINGS * RING * 8 + 1000
    assert [len(part) for part in channel.__dict__["_waiting"]] == [0, 0, 0]


def test_a_change_of_rate_begins_anew() -> None:
    n = 2000
    slow, fast = np.arange(n) * INTERVAL_NS, np.arange(1, 2 * n + 1) * (INTERVAL_NS // 4)
    time_ns = np.concatenate([slow, slow[-1] + fast])
    values = noise(2, len(time_ns), 0.01, white=1.0)
    channel = streamed((time_ns, np.zeros(len(time_ns), np.int64), values), [700, 2030, 5000])
    assert channel.restarts == 1
    assert channel.curve().tau_s[0] == pytest.approx(0.0025)
    assert channel.curve().deviation[0] == pytest.approx(10.0, rel=0.05)


def test_a_channel_slower_than_the_packets_has_its_own_interval() -> None:
    n = 4000
    values = np.full(n, np.nan)
    values[::4] = noise(3, n // 4, 0.04, white=1.0)
    channel = streamed((np.arange(n) * INTERVAL_NS, np.zeros(n, np.int64), values), [])
    assert channel.curve().tau_s[0] == pytest.approx(0.04)
    assert channel.curve().deviation[0] == pytest.approx(5.0, rel=0.1)


def test_the_degrees_of_freedom_are_those_of_a_random_walk_of_the_batch() -> None:
    n = 20_000
    record = (np.arange(n) * INTERVAL_NS, np.zeros(n, np.int64), noise(4, n, 0.01, white=1.0))
    curve = streamed(record, []).curve()
    runs = Runs(np.array([float(n)]), np.ones(1))
    for row in (0, 3, 6, 9):
        exact = freedom("allan", 2**row, runs, WALK)
        assert curve.freedom[row] == pytest.approx(exact, rel=0.05)
    assert np.all(curve.low < curve.deviation)
    assert np.all(curve.deviation < curve.high)


@pytest.mark.parametrize("terms", [{"white": 1.0}, {"white": 0.1, "walk": 0.05}])
def test_no_interval_of_what_is_shown_is_too_narrow(terms: dict[str, float]) -> None:
    n = 12_000
    times = np.arange(n) * INTERVAL_NS, np.zeros(n, np.int64)
    inside = []
    for seed in range(60):
        curve = streamed((*times, noise(seed, n, 0.01, **terms)), []).curve().trusted()
        truth = np.sqrt(terms["white"] ** 2 / curve.tau_s + terms.get("walk", 0.0) ** 2 * curve.tau_s / 3.0)
        inside.append((curve.low[-3:] <= truth[-3:]) & (truth[-3:] <= curve.high[-3:]))
    assert len({len(one) for one in inside}) == 1
    assert np.mean(inside) > 0.62
    assert np.mean(np.array(inside)[:, -1]) > 0.62


def block(n: int, **extra: IntArray) -> SampleBlock:
    columns = {f"gyro_{axis}": noise(seed, n, 0.01, white=1e-3) for seed, axis in enumerate("xyz")}
    times = {"device_time_ns": np.arange(n) * INTERVAL_NS, "segment": np.zeros(n, np.int64)}
    return SampleBlock({**times, **columns, **extra})


def test_the_stage_draws_a_chart() -> None:
    stage = AllanStage()
    assert stage.charts() == []
    assert stage.process(block(5000)) == {}
    assert stage.notices() == []
    (chart,) = stage.charts()
    drawn = ["x", "y", "z", "68 % x", "68 % y", "68 % z", "white noise"]
    assert [curve.name for curve in chart.curves] == drawn
    assert [curve.name for curve in chart.curves if curve.listed] == ["x", "y", "z", "white noise"]
    assert chart.x.log
    assert chart.y.log
    np.testing.assert_allclose(chart.curves[0].y[:4], chart.curves[-1].y[:4], rtol=0.1)
    assert chart.curves[0].y[0] == pytest.approx(np.rad2deg(1e-3) * 3600 * 10, rel=0.05)


def test_the_slope_is_that_of_the_random_walk_whatever_comes_at_long_times() -> None:
    drifting = block(200_000)
    for axis in "xyz":
        drifting[f"gyro_{axis}"][:] += 3e-4 * np.arange(200_000) * 0.01
    stage = AllanStage()
    stage.process(drifting)
    (chart,) = stage.charts()
    slope = next(curve for curve in chart.curves if curve.name == "white noise")
    at_1_s = np.exp(np.interp(0.0, np.log(slope.x), np.log(slope.y)))
    assert at_1_s == pytest.approx(np.rad2deg(1e-3) * 3600, rel=0.2)


def test_motion_does_not_count() -> None:
    n = 5000
    at_rest = np.ones(n, np.int64)
    at_rest[2000:2500] = 0
    moving = block(n, at_rest=at_rest)
    moving["gyro_x"][2000:2500] += 1.0
    stage, still = AllanStage(), AllanStage()
    stage.process(moving)
    still.process(block(n))
    found, expected = (one.charts()[0].curves[0].y[:5] for one in (stage, still))
    np.testing.assert_allclose(found, expected, rtol=0.1)


def test_a_stage_without_its_columns_draws_nothing() -> None:
    stage = AllanStage()
    stage.process(SampleBlock({"device_time_ns": np.arange(9), "segment": np.zeros(9, np.int64)}))
    stage.process(SampleBlock({}))
    assert stage.charts() == []
