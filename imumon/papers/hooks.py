"""What the core asks of the published methods, which are loaded when one of them runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from imumon.pipeline import Estimator
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.setup import Setup


def stages(
    setup: Setup, temperature: TemperatureRateParameters, _: Sequence[Estimator]
) -> Sequence[Estimator]:
    """Return the methods that a setup names, as stages."""
    if not setup.asks_for_published:
        return []
    from imumon.papers.stages import published_stages

    return published_stages(setup, temperature)


def fir_method(given: TemperatureRateParameters) -> Callable[[], Any]:
    """Return what makes the FIR exponential regression with the parameters of the device file."""
    from imumon.papers.stages import fir_method

    return fir_method(given)
