from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Memory
from imumon.effects.thermal_lag import Hysteresis
from imumon.simulation.unit import SimulatedUnit
from tests.simulation.unit.scenarios import scenario

WIDTH = 2.0


def loop(kind: str) -> Hysteresis:
    """Return the loop of a unit file, between -1 and 1."""
    found = {"half_width": WIDTH, "shape": kind, "slack": 0.0}
    return Hysteresis.model_validate(
        {**found, "middle_degc": 0.0, "half_span_degc": WIDTH, "coefficients": [1.0]}
    )


def drive(temperature: FloatArray) -> Drive:
    return Drive(np.arange(len(temperature), dtype=np.float64), temperature)


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
    temperature = np.append(20, 20 + np.cumsum(np.random.default_rng(4).normal(0, 0.4, 900)))
    np.testing.assert_allclose(
        loop(kind).simulate(drive(temperature)), plain(kind, temperature), atol=tolerance
    )


@pytest.mark.parametrize("kind", ["smooth", "play"])
def test_blocks_of_any_size_give_the_same_bits(kind: str) -> None:
    temperature = 20 + np.cumsum(np.random.default_rng(5).normal(0, 0.4, 500))
    effect, memory = loop(kind), Memory()
    cuts = ((0, 1), (1, 200), (200, 200), (200, 500))
    pieces = [effect.added(memory, drive(temperature[a:b])) for a, b in cuts]
    np.testing.assert_array_equal(np.concatenate(pieces), effect.added(Memory(), drive(temperature)))


@pytest.mark.parametrize(("kind", "opening"), [("smooth", 1 - 2 * np.exp(-5.0)), ("play", 1.0)])
def test_a_cycle_opens_to_the_stated_width(kind: str, opening: float) -> None:
    """Down 10 degC from a reversal, y is 1 - 2 exp(-10 / w) of the smooth loop's half width."""
    cycle = np.concatenate([np.linspace(20, 40, 201), np.linspace(40, 20, 201), np.linspace(20, 40, 201)])
    y = loop(kind).simulate(drive(cycle))
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
