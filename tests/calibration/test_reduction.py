"""Block means: a plain sum over each ten seconds, whatever the division of the stream."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.calibration.reduction import NO_VERDICT, BlockMeans, BlockReducer

NAMES = ("gyro_x", "temperature", "accel_x")


def stream(n: int = 5000, seed: int = 0) -> SampleBlock:
    """Return samples at 17 Hz with gaps, restarts, missing values and an accelerometer that never comes."""
    random = np.random.default_rng(seed)
    segment = np.sort(random.integers(0, 3, n))
    step = np.where(random.random(n) < 0.002, 25_000_000_000, 58_823_529)
    gyro = 1e3 + random.standard_normal(n)
    gyro[random.random(n) < 0.3] = np.nan
    return SampleBlock(
        {
            "device_time_ns": np.cumsum(step) - segment * 7_000_000_000_000,
            "segment": segment,
            "gyro_x": gyro,
            "temperature": random.standard_normal(n),
            "at_rest": (random.random(n) < 0.999).astype(np.int64),
        }
    )


def plain(block: SampleBlock) -> BlockMeans:
    """Twin of the kernel."""
    time, segment = block["device_time_ns"], block["segment"]
    origin = np.array([time[segment == s][0] for s in segment])
    keys = np.column_stack([segment, (time - origin) // 10_000_000_000])
    begins = np.flatnonzero(np.any(np.diff(keys, axis=0, prepend=-1) != 0, axis=1))
    groups = np.split(np.arange(len(time)), begins[1:])
    values = np.column_stack([block["gyro_x"], block["temperature"], np.full(len(time), np.nan)])
    count = np.array([np.isfinite(values[g]).sum(axis=0) for g in groups])
    blank = np.full(len(groups), np.nan)
    mean = np.column_stack([[np.nanmean(values[g, j]) for g in groups] for j in (0, 1)] + [blank])
    sd = np.column_stack(
        [[np.nanstd(values[g, j], ddof=1) if len(g) > 1 else np.nan for g in groups] for j in (0, 1)]
        + [blank]
    )
    return BlockMeans(
        names=NAMES,
        segment=segment[begins],
        start_ns=origin[begins] + keys[begins, 1] * 10_000_000_000,
        span_s=np.array([(time[g[-1]] - time[g[0]]) * 1e-9 for g in groups]),
        at_rest=np.array([block["at_rest"][g].min() for g in groups]),
        count=count,
        mean=mean,
        sd=sd,
    )


def reduced(block: SampleBlock, size: int) -> BlockMeans:
    reducer = BlockReducer(NAMES)
    for i in range(0, len(block), size):
        reducer.process(block.rows(i, min(i + size, len(block))))
    return reducer.finish()


def test_the_kernel_gives_what_a_plain_sum_gives() -> None:
    got, expected = reduced(stream(), 5000), plain(stream())
    for name in ("segment", "start_ns", "at_rest", "count"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))
    np.testing.assert_allclose(got.span_s, expected.span_s)
    np.testing.assert_allclose(got.mean, expected.mean, rtol=1e-12)
    np.testing.assert_allclose(got.sd, expected.sd, rtol=1e-9)
    assert len(got) > 30


@pytest.mark.parametrize("size", [1, 13, 4999])
def test_the_division_of_the_stream_does_not_matter(size: int) -> None:
    got, expected = reduced(stream(), size), reduced(stream(), 5000)
    for name in ("segment", "start_ns", "span_s", "at_rest", "count", "mean", "sd"):
        np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))


def test_without_a_verdict_there_is_none() -> None:
    block = SampleBlock({name: v for name, v in stream(200).columns.items() if name != "at_rest"})
    assert set(reduced(block, 200).at_rest) == {NO_VERDICT}


def test_nothing_gives_no_block() -> None:
    assert len(BlockReducer(NAMES).finish()) == 0
