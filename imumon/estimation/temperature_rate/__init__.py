"""Temperature and its rate from a quantized sensor, in real time.

`TemperatureRate` is the stage of the pipeline; `LevelBankRate` is its default method, `FirExponentialRate`
the published one.  The methods that both are compared with are in `comparison`.
"""

from imumon.estimation.temperature_rate.fir import FirExponentialRate, FirLinearRate
from imumon.estimation.temperature_rate.level_bank import LevelBankRate
from imumon.estimation.temperature_rate.series import RateEstimate, RateMethod
from imumon.estimation.temperature_rate.stage import TemperatureRate, TemperatureRateParameters

__all__ = [
    "FirExponentialRate",
    "FirLinearRate",
    "LevelBankRate",
    "RateEstimate",
    "RateMethod",
    "TemperatureRate",
    "TemperatureRateParameters",
]
