"""Gaps, restarts and uneven times: what a difference may span."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.allan.analysis import analyse, variances
from imumon.allan.series import EvenSeries, even_channels, octaves
from imumon.blocks import FloatArray, IntArray
from tests.allan.simulated import noise

STEP_NS = 5_000_000


def series(time_ns: IntArray, values: FloatArray, segment: IntArray | None = None) -> EvenSeries:
    segment = np.zeros(len(values), np.int64) if segment is None else segment
    return even_channels(time_ns, segment, {"x": values})["x"]


def allan(of: EvenSeries, factors: IntArray) -> FloatArray:
    return variances(of, factors)["allan"]


def without(n: int, lost: list[int]) -> tuple[IntArray, FloatArray]:
    keep = np.ones(n, bool)
    keep[lost] = False
    return (np.arange(n) * STEP_NS)[keep], noise(1, n, 0.005, white=1.0)[keep]


def test_a_gap_is_crossed_only_by_averaging_times_that_are_longer() -> None:
    found = series(*without(10_000, [4000, 4001]))
    assert list(found.gap_starts) == [4000]
    assert list(found.gap_lengths) == [2]
    assert [list(part) for part in found.runs(7)] == [[0, 4002], [4000, 10_000]]
    assert [list(part) for part in found.runs(8)] == [[0], [10_000]]


def test_no_difference_crosses_a_gap_that_is_too_long_for_it() -> None:
    n = 2000
    time_ns, values = without(n, [1000, 1001, 1002])
    values[1000:] += 100.0  # a step across the gap must not be seen at short averaging times
    whole = noise(1, n, 0.005, white=1.0)
    found = allan(series(time_ns, values), np.array([1, 2, 4, 8]))
    np.testing.assert_allclose(
        found, allan(series(np.arange(n) * STEP_NS, whole), np.array([1, 2, 4, 8])), rtol=0.05
    )


def test_lost_packets_change_the_curve_by_little_and_keep_the_long_averaging_times() -> None:
    n = 100_000
    rng = np.random.default_rng(3)
    values = noise(4, n, 0.005, white=1.0, walk=0.02)
    keep = rng.random(n) > 1e-3
    whole = series(np.arange(n) * STEP_NS, values)
    lossy = series((np.arange(n) * STEP_NS)[keep], values[keep])
    factors = octaves(whole)
    np.testing.assert_array_equal(octaves(lossy), factors)
    assert lossy.used == keep.sum()
    ratio = allan(lossy, factors) / allan(whole, factors)
    assert np.all(np.abs(ratio - 1) < 0.05)


def test_what_is_missing_has_the_mean_of_its_neighbours_of_the_same_island() -> None:
    values = np.array([5.0, 7.0, 1.0, 9.0, 2.0, 4.0] + [0.0] * 1000)
    time_ns = np.array([0, 1, 2, 5, 6, 7, *range(9, 1009)]) * STEP_NS
    found = series(time_ns, values)
    assert list(found.values[3:5]) == [(7 + 1 + 9 + 2) / 4] * 2
    assert found.values[8] == (4 + 0) / 2
    assert list(np.flatnonzero(~found.there)) == [3, 4, 8]


@pytest.mark.parametrize("lost", [0.05, 0.3])
def test_lost_samples_cost_neither_terms_nor_long_averaging_times(lost: float) -> None:
    n, records = 60_000, 8
    keep = np.random.default_rng(31).random(n) > lost
    channels = {
        str(row): noise(400 + row, n, 0.02, white=1e-3, instability=7e-4)[keep] for row in range(records)
    }
    time_ns = (np.arange(n) * 20_000_000)[keep]
    found = analyse(even_channels(time_ns, np.zeros(len(time_ns), np.int64), channels))
    for name, truth in (("angle_random_walk", 1e-3), ("bias_instability", 7e-4)):
        told = [term for each in found.values() if each.fit and (term := each.fit.terms[name])]
        errors = np.array([(term.value - truth) / term.sd for term in told])
        assert len(told) >= records - 2
        assert np.sqrt(np.mean(errors**2)) < 1.8
    assert min(each.longest_tau_s for each in found.values()) > 80.0


@pytest.mark.parametrize("rate_hz", [150, 250, 333.3, 400, 640, 700, 800, 900, 950, 1000])
@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_times_in_whole_milliseconds_give_the_noise_or_nothing(rate_hz: float, lost: float) -> None:
    n, rng = 70_000, np.random.default_rng(int(rate_hz))
    keep = rng.random(n) >= lost
    time_ns = np.floor(np.arange(n) / rate_hz * 1000 + 1e-9)[keep].astype(np.int64) * 1_000_000
    values = rng.normal(0, np.sqrt(rate_hz), n)[keep]
    found = even_channels(time_ns, np.zeros(keep.sum(), np.int64), {"x": values}, rounded=True)
    if not found:
        assert lost
        assert rate_hz > 500
        return
    assert found["x"].used == keep.sum()
    if not lost or rate_hz in (150, 250, 333.3, 400, 1000):
        assert found["x"].gap_lengths.sum() == n - keep.sum() - (not keep[0]) - (not keep[-1])
    fit = analyse(found)["x"].fit
    term = fit and fit.terms["angle_random_walk"]
    assert term
    assert abs(term.value - 1.0) < 3.0 * term.sd


def test_a_restart_and_a_pause_end_an_island() -> None:
    n = 900
    time_ns = np.arange(n) * STEP_NS
    segment = np.zeros(n, np.int64)
    segment[300:] = 1
    time_ns[300:] -= time_ns[300]
    time_ns[600:] += 3_333_333_333
    found = series(time_ns, noise(1, n, 0.005, white=1.0), segment)
    assert list(found.islands) == [0, 300, 600, 900]
    assert octaves(found)[-1] == 128
    result = analyse({"x": found})["x"]
    assert result.trusted > 0
    assert np.isnan(result.modified.values[-1])


def test_samples_at_another_rate_are_left_out() -> None:
    time_ns = np.concatenate([np.arange(1000) * STEP_NS, 1000 * STEP_NS + np.arange(200) * STEP_NS // 3])
    found = series(time_ns, noise(1, 1200, 0.005, white=1.0))
    assert found.interval_s == pytest.approx(0.005)
    assert found.samples == 1200
    assert 999 <= found.used <= 1001


def test_jitter_is_reported_and_taken_as_even() -> None:
    rng = np.random.default_rng(0)
    time_ns = np.arange(5000) * STEP_NS + np.rint(rng.normal(0, 0.05 * STEP_NS, 5000)).astype(np.int64)
    found = series(time_ns, noise(1, 5000, 0.005, white=1.0))
    assert found.used == 5000
    assert found.jitter == pytest.approx(0.05 * np.sqrt(2), rel=0.1)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(-(10**9), 10**10), min_size=0, max_size=40),
    st.lists(st.sampled_from([1.0, float("nan"), -2.0]), min_size=40, max_size=40),
)
def test_any_times_and_missing_values_are_survived(steps: list[int], values: list[float]) -> None:
    time_ns = np.cumsum(np.array(steps, np.int64))
    found = even_channels(time_ns, np.zeros(len(steps), np.int64), {"x": np.array(values[: len(steps)])})
    for each in found.values():
        assert np.isfinite(each.values).all()
        assert each.used <= each.samples
        assert len(each.values) == each.islands[-1]
        if len(factors := octaves(each)):
            assert np.isfinite(allan(each, factors)).all()
