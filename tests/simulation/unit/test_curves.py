from __future__ import annotations

import numpy as np
import pytest

from imumon.simulation.unit import load_unit
from imumon.simulation.unit.biases import axis_values, curve_value

SOAK = np.linspace(-20.53, 48.08, 20_001)


@pytest.mark.parametrize(
    ("axis", "span", "slopes"),
    [("x", 0.786, (40.4, 26.1)), ("y", 0.447, (-66.9, -63.7)), ("z", 0.446, (3.7, 16.4))],
)
def test_crs05_has_the_spans_and_slopes_of_the_specification(
    axis: str, span: float, slopes: tuple[float, float]
) -> None:
    terms = getattr(load_unit("crs05").gyro_bias_deg_per_s, axis)
    assert np.ptp(curve_value(terms, SOAK)) == pytest.approx(span, abs=5e-4)
    at, h = np.array([27.28, 34.08]), 1e-3
    found = 3600 * (curve_value(terms, at + h) - curve_value(terms, at - h)) / (2 * h)
    np.testing.assert_allclose(found, slopes, atol=0.05)


def test_crs05_has_the_biases_of_the_specification() -> None:
    t = np.array([-20.0, 0.0, 27.28, 48.0])
    expected = np.column_stack(
        [
            0.45 * np.tanh((t - 18) / 25) + 0.06 * np.sin((t + 5) / 12),
            -0.35 * np.tanh((t - 30) / 15) + 0.004 * (t - 20),
            0.30 * ((t - 14) / 34) ** 2 - 0.20 * (t - 14) / 34 + 0.05 * np.tanh((t - 5) / 6),
        ]
    )
    curves = load_unit("crs05").gyro_bias_deg_per_s
    np.testing.assert_allclose(axis_values(curves, np.column_stack([t, t, t])), expected, rtol=1e-12)
