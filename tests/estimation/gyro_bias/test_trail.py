"""What is drawn over temperature: thinned, bounded, and beside the curve of the model."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.gyro_bias.thermal import MOST_POINTS, BiasTrail
from tests.estimation.gyro_bias.records import DPH, GIVEN, Truth, record, slope_model, vector


def trail_of(n: int, cuts: list[int]) -> BiasTrail:
    """Return the trail of a bias that follows the temperature, given in pieces."""
    trail = BiasTrail(slope_model(10.0))
    degc = np.column_stack([np.linspace(20.0, 40.0, n)] * 3)
    bias = degc * 10.0 * DPH
    for start, stop in zip([0, *cuts], [*cuts, n], strict=True):
        trail.add(degc[start:stop], bias[start:stop])
    return trail


def test_the_trail_is_the_same_whatever_the_blocks() -> None:
    whole, cut = trail_of(700, []).charts(), trail_of(700, [1, 17, 503]).charts()
    for one, other in zip(whole, cut, strict=True):
        for a, b in zip(one.curves, other.curves, strict=True):
            np.testing.assert_array_equal(a.x, b.x)
            np.testing.assert_array_equal(a.y, b.y)
    trail = next(curve for curve in whole[0].curves if curve.name == "x, estimate")
    assert len(trail.x) == 175  # every fourth


def test_the_large_point_is_the_latest() -> None:
    (chart, _) = trail_of(699, []).charts()  # the last one that is kept is the 697th
    assert next(curve for curve in chart.curves if curve.name == "now x").x == pytest.approx([40.0])


def test_a_day_is_kept_in_constant_memory() -> None:
    trail = BiasTrail(None)
    for hour in range(24):
        trail.add(np.full((3600, 3), 20.0 + hour), np.full((3600, 3), hour * DPH))
        (chart,) = trail.charts()
        seen = next(curve for curve in chart.curves if curve.name == "x, estimate")
        assert len(seen.x) <= MOST_POINTS
        assert seen.x[0] == 20.0
    assert chart.curves[-1].y == pytest.approx(23.0, abs=1e-6)
    assert sum(curve.x.nbytes + curve.y.nbytes for curve in chart.curves) < 100_000


def test_the_chart_has_curve_trail_and_the_current_point() -> None:
    temperature = 25.0 + np.arange(1200) / 120.0
    thermal = np.column_stack([60.0 * temperature * DPH] * 3)
    block, _ = record(Truth(rate_hz=10.0), 120.0, 0, thermal, temperature=temperature)
    stage = RestAndBias(GIVEN, model=slope_model(60.0))
    assert stage.charts() == []
    bias = vector(stage.process(block))
    over, left = stage.charts()
    named = {curve.name: curve for curve in over.curves}
    assert named["x, model"].x[[0, -1]] == pytest.approx([20.0, 50.0])
    assert named["now x"].y[-1] == pytest.approx(np.degrees(bias[-10:, 0]).mean() * 3600.0, abs=6.0)
    assert named["now x"].x[-1] == pytest.approx(35.0, abs=0.1)
    assert {curve.name for curve in left.curves} == {
        name for axis in "xyz" for name in (f"{axis}, estimate", f"now {axis}")
    }
    offset = 60.0 * 35.0  # the curve of the model is zero in the middle of its range
    rest = next(curve for curve in left.curves if curve.name == "x, estimate")
    assert np.ptp(rest.y) < 60.0
    assert rest.y[-1] == pytest.approx(offset, abs=20.0)
