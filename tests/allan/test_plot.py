"""The picture of a recording's Allan deviations: its legend has every style that is drawn."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from imumon.allan.analysis import analyse
from imumon.allan.plot import COLORS, _draw
from imumon.allan.series import even_channels
from tests.allan.simulated import noise


@pytest.mark.parametrize("terms", [{}, {"instability": 7e-4}, {"walk": 2e-4}, {"ramp": 5e-6}])
def test_the_legend_has_every_style_that_is_drawn(terms: dict[str, float]) -> None:
    n = 60_000
    channels = {"gyro_x": noise(1, n, 0.02, white=1e-3, **terms)}
    results = analyse(even_channels(np.arange(n) * 20_000_000, np.zeros(n, np.int64), channels))
    axes = Figure().add_subplot()
    _draw(axes, "gyro", results)
    legend = axes.get_legend()
    assert legend is not None
    entries = legend.get_lines()
    curves = [line for line in axes.get_lines() if line.get_color() == COLORS["x"]]
    assert {line.get_linestyle() for line in curves} == {line.get_linestyle() for line in entries}
    named = {text.get_text() for text in legend.get_texts()}
    assert {"x", "68 % interval", "fit: sum of the terms"} <= named
    assert ("its part: angle random walk" in named) == bool(terms)
