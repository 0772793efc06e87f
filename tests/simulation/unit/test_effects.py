"""A unit file takes any effect of the library: what it adds is what the effect itself says."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.effects.base import Drive, Memory, Scale, Survey
from imumon.effects.library import EFFECTS
from imumon.simulation.unit import SimulatedUnit
from tests.simulation.unit.scenarios import scenario

SURVEY = Survey((7200.0, 7200.0), 30.0, 4, 19.6, 1.0, 3, Scale(25.0, 15.0))
CHAMBER = {"start_degc": 20, "steps": [{"to_degc": 30, "rate_degc_per_min": 10, "hold_s": 60}]}
ROLLED = {"kind": "turn", "at_s": 30, "duration_s": 5, "roll_deg": 60}
DEG_PER_H, UG = np.pi / 180 / 3600, 9.80665e-6


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_in_a_unit_file_is_in_the_bias_of_its_axis(name: str) -> None:
    effect = EFFECTS[name].grid(SURVEY)[0]
    effect = effect.with_coefficients(np.linspace(3.0, 5.0, effect.width))
    said = {"y": [effect.model_dump()]}
    unit = SimulatedUnit(
        scenario(
            {"gyro_effects_deg_per_h": said, "accel_effects_ug": said},
            rate_hz=10,
            chamber=CHAMBER,
            motion=[ROLLED],
        )
    )
    truth = unit.run(900)[1]
    force = SimulatedUnit(scenario({}, rate_hz=10, motion=[ROLLED])).run(900)[0].vector("accel")
    drive = Drive(np.arange(900) / 10.0, truth["temperature_y"], force)
    expected = effect.added(Memory(), drive)
    assert np.ptp(expected) > 0 or name == "run_offset"
    np.testing.assert_allclose(truth["gyro_bias_y"], expected * DEG_PER_H, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(truth["accel_bias_y"], expected * UG, rtol=1e-9, atol=1e-15)
    assert not truth["gyro_bias_x"].any()
