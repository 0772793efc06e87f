"""Slots against NumPy on whole slices, and their independence of the division into blocks."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import fields

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.filters.turns import Turn

LENGTH_NS = 1_000_000_000
TURNS = Turn._fields


def _joined(parts: list[tuple[int, Slots]]) -> dict[str, FloatArray]:
    """Join slots of blocks that began at these rows."""
    own = [field.name for field in fields(Slots) if field.name != "turns"]
    columns: dict[str, list[FloatArray]] = {name: [] for name in [*own, *TURNS]}
    for start, slots in parts:
        for name in own:
            columns[name].append(getattr(slots, name) + (start if name == "row" else 0))
        for name in TURNS:
            columns[name].extend(np.array([getattr(turn, name)]) for turn in slots.turns)
    return {name: np.concatenate(values) for name, values in columns.items()}


def _records(seed: int, n: int) -> tuple[IntArray, IntArray, FloatArray]:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.integers(1, 400_000_000, n)) * rng.choice([1, 1, 1, 20], n).cumprod().clip(1, 1)
    values = 1e6 + rng.normal(size=(n, 3))
    values[rng.random((n, 3)) < 0.2] = np.nan
    segment = np.cumsum(rng.random(n) < 0.02)
    time[rng.random(n) < 0.02] = NO_INT
    return time.astype(np.int64), segment.astype(np.int64), values


def test_statistics_are_those_of_the_samples() -> None:
    n = 1000
    time = np.arange(n, dtype=np.int64) * 10_000_000 + 12345
    values = np.random.default_rng(1).normal(9.81, 0.1, (n, 2))
    values[130:140, 1] = np.nan
    slots = SlotGatherer(2, LENGTH_NS).process(time, np.zeros(n, np.int64), values)
    assert len(slots) == 9
    assert slots.begins.tolist() == [True] + [False] * 8
    for k in range(9):
        part = values[100 * k : 100 * (k + 1)]
        before = values[100 * k - 1 : 100 * (k + 1)] if k else part
        assert slots.row[k] == 100 * (k + 1)
        np.testing.assert_allclose(slots.mean[k], np.nanmean(part, 0), rtol=1e-14)
        np.testing.assert_allclose(slots.variance[k], np.nanvar(part, 0), rtol=1e-9)
        np.testing.assert_array_equal(slots.count[k], np.isfinite(part).sum(0))
        np.testing.assert_array_equal(slots.smallest[k], np.nanmin(part, 0))
        np.testing.assert_array_equal(slots.largest[k], np.nanmax(part, 0))
        steps = np.diff(before, axis=0)
        np.testing.assert_allclose(slots.step_squares[k], np.nansum(steps**2, 0), rtol=1e-12)
        np.testing.assert_array_equal(slots.step_count[k], np.isfinite(steps).sum(0))


def test_a_large_mean_costs_no_digits() -> None:
    values = 1e9 + np.tile([0.0, 1.0], 51)[:, np.newaxis][:101]
    time = np.arange(101, dtype=np.int64) * 10_000_000
    slots = SlotGatherer(1, LENGTH_NS).process(time, np.zeros(101, np.int64), values)
    assert slots.variance[0, 0] == 0.25
    assert slots.changes[0, 0] == 99


def test_a_gap_ends_the_slot_and_the_grid_goes_on() -> None:
    seconds = np.array([0.0, 0.2, 0.4, 7.5, 7.9, 8.1])
    time = (seconds * 1e9).astype(np.int64)
    slots = SlotGatherer(1, LENGTH_NS).process(time, np.zeros(6, np.int64), np.arange(6.0)[:, np.newaxis])
    assert slots.samples.tolist() == [3, 2]
    assert slots.start_ns.tolist() == [0, 7_500_000_000]
    assert slots.end_ns.tolist() == [400_000_000, 7_900_000_000]


def test_a_new_segment_and_a_time_that_runs_back_begin_anew() -> None:
    time = np.array([0, 100, 50, 60, 70], np.int64) * 1_000_000
    segment = np.array([0, 0, 0, 0, 1], np.int64)
    slots = SlotGatherer(1, LENGTH_NS).process(time, segment, np.zeros((5, 1)))
    assert slots.begins.tolist() == [True, True]
    assert slots.samples.tolist() == [2, 2]
    assert slots.step_count[:, 0].tolist() == [1, 1]


@given(st.integers(0, 2**32), st.lists(st.integers(1, 60), min_size=1, max_size=8))
@settings(max_examples=50, deadline=None)
def test_any_division_into_blocks_gives_the_same_slots(seed: int, cuts: list[int]) -> None:
    time, segment, values = _records(seed, 200)
    values = 1e-3 * (values - 1e6)
    whole = _joined([(0, SlotGatherer(3, LENGTH_NS, turns=True).process(time, segment, values))])
    gatherer, parts, at = SlotGatherer(3, LENGTH_NS, turns=True), [], 0
    for size in [*cuts, 200]:
        part = slice(at, min(at + size, 200))
        parts.append((at, gatherer.process(time[part], segment[part], values[part])))
        gatherer, at = deepcopy(gatherer), part.stop
    divided = _joined(parts)
    for name, expected in whole.items():
        np.testing.assert_array_equal(divided[name], expected, err_msg=name)


def test_held_repeats_the_latest_slot() -> None:
    got = held(np.array([2, 3, 3]), np.array([1.0, 2.0, 3.0]), np.array(np.nan), 5)
    np.testing.assert_array_equal(got, [np.nan, np.nan, 1.0, 3.0, 3.0])


def test_the_end_gives_the_open_slot_and_begins_as_new() -> None:
    time = np.arange(150, dtype=np.int64) * 10_000_000
    values = np.random.default_rng(3).normal(size=(150, 2))
    gatherer = SlotGatherer(2, LENGTH_NS)
    assert len(gatherer.finish()) == 0
    assert len(gatherer.process(time, np.zeros(150, np.int64), values)) == 1
    last = gatherer.finish()
    np.testing.assert_allclose(last.mean, [values[100:].mean(axis=0)], rtol=1e-13)
    assert last.end_ns.tolist() == [time[-1]]
    assert len(gatherer.finish()) == 0
