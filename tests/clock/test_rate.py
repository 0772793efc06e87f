"""Rate and gaps of a stream against what was made."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT
from imumon.clock.checks import Intervals, usual_interval_ns


@pytest.mark.parametrize("rate_hz", [0.01, 1.0, 99.7, 125.0, 4000.0])
@pytest.mark.parametrize("jitter", [0.0, 0.05])
def test_rate_is_that_where_nothing_is_missing(rate_hz: float, jitter: float) -> None:
    rng = np.random.default_rng(1)
    time = (np.arange(2000) + jitter * rng.uniform(-1, 1, 2000)) * 1e9 / rate_hz
    kept = np.ones(2000, np.bool_)
    kept[[100, 500, 501, 502, 900]] = False
    intervals = Intervals()
    intervals.add(time[kept].astype(np.int64), np.zeros(kept.sum(), np.int64))
    assert intervals.rate_hz == pytest.approx(rate_hz, rel=1e-2 if jitter else 1e-5)
    assert intervals.gaps == 3
    assert intervals.rows == 1995


@pytest.mark.parametrize("rate_hz", [150, 278, 333.3, 400, 476, 500, 640, 700, 800, 900, 950, 1000])
@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_times_in_whole_milliseconds_give_the_rate_or_none(rate_hz: float, lost: float) -> None:
    kept = np.random.default_rng(int(rate_hz)).random(40_000) >= lost
    time = np.floor(np.arange(40_000) / rate_hz * 1000 + 1e-9)[kept].astype(np.int64) * 1_000_000
    intervals = Intervals(rounded=True)
    intervals.add(time, np.zeros(kept.sum(), np.int64))
    assert type(intervals.rate_hz) in (float, type(None))  # that a YAML file can hold
    if intervals.rate_hz is None:
        assert lost
        assert rate_hz > 500
    else:
        assert intervals.rate_hz == pytest.approx(rate_hz, rel=4e-3 if lost else 2e-4)


def test_steps_between_segments_and_unknown_times_do_not_count() -> None:
    time = np.array([0, 10, NO_INT, 20, 5, 15, 25], np.int64) * 1_000_000
    time[2] = NO_INT
    intervals = Intervals()
    intervals.add(time, np.array([0, 0, 0, 0, 1, 1, 1]))
    assert intervals.rate_hz == pytest.approx(100.0)
    assert (intervals.gaps, intervals.backwards) == (0, 0)


def test_what_a_counter_lacks_at_even_steps_is_missing_and_no_rounding() -> None:
    steps = np.diff(np.arange(5000)[np.arange(5000) % 8 != 3] * 1_000_000)
    assert usual_interval_ns(steps) == (1e6, 0.0)
    assert usual_interval_ns(steps, rounded=True)[0] == pytest.approx(8e6 / 7, rel=1e-3)
    intervals = Intervals()
    intervals.add(np.cumsum(steps), np.zeros(len(steps), np.int64))
    assert intervals.rate_hz == 1000.0
    assert intervals.gaps == pytest.approx(625, abs=1)


@pytest.mark.parametrize("rows", [10, 100, 150, 500])
def test_too_few_times_in_whole_milliseconds_give_no_rate(rows: int) -> None:
    intervals = Intervals(rounded=True)
    intervals.add(np.floor(np.arange(rows) / 0.8).astype(np.int64) * 1_000_000, np.zeros(rows, np.int64))
    assert intervals.rate_hz is None or intervals.rate_hz == pytest.approx(800, rel=0.02)


def test_a_time_that_runs_back_within_a_segment_is_counted() -> None:
    intervals = Intervals()
    intervals.add(np.array([0, 10, 5, 15]), np.zeros(4, np.int64))
    assert intervals.backwards == 1


@given(st.lists(st.integers(0, 300), max_size=6))
@settings(max_examples=25, deadline=None)
def test_the_division_into_blocks_does_not_matter(cuts: list[int]) -> None:
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.integers(1, 30, 300)).astype(np.int64) * 1_000_000
    segment = np.cumsum(rng.random(300) < 0.01).astype(np.int64)
    whole, parts = Intervals(), Intervals()
    whole.add(time, segment)
    edges = sorted({0, 300, *cuts})
    for start, stop in pairwise(edges):
        parts.add(time[start:stop], segment[start:stop])
    assert (whole.rate_hz, whole.gaps, whole.rows) == (parts.rate_hz, parts.gaps, parts.rows)
