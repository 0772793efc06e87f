"""A run that goes on for days: the same means in longer slots, in memory that is bounded."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.effects.vibration import SECOND_NS, VIBRATION
from imumon.lab.diagnosis.runs import MOST_SLOTS, BoundedRun
from imumon.recordings.reduced import ACCEL, KeptSlots

SAMPLES = 10


def seconds(first: int, columns: FloatArray, rest: FloatArray, variance: float = 0.9) -> KeptSlots:
    """Return seconds of ten samples with these means (n, m), and the share of each at rest (n,)."""
    n = len(columns)
    start_ns = (first + np.arange(n)) * SECOND_NS
    mean = np.column_stack([columns, rest])
    count = np.where(np.isfinite(mean), SAMPLES, 0)
    return KeptSlots(
        segment=np.zeros(n, np.int64),
        begins=np.arange(first, first + n) == 0,
        start_ns=start_ns,
        end_ns=start_ns + SECOND_NS * (SAMPLES - 1) // SAMPLES,
        count=count,
        mean=mean,
        variance=np.where(count > 0, variance, np.nan),
        smallest=mean,
    )


def test_a_short_run_is_kept_in_seconds() -> None:
    values = np.random.default_rng(1).normal(size=(100, 2))
    rest = np.ones(100)
    values[40, 1], rest[50] = np.nan, 0.5
    aged = BoundedRun(["gyro_x", "supply"])
    aged.take(seconds(0, values[:30], rest[:30]))
    aged.take(seconds(30, values[30:], rest[30:]))
    run = aged.run()
    assert run.slot_s == 1.0
    at_rest = np.arange(100) != 50
    np.testing.assert_allclose(run.mean["gyro_x"][at_rest], values[at_rest, 0])
    assert np.isnan(run.mean["gyro_x"][50])
    assert run.rest.tolist() == at_rest.tolist()
    np.testing.assert_allclose(run.mean["supply"], values[:, 1])


def test_a_week_is_kept_in_as_much_memory_as_two_hours() -> None:
    names, piece, week = ["gyro_x", "temperature"], 3600, 7 * 24 * 3600
    aged, random = BoundedRun(names), np.random.default_rng(2)
    total = np.zeros(week)
    tracemalloc.start()
    for first in range(0, week, piece):
        values = random.normal(size=(piece, 2))
        total[first : first + piece] = values[:, 0]
        aged.take(seconds(first, values, np.ones(piece)))
        if first == 0:
            after_an_hour = tracemalloc.get_traced_memory()[0]
    grown = tracemalloc.get_traced_memory()[0] - after_an_hour
    tracemalloc.stop()
    assert aged._sums.nbytes <= 32 * MOST_SLOTS * len(names)
    assert grown < 1000 * piece // SAMPLES  # not even what the last hour alone would take
    run = aged.run()
    assert MOST_SLOTS // 2 <= len(run.time_s) <= MOST_SLOTS
    assert run.duration_s == pytest.approx(week, abs=run.slot_s)
    width = int(run.slot_s)
    whole = week // width * width
    np.testing.assert_allclose(run.mean["gyro_x"], total[:whole].reshape(-1, width).mean(axis=1), atol=1e-12)


def test_a_slot_in_which_the_unit_moved_tells_of_its_rest() -> None:
    n = 4 * MOST_SLOTS
    moving = np.arange(n) % 8 == 3
    rate = np.where(moving, 1e3, 2.0)
    aged = BoundedRun(["gyro_x", "temperature"])
    aged.take(seconds(0, np.column_stack([rate, np.where(moving, 30.0, 20.0)]), np.where(moving, 0.0, 1.0)))
    run = aged.run()
    assert run.slot_s == 4.0
    np.testing.assert_allclose(run.mean["gyro_x"], 2.0)
    assert set(run.count["gyro_x"]) == {3.0 * SAMPLES, 4.0 * SAMPLES}
    np.testing.assert_allclose(
        run.mean["temperature"][:2], [22.5, 20.0]
    )  # what drives a bias is the mean of all
    assert (run.rest == 1.0).all()


def test_vibration_is_what_samples_scatter_within_seconds_however_long_the_slots_are() -> None:
    n = 2 * MOST_SLOTS
    swaying = np.repeat(np.sin(np.arange(n))[:, np.newaxis], 3, axis=1)
    aged = BoundedRun(["gyro_x", *ACCEL])
    aged.take(seconds(0, np.column_stack([np.zeros(n), swaying]), np.ones(n), variance=0.09))
    vibration = aged.run().mean[VIBRATION]
    np.testing.assert_allclose(vibration, 3 * 0.09 * SAMPLES / (SAMPLES - 1))


def test_a_clock_that_leaps_by_years_costs_no_memory() -> None:
    aged = BoundedRun(["gyro_x"])
    aged.take(seconds(0, np.ones((10, 1)), np.ones(10)))
    aged.take(seconds(10**9, np.ones((10, 1)), np.ones(10)))
    assert len(aged.run().time_s) <= MOST_SLOTS
    assert aged._sums.nbytes <= 32 * MOST_SLOTS
