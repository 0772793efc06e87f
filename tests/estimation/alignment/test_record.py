"""A record is bounded, however long the unit rests."""

from __future__ import annotations

import math

import numpy as np

from imumon.estimation.alignment.record import CAPACITY, Record
from tests.estimation.alignment.units import aligned, error_deg, samples, scenario


def test_merged_rows_keep_time_and_mean() -> None:
    record, rng = Record(0.0), np.random.default_rng(1)
    slots = rng.normal(size=(2 * CAPACITY + 6, 6))
    for k, values in enumerate(slots):
        record.add(25.0, values, 0.25 * (k + 1), 0.25)
    assert len(record.rows) == CAPACITY
    assert record.row_s == 1.0
    np.testing.assert_allclose(
        record.whole_rows[:, 1:], slots[:-2].reshape(-1, 4, 6).mean(axis=1), atol=1e-12
    )
    assert (record.whole_rows[:, 0] == 100.0).all()
    assert record.rest_s == 0.25 * len(slots)


def test_a_slot_that_does_not_count_leaves_the_mean_of_its_row() -> None:
    record = Record(0.0)
    record.slots_per_row = 2
    for samples_, value in ((25.0, 1.0), (0.0, 99.0), (0.0, 99.0), (25.0, 3.0), (0.0, 99.0), (0.0, 99.0)):
        record.add(samples_, np.full(6, value), 0.0, 0.25)
    assert record.whole_rows[:2, 1].tolist() == [1.0, 3.0]
    assert record.whole_rows[:, 0].tolist() == [25.0, 25.0, 0.0]


def test_an_hour_of_rest_is_as_good_as_it_should_be() -> None:
    block = samples(scenario(3600.0, rate_hz=4.0, arw=1e-3))
    stage, _ = aligned(block, {"accel_bias_sd_ug": 10.0, "gyro_bias_sd_deg_per_h": 0.0})
    shown = stage.status.shown
    assert stage.status.rest_s > 3598.0
    assert shown is not None
    assert math.degrees(shown.sd) < 0.01
    assert abs(error_deg(shown.heading, 30.0)) < 3.0 * math.degrees(shown.sd)
