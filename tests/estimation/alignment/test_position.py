"""A record is bounded, however long the unit rests."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.estimation.alignment.position import CAPACITY, SLOT_S, Position, Slot
from tests.estimation.alignment.units import aligned, error_deg, samples, scenario


def test_merged_rows_keep_time_and_mean() -> None:
    record, rng = Position(25.0, np.eye(3)), np.random.default_rng(1)
    slots = rng.normal(size=(2 * CAPACITY + 6, 6))
    for k, values in enumerate(slots):
        record.add(Slot(25.0 + SLOT_S * k, values[:3], values[3:]))
    valid, means = record.rows()
    assert record.row_s == 1.0
    assert valid.all()
    np.testing.assert_allclose(means, slots[:-2].reshape(-1, 4, 6).mean(axis=1), atol=1e-12)
    assert (record.begun_s, record.ended_s) == (25.0, 25.0 + SLOT_S * len(slots))
    assert record.rest_s == SLOT_S * len(slots)
    record.forget_half()
    assert record.begun_s == 25.0 + 1024.0
    np.testing.assert_allclose(record.rows()[1], means[1024:])


def test_slots_without_samples_are_rows_without_values() -> None:
    record = Position(0.0, np.eye(3))
    for number in (0, 1, 3):
        record.add(Slot(SLOT_S * number, np.full(3, float(number)), np.zeros(3)))
    valid, means = record.rows()
    assert valid.tolist() == [True, True, False, True]
    assert means[valid, 0].tolist() == [0.0, 1.0, 3.0]


@pytest.mark.parametrize("rate_hz", [1.0, 2.9, 3.5, 4.0])
def test_a_device_with_a_sample_a_slot_at_most_leaves_no_row_empty(rate_hz: float) -> None:
    stage, _ = aligned(samples(scenario(120.0, rate_hz=rate_hz)))
    record = stage._aligner.positions[-1]
    assert record.rows()[0].all()
    assert record.rest_s == pytest.approx(120.0, abs=3.0)


def test_a_gap_of_some_seconds_is_no_rest() -> None:
    block = samples(scenario(60.0, rate_hz=20.0))
    seconds = block["device_time_ns"] * 1e-9
    kept = (seconds < 30.0) | (seconds >= 34.0)
    stage, _ = aligned(SampleBlock({name: values[kept] for name, values in block.columns.items()}))
    valid, _ = stage._aligner.positions[-1].rows()
    assert np.count_nonzero(~valid) * SLOT_S == 4.0
    assert stage.status.rest_s == pytest.approx(56.0, abs=0.5)


@pytest.mark.long
def test_an_hour_of_rest_is_as_good_as_it_should_be() -> None:
    block = samples(scenario(3600.0, rate_hz=4.0, arw=1e-3))
    stage, _ = aligned(block, {"accel_bias_sd_ug": 10.0, "gyro_bias_sd_deg_per_h": 0.0})
    shown = stage.status.shown
    assert stage.status.rest_s > 3598.0
    assert math.degrees(shown.sd) < 0.01
    assert abs(error_deg(shown.heading, 30.0)) < 3.0 * math.degrees(shown.sd)
