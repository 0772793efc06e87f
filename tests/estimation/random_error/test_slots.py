"""Slots: means at rest, gaps, segments, rates."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.random_error.slots import SlotGatherer, Slots


def take(time_s: FloatArray, reading: FloatArray, rest: npt.NDArray[np.bool_] | None = None) -> Slots:
    n = len(reading)
    time_ns: IntArray = np.round(time_s * 1e9).astype(np.int64)
    measured = np.ones(n, bool) if rest is None else rest
    return SlotGatherer().process(time_ns, np.zeros(n, np.int64), reading, measured)


@pytest.mark.parametrize("rate", [1, 2, 10, 100, 2000])
def test_means_of_a_second_at_any_rate(rate: int) -> None:
    t = np.arange(20 * rate) / rate
    slots = take(t, np.floor(t + 1e-9))
    assert len(slots) == 19
    np.testing.assert_allclose(slots.elapsed_s, 1.0, atol=1e-6)
    assert slots.interval_s[-1] == pytest.approx(1 / rate)
    # The first sample stands for no time, so at 1 Hz the first slot says nothing.
    believed = slots.covered_s > 0
    np.testing.assert_array_equal(slots.mean[believed], np.arange(19.0)[believed])
    assert believed[1:].all()


def test_a_slot_mostly_in_motion_says_nothing() -> None:
    t = np.arange(1000) / 100
    rest = (t < 3.3) | (t > 5.7)
    slots = take(t, np.zeros(1000), rest)
    assert (slots.covered_s == 0.0).tolist() == [False] * 3 + [True] * 3 + [False] * 3
    assert np.isnan(slots.mean[3:6]).all()


def test_a_gap_is_elapsed_but_not_covered() -> None:
    t = np.concatenate([np.arange(150), 10_000 + np.arange(300)]) / 100
    slots = take(t, np.zeros(450))
    assert slots.elapsed_s.sum() == pytest.approx(t[slots.row[-1]])
    assert slots.elapsed_s[1] == pytest.approx(99.0, abs=0.6)
    assert slots.covered_s[1] < 0.7


@pytest.mark.parametrize("what", ["segment", "time"])
def test_a_new_segment_or_a_time_that_runs_back_begins_anew(what: str) -> None:
    time_ns = np.arange(1000, dtype=np.int64) * 10_000_000
    segment = np.zeros(1000, np.int64)
    if what == "segment":
        segment[550:] = 1
    else:
        time_ns[550:] -= 5_000_000_000
    slots = SlotGatherer().process(time_ns, segment, np.arange(1000.0), np.ones(1000, bool))
    assert np.flatnonzero(slots.begins).tolist() == [0, 5]
    assert slots.row[5] == 650
    assert slots.mean[5] == pytest.approx(599.5)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_neither_the_division_into_blocks_nor_unusable_rows_before_matter(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 600
    time_ns = np.cumsum(rng.choice([10_000_000, 30_000_000, 2_000_000_000], n, p=[0.9, 0.09, 0.01]))
    segment: IntArray = np.cumsum((rng.random(n) < 0.003).astype(np.int64))
    reading = np.where(rng.random(n) < 0.1, np.nan, rng.normal(size=n))
    measured = np.repeat(rng.random(n // 50) < 0.7, 50)
    whole = SlotGatherer().process(time_ns, segment, reading, measured)
    first = int(np.flatnonzero(measured & np.isfinite(reading))[0]) if len(whole) else 0
    gatherer, begins, means, covered, rows = SlotGatherer(), [], [], [], []
    for part in np.split(np.arange(first, n), np.sort(rng.integers(0, n - first, 5))):
        slots = gatherer.process(time_ns[part], segment[part], reading[part], measured[part])
        rows += [part[row] for row in slots.row]
        begins += slots.begins.tolist()
        means += slots.mean.tolist()
        covered += slots.covered_s.tolist()
    assert rows == whole.row.tolist()
    assert begins == whole.begins.tolist()
    np.testing.assert_array_equal(means, whole.mean)
    np.testing.assert_array_equal(covered, whole.covered_s)
