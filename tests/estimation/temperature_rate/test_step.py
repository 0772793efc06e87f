"""The step of a sensor, found from its readings."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.thermometer import UNKNOWN_STEP_DEGC, Thermometer
from tests.estimation.temperature_rate.records import quantized, self_heating


def found(reading: FloatArray) -> float:
    """Return the step that all differences of neighbours show, °C."""
    thermometer = Thermometer()
    for difference in np.abs(np.diff(reading)):
        thermometer.learn_step(float(difference))
    return thermometer.step


@pytest.mark.parametrize("step", [0.05, 0.0625, 0.2])
def test_the_step_of_a_noisy_sensor_is_found(step: float) -> None:
    temperature, _ = self_heating(0.3)
    assert found(quantized(temperature, 0.2 * step, step=step)) == pytest.approx(step, rel=1e-3)


def test_steps_skipped_at_first_are_found_later() -> None:
    readings = [20.0, 20.15, 20.25, 20.2, 20.3, 20.15, 20.1, 20.15, 20.3, 20.35, 20.3, 20.4]
    assert found(np.array(readings)) == pytest.approx(0.05)


def test_steps_written_with_too_few_digits_are_found() -> None:
    temperature, _ = self_heating(0.3)
    reading = np.round(quantized(temperature, 0.2 * 0.0625, step=0.0625), 2)
    assert found(reading) == pytest.approx(0.0625, rel=0.05)


def test_nothing_is_known_before_the_readings_change() -> None:
    assert found(np.array([np.nan, 20.0, 20.0, np.nan, 20.0])) == UNKNOWN_STEP_DEGC


def test_a_single_odd_reading_is_no_step_for_ever() -> None:
    reading = np.repeat(20.0 + 0.0625 * np.arange(150), 2)
    reading[21] += 0.01
    assert found(reading[:200]) == pytest.approx(0.01)
    assert found(reading) == pytest.approx(0.0625)
