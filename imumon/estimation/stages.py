"""Which estimators run behind the clock, and in which order."""

from __future__ import annotations

from imumon.estimation.temperature_rate.parameters import TemperatureRateParameters
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.pipeline import Estimator
from imumon.protocols.device import DeviceFile


def estimators(device: DeviceFile | None) -> list[Estimator]:
    """Return new estimators for a device, or for a table when there is none."""
    parameters = device.temperature if device is not None else TemperatureRateParameters()
    return [TemperatureRate(parameters=parameters)]
