from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.hysteresis import HysteresisLoop
from imumon.simulation.unit.parameters import Hysteresis
from tests.simulation.unit.scenarios import scenario

WIDTH = 2.0


def loop(kind: str) -> HysteresisLoop:
    parameters = Hysteresis.model_validate({"kind": kind, "half_width_deg_per_h": 1, "width_degc": WIDTH})
    return HysteresisLoop(parameters, np.full(3, 20.0))


def plain(kind: str, temperature: FloatArray) -> FloatArray:
    """Return y by the definitions: many small steps of the differential equation; the play."""
    y, p, before, out = 0.0, 20.0, 20.0, []
    for t in temperature:
        small = np.diff(np.linspace(before, t, 201))
        for step in small:
            y += (step - abs(step) * y) / WIDTH
        p = max(t - WIDTH, min(t + WIDTH, p))
        out.append(y if kind == "smooth" else (t - p) / WIDTH)
        before = t
    return np.array(out)


@pytest.mark.parametrize(("kind", "tolerance"), [("smooth", 2e-3), ("play", 1e-12)])
def test_kernels_do_what_the_definitions_say(kind: str, tolerance: float) -> None:
    temperature = 20 + np.cumsum(np.random.default_rng(4).normal(0, 0.4, (300, 3)), axis=0)
    found = loop(kind).process(temperature)
    for axis in range(3):
        np.testing.assert_allclose(found[:, axis], plain(kind, temperature[:, axis]), atol=tolerance)


@pytest.mark.parametrize("kind", ["smooth", "play"])
def test_blocks_of_any_size_give_the_same_bits(kind: str) -> None:
    temperature = 20 + np.cumsum(np.random.default_rng(5).normal(0, 0.4, (500, 3)), axis=0)
    whole, parts = loop(kind), loop(kind)
    pieces = [parts.process(temperature[a:b]) for a, b in ((0, 1), (1, 200), (200, 200), (200, 500))]
    np.testing.assert_array_equal(np.concatenate(pieces), whole.process(temperature))


@pytest.mark.parametrize(("kind", "opening"), [("smooth", 1 - 2 * np.exp(-5.0)), ("play", 1.0)])
def test_a_cycle_opens_to_the_stated_width(kind: str, opening: float) -> None:
    """Down 10 degC from a reversal, y is 1 - 2 exp(-10 / w) of the smooth loop's half width."""
    cycle = np.concatenate([np.linspace(20, 40, 201), np.linspace(40, 20, 201), np.linspace(20, 40, 201)])
    y = loop(kind).process(np.column_stack([cycle] * 3))[:, 0]
    falling, rising = y[200:402], y[402:]
    assert rising[100] == pytest.approx(opening, abs=1e-3)
    assert falling[101] == pytest.approx(-opening, abs=1e-3)


def test_right_after_a_reversal_the_slope_is_two_half_widths_per_width() -> None:
    """42 deg/h/degC for the x axis of crs05-hysteresis."""
    unit = {"gyro_hysteresis": {"half_width_deg_per_h": [42.4, 24.1, 24.1], "width_degc": WIDTH}}
    steps = [
        {"to_degc": 40, "rate_degc_per_min": 60},
        {"to_degc": 30, "rate_degc_per_min": 60},
    ]
    plan = scenario(unit, chamber={"start_degc": 20, "steps": steps}, duration_s=30)
    _, truth = SimulatedUnit(plan).run(plan.samples)
    bias = np.degrees(truth["gyro_bias_x"]) * 3600
    slope = (bias[2005] - bias[2001]) / (truth["temperature"][2005] - truth["temperature"][2001])
    assert slope == pytest.approx(42.4, rel=0.03)
    assert np.ptp(bias[1000:]) == pytest.approx(2 * 42.4, rel=0.01)
