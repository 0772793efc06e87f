"""What the core asks of the published methods, which are loaded when one of them runs."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.pipeline import Estimator
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.setup import Setup


def stages(
    setup: Setup, temperature: TemperatureRateParameters, _: Sequence[Estimator]
) -> Sequence[Estimator]:
    """Return the methods that a setup names, as stages."""
    if not setup.methods and temperature.method != "fir_exponential":
        return []
    from imumon.papers.stages import published_stages

    return published_stages(setup, temperature)
