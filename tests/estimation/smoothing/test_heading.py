from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.smoothing.stage import Recorder, Smoothed, still_heading
from tests.estimation.alignment.units import aligned, error_deg, samples, scenario

RATE_HZ = 50.0


def smoothed(block: SampleBlock) -> tuple[Smoothed, FloatArray]:
    """Return the heading with what came later, and seconds of each slot."""
    stage, found = aligned(block)
    recorder = Recorder()
    recorder.add(block.with_columns({**found, "at_rest": np.ones(len(block), np.int64)}))
    record = recorder.finish()
    result = still_heading(record, stage.finish())
    return result, 1e-9 * (record.middle_ns - record.middle_ns[0])


def test_the_first_position_knows_what_the_second_showed_of_the_bias() -> None:
    turn = {"kind": "turn", "at_s": 60.0, "duration_s": 4.0, "heading_deg": 180.0}
    bias = {"offset_deg_per_h": [2.0, -3.0, 1.0]}
    block = samples(scenario(130.0, rate_hz=RATE_HZ, motion=[turn], gyro_turn_on=bias))
    found, time_s = smoothed(block)
    for at_s, truth in ((30.0, 30.0), (100.0, 210.0)):
        k = int(np.searchsorted(time_s, at_s))
        assert abs(error_deg(found.value[k], truth)) < 4.0 * math.degrees(found.sd[k]) < 1.0
    assert np.isnan(found.value[(time_s > 61.0) & (time_s < 63.0)]).all()


def test_both_halves_of_a_rest_agree_within_their_sigmas() -> None:
    block = samples(scenario(120.0, rate_hz=RATE_HZ, arw=1e-3))
    found, time_s = smoothed(block)
    still = (time_s > 1.0) & (time_s < 119.0)
    assert np.isfinite(found.value[still]).all()
    assert np.ptp(found.value[still]) == 0.0
    middle = len(time_s) // 2
    assert abs(error_deg(found.value[middle], 30.0)) < 4.0 * math.degrees(found.sd[middle])


def test_halves_that_contradict_each_other_widen_the_sigma() -> None:
    block = samples(scenario(120.0, rate_hz=RATE_HZ))
    # The second half sees the north half a degree farther, and nothing turned.
    angle = np.where(np.arange(len(block)) < len(block) // 2, 0.0, math.radians(0.5))
    x, y = block["gyro_x"], block["gyro_y"]
    turned = {
        "gyro_x": np.cos(angle) * x + np.sin(angle) * y,
        "gyro_y": np.cos(angle) * y - np.sin(angle) * x,
    }
    same, _ = smoothed(block)
    other, _ = smoothed(block.with_columns(turned))
    middle = len(other.sd) // 2
    assert other.sd[middle] > 2.0 * same.sd[middle]


def test_nothing_is_reported_where_the_north_is_not_observable() -> None:
    found, _ = smoothed(samples(scenario(60.0, rate_hz=RATE_HZ, arw=0.28)))
    assert np.isnan(found.value).all()
