"""The step of a sensor, found from its readings."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.thermometer import StepFinder
from tests.estimation.temperature_rate.records import quantized, self_heating


def found(reading: FloatArray) -> StepFinder:
    """Return a finder that learned from all differences of neighbours."""
    finder = StepFinder()
    for difference in np.abs(np.diff(reading)):
        finder.learn(float(difference))
    return finder


@pytest.mark.parametrize("step", [0.05, 0.0625, 0.2])
def test_a_wrong_declaration_is_contradicted_with_the_right_step(step: float) -> None:
    temperature, _ = self_heating(0.3)
    finder = found(quantized(temperature, 0.2 * step, step=step))
    assert finder.confirmed_step == pytest.approx(step, rel=1e-3)
    text = finder.contradiction(0.1)
    assert text is not None
    assert f"{step:.4g} °C, not of 0.1 °C" in text


def test_a_right_declaration_is_not_contradicted() -> None:
    temperature, _ = self_heating(0.3)
    finder = found(quantized(temperature, 0.01))
    assert finder.contradiction(0.05) is None
    assert finder.confirmed_step == pytest.approx(0.05)


def test_steps_skipped_at_first_are_found_later() -> None:
    readings = [20.0, 20.15, 20.25, 20.2, 20.3, 20.15, 20.1, 20.15, 20.3, 20.35, 20.3, 20.4]
    assert found(np.array(readings)).confirmed_step == pytest.approx(0.05)


def test_steps_written_with_too_few_digits_are_found() -> None:
    temperature, _ = self_heating(0.3)
    reading = np.round(quantized(temperature, 0.2 * 0.0625, step=0.0625), 2)
    assert found(reading).confirmed_step == pytest.approx(0.0625, rel=0.05)


def test_readings_without_steps_contradict_any() -> None:
    finder = found(25.0 + 0.1 * np.random.default_rng(1).standard_normal(500))
    assert finder.confirmed_step is None
    assert "nor in any other" in str(finder.contradiction(0.05))


def test_nothing_is_said_before_the_readings_change() -> None:
    finder = found(np.array([np.nan, 20.0, 20.0, np.nan, 20.0]))
    assert finder.confirmed_step is None
    assert finder.contradiction(0.05) is None
