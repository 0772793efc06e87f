"""The picture of a recording's Allan deviations: its legend names the axes and the fit."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from imumon.allan.analysis import analyse
from imumon.allan.plot import COLORS, _draw
from imumon.allan.series import even_channels
from tests.allan.simulated import noise


@pytest.mark.parametrize("terms", [{}, {"instability": 7e-4}, {"walk": 2e-4}, {"ramp": 5e-6}])
def test_the_legend_has_every_style_that_is_drawn_in_four_lines(terms: dict[str, float]) -> None:
    n = 60_000
    channels = {
        f"gyro_{axis}": noise(seed, n, 0.02, white=1e-3, **terms) for seed, axis in enumerate("xyz", 1)
    }
    results = analyse(even_channels(np.arange(n) * 20_000_000, np.zeros(n, np.int64), channels))
    axes = Figure().add_subplot()
    _draw(axes, "gyro", results)
    legend = axes.get_legend()
    assert legend is not None
    entries = legend.get_lines()
    curves = [line for line in axes.get_lines() if line.get_color() == COLORS["x"]]
    assert {line.get_linestyle() for line in curves} == {line.get_linestyle() for line in entries}
    assert [text.get_text() for text in legend.get_texts()] == ["x", "y", "z", "fit: sum of the terms"]
    assert "68 % interval" in axes.get_ylabel()
